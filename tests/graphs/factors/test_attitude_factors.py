"""Factors of attitudes: residuals by SciPy, Jacobians, null directions, bad input."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle import DirectionFactor, HeadingFactor, InputError, RotationFactor

DOWN = np.array([0.0, 0, -1])


def graph_of(rotation, factor, seed=0):
    graph = bundle.FactorGraph()
    shift = np.random.default_rng(seed).normal(size=3)
    graph.add_variable("pose", [*rotation.as_quat(), *shift], "se3")
    graph.add_factor(factor)
    return graph


def chi2(graph):
    return 2 * graph.cost()


@pytest.mark.parametrize("angle", [0, 1e-9, 1e-3, 1.0, 90.0, 179.0, 179.99999, 180.0])
def test_a_direction_costs_the_chord_at_every_angle(angle):
    rng = np.random.default_rng(2)
    rotation = Rotation.random(random_state=3)
    seen = rotation.apply(DOWN)
    across = np.cross(seen, rng.normal(size=3))
    turned = Rotation.from_rotvec(np.radians(angle) * across / np.linalg.norm(across)).apply(seen)
    graph = graph_of(rotation, DirectionFactor("pose", 9.81 * turned, 0.02))
    expected = (2 * np.sin(np.radians(angle) / 2) / 0.02) ** 2
    assert chi2(graph) == pytest.approx(expected, rel=1e-9, abs=1e-20)
    assert graph.check_gradients().ok


def test_other_residuals_are_those_of_scipy():
    rotation, measured = Rotation.random(random_state=1), Rotation.random(random_state=2)
    information = np.diag([1.0, 4.0, 9.0])
    graph = graph_of(rotation, RotationFactor("pose", 3 * measured.as_quat(), information))
    error = (measured.inv() * rotation).as_rotvec()
    assert chi2(graph) == pytest.approx(error @ information @ error, rel=1e-12)
    axis = np.array([0.3, -2, 1])
    east, north, _ = rotation.inv().apply(axis)
    heading = np.arctan2(east, north)
    for off in (0.3, 2 * np.pi + 0.3, -0.3 - 4 * np.pi, np.pi - 0.1):
        factor = HeadingFactor("pose", heading + off, 0.1, axis=axis)
        wrapped = (off + np.pi) % (2 * np.pi) - np.pi
        assert chi2(graph_of(rotation, factor)) == pytest.approx((wrapped / 0.1) ** 2, rel=1e-9)


def test_headings_are_clockwise_from_north():
    # Forward is east, right is south, down is down: cam_from_world has these rows.
    rotation = Rotation.from_matrix([[0, -1, 0], [0, 0, -1], [1, 0, 0]])
    assert chi2(graph_of(rotation, HeadingFactor("pose", np.pi / 2, 1.0))) < 1e-20


@pytest.mark.parametrize("seed", range(3))
def test_jacobians_are_right_at_random_places(seed):
    rng = np.random.default_rng(seed)
    graph = bundle.FactorGraph()
    for k in range(20):
        quaternion = Rotation.random(random_state=100 * seed + k).as_quat()
        graph.add_variable(k, [*quaternion, *rng.normal(size=3)], "se3")
        graph.add_factor(DirectionFactor(k, rng.normal(size=3), 0.3, axis=rng.normal(size=3)))
        measured = Rotation.random(random_state=1000 * seed + k).as_quat()
        root = rng.normal(size=(3, 3))
        graph.add_factor(RotationFactor(k, measured, root @ root.T + 0.1 * np.eye(3)))
        graph.add_factor(HeadingFactor(k, 3 * rng.normal(), 0.2, axis=rng.normal(size=3)))
    assert graph.check_gradients().ok


def test_turns_about_the_axis_are_free_at_every_residual():
    rng = np.random.default_rng(4)
    for k in range(5):
        axis = rng.normal(size=3)
        factor = DirectionFactor("pose", rng.normal(size=3), 0.5, axis=axis)
        graph = graph_of(Rotation.random(random_state=k), factor)
        information = graph.information(["pose"])[0]
        values = np.linalg.eigvalsh(information)
        assert (values[:4] < 1e-12).all() and values[4] == pytest.approx(4, rel=1e-9)
        assert np.abs(information[:3, :3] @ axis).max() < 1e-12
        assert not information[3:].any()


def test_a_solve_leads_back_from_almost_180_degrees():
    rotation = Rotation.random(random_state=5)
    seen = rotation.apply(DOWN)
    measured = -seen + 1e-3 * np.cross(seen, [1.0, 2, 3])
    graph = graph_of(rotation, DirectionFactor("pose", measured, 0.01))
    assert graph.solve(max_num_iterations=100).summary.final_cost < 1e-12


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: DirectionFactor("pose", [0, 0, 0], 1), "direction"),
        (lambda: DirectionFactor("pose", [0, np.nan, 1], 1), "direction"),
        (lambda: DirectionFactor("pose", [0, 1], 1), "direction"),
        (lambda: DirectionFactor("pose", [0, 0, 1], 0), "sigma"),
        (lambda: DirectionFactor("pose", [0, 0, 1], 1, axis=[0, 0, 0]), "axis"),
        (lambda: HeadingFactor("pose", np.inf, 1), "heading"),
        (lambda: HeadingFactor("pose", 1, -1), "sigma"),
    ],
)
def test_bad_values_are_refused(make, word):
    with pytest.raises(InputError, match=word):
        make()


def test_variables_of_other_manifolds_are_refused():
    graph = bundle.FactorGraph()
    graph.add_variable("point", [0.0, 0, 1])
    with pytest.raises(InputError):
        graph.add_factor(DirectionFactor("point", [0, 0, 1], 1.0))
        graph.cost()
    graph = bundle.FactorGraph()
    graph.add_variable("pose", [0.0, 0, 0, 1, 0, 0, 0], "se3")
    with pytest.raises(InputError, match=r"rotation|information"):
        graph.add_factor(RotationFactor("pose", [0, 0, 0, 0], 1.0))
        graph.cost()
