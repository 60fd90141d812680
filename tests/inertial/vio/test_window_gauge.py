"""Windows stay where nothing says they should move, however exactly they are solved."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bundle import _core
from bundle.inertial.vio.marginal_prior import MarginalPrior
from bundle.inertial.vio.odometry import run_odometry
from bundle.inertial.vio.trajectory_comparison import compare_trajectories
from bundle.synthetic.synthetic_flight import synthesize_flight
from tests.inertial.vio.test_window_core import (
    SOLVE,
    make_window,
    oldest_goes,
    perturbed,
    shifted,
    without_oldest,
)
from tests.inertial.vio.window_scenes import FOCAL, Flight

EXACT = {**SOLVE, "function_tolerance": 0.0, "spectrum": False, "covariance": False}
FAR = np.array([3e4, -2e4, 500.0])


def after(window: dict[str, Any], iterations: int) -> Any:
    solved = _core.solve_window(window, {**EXACT, "max_num_iterations": iterations}, None)
    return np.asarray(solved["states"])


@pytest.fixture(scope="module", params=["no prior", "first estimates", "far away", "long"])
def window(request: pytest.FixtureRequest) -> dict[str, Any]:
    """Windows without a prior, with one, far from the origin, and with a sparse system."""
    flight = Flight(32 if request.param == "long" else 6, 6, landmarks=40)
    if request.param == "far away":
        flight.states[:, 4:7] += FAR
        flight.points += FAR
    made, _ = make_window(flight, noise=1 / FOCAL)
    if request.param != "first estimates":
        return perturbed(made, 1.0)
    found = _core.marginalize_window(made, oldest_goes(made))
    rest = shifted(without_oldest(made, found))
    touched = {b // 2 for b in rest["priors"][0]["blocks"]}
    flags = np.array([k in touched for k in range(len(rest["states"]))], np.uint8)
    return {**rest, "anchored": flags}


def test_more_steps_do_not_move_the_world(window: dict[str, Any]) -> None:
    """Converged after 30 steps; 70 more moved all frames together by what rounding says."""
    few, many = after(window, 30), after(window, 100)
    tolerance = 1e-4  # metres and radians
    np.testing.assert_allclose(many[:, 4:10], few[:, 4:10], rtol=0, atol=tolerance)
    turn = Rotation.from_quat(few[:, :4]).inv() * Rotation.from_quat(many[:, :4])
    assert np.abs(turn.as_rotvec()).max() < tolerance


def pull(window: dict[str, Any], position: float, yaw: float) -> dict[str, Any]:
    """Add a prior that wants the first state elsewhere: by (1, 2, 3) m, turned by 0.2 rad."""
    first = window["states"][0]
    up = Rotation.from_quat(first[:4]).as_matrix()[2]
    root = np.zeros((4, 6))
    root[0, :3] = up / yaw if yaw else 0.0
    root[1:, 3:] = np.eye(3) / position if position else 0.0
    prior = {
        "blocks": [0],
        "points": first[None],
        "square_root": True,
        "matrix": root,
        "vector": -root @ np.r_[0.2 * up, 1.0, 2.0, 3.0],
        "constant": 0.0,
    }
    return {**window, "priors": [prior]}


@pytest.mark.parametrize("held", [(0.01, 0.01), (0.01, 0.0), (0.0, 0.01), (0.0, 0.0), (1.0, 0.5)])
def test_what_a_prior_knows_moves_the_world(held: tuple[float, float]) -> None:
    made, _ = make_window(Flight(6, 6, landmarks=40))
    free, moved = after(made, 30), after(pull(made, *held), 60)
    wanted = np.array([1.0, 2.0, 3.0]) if held[0] else np.zeros(3)
    shift = moved[0, 4:7] - free[0, 4:7]
    turn = Rotation.from_quat(moved[0, :4]) * Rotation.from_quat(free[0, :4]).inv()
    if held[0]:
        np.testing.assert_allclose(shift, wanted, atol=1e-5)
    else:  # about the middle of the frames, which stays
        np.testing.assert_allclose(shift[2], 0, atol=1e-6)
        assert np.linalg.norm(moved[:, 4:7].mean(0) - free[:, 4:7].mean(0)) < 0.1
    np.testing.assert_allclose(turn.as_rotvec()[:2], 0, atol=1e-5)
    if held[1] or not held[0]:  # else the world turns, too, on its way to a position
        assert turn.as_rotvec()[2] == pytest.approx(0.2 if held[1] else 0.0, abs=1e-5)


@pytest.mark.parametrize("square_root", [False, True])
def test_a_prior_costs_nothing_at_its_own_minimum(square_root: bool) -> None:
    """The constant adds up earlier costs; steps must not count for less by it."""
    flight = Flight(6, 4, landmarks=30)
    window, _ = make_window(flight, noise=1 / FOCAL)
    found = _core.marginalize_window(window, oldest_goes(window, square_root=square_root))
    prior = MarginalPrior.of(found, [int(stamp) for stamp in flight.stamps])
    m, v = prior.matrix, prior.vector
    d = -np.linalg.pinv(m, rcond=1e-9) @ v if square_root else np.linalg.pinv(m, 1e-14) @ v
    value = 0.5 * np.sum((m @ d + v) ** 2) if square_root else 0.5 * d @ m @ d - v @ d
    assert found["least_cost"] > 1
    assert prior.constant + value == pytest.approx(0, abs=1e-4 * found["least_cost"])


@pytest.mark.parametrize(("motion", "seed"), [("loop", 4), ("room", 3)])
def test_the_error_does_not_depend_on_how_exactly_windows_are_solved(
    motion: str, seed: int
) -> None:
    flight = synthesize_flight(motion=motion, seed=seed, duration=8.0, num_tracks=30)
    errors = []
    for count in (8, 30, 100):
        found = run_odometry(
            flight.sequence,
            max_num_iterations=count,
            function_tolerance=1e-13,
            time_budget=100.0,
            pixel_sigma=1.0,
        )
        assert found.is_usable
        assert max(record.costs["prior"] for record in found.keyframes) < 20
        errors.append(compare_trajectories(found.trajectory, flight.ground_truth).ate)
    assert max(errors) < 1.1 * min(errors)
