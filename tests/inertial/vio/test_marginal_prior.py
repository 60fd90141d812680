"""Priors of windows: what a start says, and what moving their points leaves as it was."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bundle import _core
from bundle.inertial.vio.marginal_prior import (
    CAMERA_SHIFT,
    CAMERA_TURN,
    MOTION,
    POSE,
    REST_DISTANCE,
    REST_SPEED,
    MarginalPrior,
    start_prior,
)
from bundle.inertial.vio.odometry import run_odometry
from bundle.inertial.vio.trajectory_comparison import compare_trajectories
from bundle.io.sequences.sequence_folder import read_track_csv
from bundle.io.sequences.trajectory_files import load_trajectory
from tests.inertial.vio.test_window_core import SOLVE, make_window
from tests.inertial.vio.window_scenes import CAMERA, Flight, moved

FORMS = pytest.mark.parametrize("square_root", [False, True])


@pytest.fixture(scope="module")
def flight() -> Flight:
    return Flight(4, 31, landmarks=8)


def cost_at(prior: MarginalPrior, flight: Flight, states: Any) -> float:
    """The prior's cost by the core, at states of the flight's frames."""
    window, _ = make_window(flight)
    places = {int(stamp): place for place, stamp in enumerate(flight.stamps)}
    window |= {"states": states, "anchors": states, "priors": [prior.at(places)]}
    solved = _core.solve_window(window, {**SOLVE, "max_num_iterations": 0}, None)
    return float(solved["costs_before"]["prior"])


def displaced(states: Any, seed: int = 1, turn: float = 0.0) -> Any:
    rng = np.random.default_rng(seed)
    sizes = np.r_[[turn] * 3, [0.02] * 6, [0.003] * 3, [0.05] * 3]
    return np.array([moved(state, sizes * rng.normal(size=15)) for state in states])


@FORMS
def test_a_start_at_rest_is_the_sum_of_its_parts(flight: Flight, square_root: bool) -> None:
    """Its points move and are apart: a start's states need not be at rest to the last digit."""
    begin = flight.states
    prior = start_prior(
        [int(stamp) for stamp in flight.stamps],
        begin,
        position=0.1,
        yaw=0.02,
        gyro_bias=0.01,
        accel_bias=0.2,
        at_rest=True,
        square_root=square_root,
    )
    states = displaced(begin)
    step = states - begin
    expected = np.sum((step[0, 4:7] / 0.1) ** 2) + np.sum((step[0, 10:13] / 0.01) ** 2)
    expected += np.sum((step[0, 13:16] / 0.2) ** 2) + np.sum((states[:, 7:10] / REST_SPEED) ** 2)
    apart = states[1:, 4:7] - states[0, 4:7]
    expected += np.sum((apart / REST_DISTANCE) ** 2)
    assert cost_at(prior, flight, states) == pytest.approx(0.5 * expected, rel=1e-9)


@FORMS
def test_yaw_turns_about_the_vertical(flight: Flight, square_root: bool) -> None:
    tilted = flight.states.copy()
    tilted[0, :4] = Rotation.from_euler("zyx", [0.3, 0.6, -0.5]).as_quat()
    prior = start_prior(
        [int(flight.stamps[0])],
        tilted,
        position=0.0,
        yaw=0.02,
        gyro_bias=1.0,
        accel_bias=1.0,
        at_rest=False,
        square_root=square_root,
    )
    for axis, expected in ((2, 0.5 * (0.01 / 0.02) ** 2), (0, 0.0), (1, 0.0)):
        turn = Rotation.from_rotvec(0.01 * np.eye(3)[axis])
        states = tilted.copy()
        states[0, :4] = (turn * Rotation.from_quat(tilted[0, :4])).as_quat()
        assert cost_at(prior, flight, states) == pytest.approx(expected, abs=1e-9)


@FORMS
def test_moving_the_points_changes_no_cost(flight: Flight, square_root: bool) -> None:
    rng = np.random.default_rng(2)
    root = rng.normal(size=(20, 15))
    v = rng.normal(size=20)
    stamp = int(flight.stamps[1])
    points = np.repeat(flight.states[1][None], 2, axis=0)
    keys: Any = ((stamp, 0), (stamp, 1))
    if square_root:
        prior = MarginalPrior(keys, points, True, root, v, 0.7)
    else:
        prior = MarginalPrior(keys, points, False, root.T @ root, -root.T @ v, 0.5 * v @ v + 0.7)
    elsewhere, there = displaced(flight.states, 3), displaced(flight.states, 4)
    again = prior.relinearized({stamp: elsewhere[1]})
    np.testing.assert_array_equal(again.points, np.repeat(elsewhere[1][None], 2, axis=0))
    assert cost_at(again, flight, there) == pytest.approx(cost_at(prior, flight, there), rel=1e-9)


def test_the_oldest_frame_is_judged_alone() -> None:
    """Its block of the information with all others given, of a unit diagonal."""
    stamp, other = 10, 20
    matrix = np.diag(np.r_[np.full(15, 4.0), np.full(6, 1e-9)])
    matrix[0, 1] = matrix[1, 0] = 3.0
    keys: Any = ((stamp, 0), (stamp, 1), (other, 0))
    prior = MarginalPrior(keys, np.zeros((3, 16)), False, matrix, np.zeros(21))
    assert prior.oldest_ratio() == pytest.approx(0.25 / 1.75)
    root = MarginalPrior(keys, np.zeros((3, 16)), True, np.linalg.cholesky(matrix).T, np.zeros(21))
    assert root.oldest_ratio() == pytest.approx(0.25 / 1.75)


