"""Factors of an IMU in a graph: Jacobians, both solvers, gravity and scale, walks of biases."""

import copy
import pickle

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle

NOISE = bundle.ImuNoise(1.7e-4, 2e-3, 2e-5, 3e-3)
GRAVITY = np.array([0, 0, -9.81])
STATES, SAMPLES, STEP = 4, 20, 0.01


def flight(seed=0):
    """States that the samples of an IMU connect exactly, and the motions between them."""
    rng = np.random.default_rng(seed)
    states, motions = [np.r_[0, 0, 0.6, 0.8, 1, 2, 3, 0.5, -0.3, 0.2, 0.02 * rng.random(6)]], []
    for _ in range(STATES - 1):
        gyro = rng.standard_normal((SAMPLES, 3))
        accel = [0, 0, 9.81] + 3 * rng.standard_normal((SAMPLES, 3))
        motion = bundle.Preintegration(NOISE)
        motion.integrate(gyro, accel, np.full(SAMPLES, STEP))
        motions.append(motion.repropagated(states[-1][10:13], states[-1][13:]))
        states.append(motions[-1].predict(states[-1], GRAVITY))
    return np.array(states), motions


def graph_of(states, motions, **shared):
    """States, IMU factors, walks; `shared`: value, manifold, fixed of variables of all factors."""
    graph = bundle.FactorGraph()
    for key, (value, manifold, fixed) in shared.items():
        graph.add_variable(key, value, manifold, fixed=fixed)
    extra = {f"{key}_key": key for key in shared}
    for k, state in enumerate(states):
        graph.add_variable(("pose", k), state[:7], "se3")
        graph.add_variable(("velocity", k), state[7:10])
        graph.add_variable(("bias", k), state[10:])
    for k, motion in enumerate(motions):
        keys = [(name, k) for name in ("pose", "velocity", "bias")]
        keys += [("pose", k + 1), ("velocity", k + 1)]
        graph.add_factor(bundle.ImuFactor(*keys, motion, **extra))
        walk = bundle.BiasWalkFactor(("bias", k), ("bias", k + 1), NOISE, motion.duration)
        graph.add_factor(walk)
    return graph


def moved(states, seed=1, size=1e-2):
    rng = np.random.default_rng(seed)
    states = states.copy()
    turns = Rotation.from_rotvec(size * rng.standard_normal((len(states), 3)))
    states[:, :4] = (Rotation.from_quat(states[:, :4]) * turns).as_quat()
    states[:, 4:10] += size * rng.standard_normal((len(states), 6))
    states[:, 10:] += 0.1 * size * rng.standard_normal((len(states), 6))
    return states


def values_of(result, states):
    values = np.array(
        [
            np.r_[result.values["pose", k], result.values["velocity", k], result.values["bias", k]]
            for k in range(len(states))
        ]
    )
    values[:, :4] *= np.sign(np.sum(values[:, :4] * states[:, :4], axis=1))[:, None]
    return values


VECTOR = {"gravity": ([0.3, -0.2, -9.7], "euclidean", False)}
ROTATION = {"gravity": ([0.1, -0.05, 0.2, 0.9], "so3", False)}
SCALE = {"scale": ([1.7], "euclidean", False)}


@pytest.mark.parametrize("shared", [{}, VECTOR, ROTATION, SCALE, VECTOR | SCALE])
def test_jacobians_are_derivatives(shared):
    states, motions = flight()
    check = graph_of(moved(states), motions, **shared).check_gradients()
    assert check.ok, check


@pytest.mark.parametrize("square_root", [False, True])
def test_both_solvers_find_the_states(square_root):
    states, motions = flight()
    graph = graph_of(moved(states), motions)
    start = states[0]
    graph.add_factor(bundle.PriorFactor(("pose", 0), start[:7], 1e8))
    graph.add_factor(bundle.PriorFactor(("velocity", 0), start[7:10], 1e8))
    graph.add_factor(bundle.PriorFactor(("bias", 0), start[10:], 1e8))
    result = graph.solve(
        square_root=square_root, function_tolerance=1e-16, parameter_tolerance=1e-14
    )
    assert result.summary.final_cost < 1e-12
    assert np.abs(values_of(result, states) - states).max() < 1e-6