def test_only_directions_that_are_measured_make_a_prior_indefinite(flight: Flight) -> None:
    stamps, h = [int(stamp) for stamp in flight.stamps[:2]], 1e-6
    keys = tuple((stamp, kind) for stamp in stamps for kind in (POSE, MOTION))
    states = flight.states[:2] + np.r_[np.zeros(4), 1000.0, -500.0, 0.0, np.zeros(9)]

    def step(turn: float, shift: Any) -> Any:
        """The tangent of a motion of the world, by finite difference."""
        world = Rotation.from_rotvec([0, 0, turn])
        parts = []
        for state in states:
            centre = states[:, 4:7].mean(axis=0)
            there = state.copy()
            there[:4] = (world * Rotation.from_quat(state[:4])).as_quat()
            there[4:7] = world.apply(state[4:7] - centre) + centre + shift
            there[7:10] = world.apply(state[7:10])
            parts.append(_core.state_coordinates(state, there))
        return np.concatenate(parts) / h

    gauge = np.array([step(h, 0), *(step(0, h * axis) for axis in np.eye(3))]).T
    rng = np.random.default_rng(0)
    vectors = np.linalg.qr(np.column_stack([gauge, rng.normal(size=(30, 26))]))[0]
    unmeasured, known = vectors[:, :4], vectors[:, 4:]

    def definiteness(along_gauge: float, along_one: float) -> float:
        values = np.r_[np.full(4, along_gauge), along_one, rng.uniform(1, 9, 25)]
        matrix = np.hstack([unmeasured, known]) * values @ np.hstack([unmeasured, known]).T
        points = np.repeat(states, 2, axis=0)
        return MarginalPrior(keys, points, False, matrix, np.zeros(30)).definiteness()

    assert abs(definiteness(-1e-6, 2.0)) < 1e-9
    assert abs(definiteness(0.0, 0.0)) < 1e-12
    for lost in (1e-4, 1e-6):
        assert definiteness(-1e-6, -lost) == pytest.approx(-lost / 9, rel=0.9)
        assert definiteness(0.0, -lost) < 0.05 * -lost

    # any matrix, in other units: the scaled one, restricted to what is orthogonal to the gauge
    units = rng.uniform(0.1, 10, 30)
    half = rng.normal(size=(30, 30))
    matrix = np.outer(units, units) * (half @ half.T - 8 * np.eye(30))
    matrix[np.diag_indices(30)] = np.abs(np.diag(matrix))
    points = np.repeat(states, 2, axis=0)
    prior = MarginalPrior(keys, points, False, matrix, np.zeros(30))
    np.testing.assert_allclose(prior._gauge(), np.roll(gauge, -1, axis=1), atol=1e-5)
    root = np.sqrt(np.diag(matrix))
    complement = np.linalg.qr(root[:, None] * gauge, mode="complete")[0][:, 4:]
    values = np.linalg.eigvalsh(complement.T @ (matrix / np.outer(root, root)) @ complement)
    assert values[0] < 0
    assert prior.definiteness() == pytest.approx(values[0] / values[-1], rel=1e-4)


@FORMS
def test_a_camera_that_is_refined_begins_where_it_was_given(
    flight: Flight, square_root: bool
) -> None:
    prior = start_prior(
        [int(stamp) for stamp in flight.stamps],
        flight.states,
        position=0.0,
        yaw=0.0,
        gyro_bias=1.0,
        accel_bias=1.0,
        at_rest=False,
        square_root=square_root,
        camera=CAMERA,
    )
    window, _ = make_window(flight)
    places = {int(stamp): place for place, stamp in enumerate(flight.stamps)}
    turned = Rotation.from_quat(CAMERA[:4]) * Rotation.from_rotvec([0.02, 0, 0])
    camera = np.r_[turned.as_quat(), np.add(CAMERA[4:], [0.0, 0.03, 0.0])]
    window |= {"priors": [prior.at(places)], "camera_from_imu": camera, "refine_camera": True}
    solved = _core.solve_window(window, {**SOLVE, "max_num_iterations": 0}, None)
    expected = 0.5 * ((0.02 / CAMERA_TURN) ** 2 + (0.03 / CAMERA_SHIFT) ** 2)
    assert solved["costs_before"]["prior"] == pytest.approx(expected, rel=1e-9)


@FORMS
def test_a_real_camera_is_refined(bundle_data: Path, square_root: bool) -> None:
    """From rest, where nothing tells its place: it used to wander, ATE 1 to 12 m."""
    real = read_track_csv(bundle_data / "vio" / "euroc_V1_01_tracks_imu_30s.csv")
    truth = load_trajectory(bundle_data / "vio" / "euroc_V1_01_ground_truth.csv")
    form = "square_root" if square_root else "information"
    found = run_odometry(real, refine_extrinsics=True, prior_form=form, time_budget=100.0)
    assert found.is_usable
    assert compare_trajectories(found.trajectory, truth).ate < 0.04
    assert sum(bool(record.alarms) for record in found.keyframes) < 3