def test_gravity_and_scale_are_found_from_a_start_without_them():
    """Poses in a turned world without unit, as vision alone gives them."""
    states, motions = flight()
    turn, scale = Rotation.from_rotvec([0.2, -0.3, 0]), 0.4
    poses = states[:, :7].copy()
    poses[:, :4] = (turn * Rotation.from_quat(states[:, :4])).as_quat()
    poses[:, 4:] = scale * turn.apply(states[:, 4:7])
    velocities = turn.apply(states[:, 7:10])
    start = np.hstack([poses, velocities, states[:, 10:]])
    start[:, 7:10] += 0.3
    for manifold, value in (("euclidean", [0, 0, -9.81]), ("so3", [0, 0, 0, 1])):
        fixed = [2] if manifold == "so3" else False
        shared = {"gravity": (value, manifold, fixed), "scale": ([1.0], "euclidean", False)}
        graph = graph_of(start, motions, **shared)
        for k in range(STATES):
            graph.add_factor(bundle.PriorFactor(("pose", k), poses[k], 1e10))
            graph.add_factor(bundle.PriorFactor(("bias", k), states[k, 10:], 1e10))
        result = graph.solve(function_tolerance=1e-16, max_num_iterations=100)
        gravity = result.values["gravity"]
        if manifold == "so3":
            gravity = Rotation.from_quat(gravity).apply(GRAVITY)
        assert gravity == pytest.approx(turn.apply(GRAVITY), abs=1e-4)
        assert result.values["scale"][0] == pytest.approx(1 / scale, rel=1e-4)


def test_whitened_by_the_motions_covariance():
    states, motions = flight()
    graph = graph_of(moved(states)[:2], motions[:1])
    imu, _ = graph.factors
    graph = graph_of(moved(states)[:2], [])
    graph.add_factor(imu)
    graph.add_factor(bundle.PriorFactor(("bias", 1), moved(states)[1, 10:], 1.0))
    i, j = moved(states)[:2]
    rotation, velocity, position = motions[0].corrected(i[10:13], i[13:])
    turn_i, turn_j = (Rotation.from_quat(s[:4]) for s in (i, j))
    duration = motions[0].duration
    error = np.r_[
        (Rotation.from_matrix(rotation).inv() * turn_i.inv() * turn_j).as_rotvec(),
        turn_i.inv().apply(j[4:7] - i[4:7] - i[7:10] * duration - GRAVITY * duration**2 / 2)
        - position,
        turn_i.inv().apply(j[7:10] - i[7:10] - GRAVITY * duration) - velocity,
    ]
    expected = error @ np.linalg.solve(motions[0].covariance, error) / 2
    assert graph.cost() == pytest.approx(expected, rel=1e-8)


def test_a_walk_costs_by_the_square_root_of_time():
    graph = bundle.FactorGraph()
    graph.add_variable("a", np.zeros(6))
    graph.add_variable("b", [1e-5, 0, 0, 0, 2e-3, 0])
    graph.add_factor(bundle.BiasWalkFactor("a", "b", NOISE, 4.0))
    expected = ((1e-5 / 2e-5) ** 2 + (2e-3 / 3e-3) ** 2) / 4 / 2
    assert graph.cost() == pytest.approx(expected)


def test_a_factor_keeps_its_motion_and_is_an_object_like_others():
    _, motions = flight()
    factor = bundle.ImuFactor("x0", "v0", "b0", "x1", "v1", motions[0], gravity=[0, 0, -9.8])
    before = factor.motion.covariance
    motions[0].append(motions[1])
    assert (factor.motion.covariance == before).all()
    for twin in (copy.deepcopy(factor), pickle.loads(pickle.dumps(factor))):
        assert twin.keys == factor.keys
        assert (twin.gravity == factor.gravity).all()
        assert (twin.motion.covariance == before).all()
    with pytest.raises(ValueError, match="read-only"):
        factor.gravity[0] = 1
    assert "x0" in repr(factor)
    assert factor.keys == ("x0", "v0", "b0", "x1", "v1")
