"""The core's windows against residuals written anew, their numerical Jacobians, dense algebra."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bundle import _core
from bundle.errors import InputError
from bundle.inertial.vio.landmark_depths import Triangulation, camera_poses
from bundle.inertial.vio.landmark_table import landmark_table
from tests.inertial.vio.window_scenes import (
    CAMERA,
    FOCAL,
    GRAVITY,
    NOISE,
    Flight,
    jacobian,
    moved,
    residuals,
)

SOLVE = {
    "max_num_iterations": 60,
    "time_budget": 100.0,
    "function_tolerance": 1e-15,
    "spectrum": True,
    "covariance": True,
    "expected_imu_cost": False,
    "fix_gauge": True,
}


def make_window(
    flight: Flight, *, sigma: float = 1 / FOCAL, noise: float = 0.0, **changes: Any
) -> tuple[dict[str, Any], list[Any]]:
    """Return a window of all keyframes, and the preintegrated motions."""
    table = landmark_table(flight.tracks(noise))
    rotations, centres = camera_poses(flight.states, CAMERA)
    depths = Triangulation(rotations, centres, table, sigma).least_squares()
    motions = [
        interval.integrated(NOISE, state, "zero_order_hold")
        for interval, state in zip(flight.intervals, flight.states, strict=False)
    ]
    rng = np.random.default_rng(5)
    window: dict[str, Any] = {
        "states": flight.states,
        "anchors": flight.states,
        "anchored": np.zeros(len(flight.states), np.uint8),
        "camera_from_imu": CAMERA,
        "time_offset": 0.0,
        "refine_camera": False,
        "refine_time_offset": False,
        "points": np.c_[table.anchor_xy, depths],
        "anchor_states": table.anchors,
        "anchor_xy": table.anchor_xy,
        "anchor_velocity": rng.normal(0, 0.1, table.anchor_xy.shape),
        "landmarks": table.landmarks,
        "observers": table.observers,
        "xy": table.xy,
        "xy_velocity": rng.normal(0, 0.1, table.xy.shape),
        "sigma": sigma,
        "loss": "trivial",
        "loss_scale": 1.0,
        "gravity": GRAVITY,
        "imu": [motion.core_motion() for motion in motions],
        "priors": [],
    }
    return {**window, **changes}, motions


def size_of(window: dict[str, Any]) -> int:
    states, landmarks = len(window["states"]), len(window["points"])
    extra = 6 * window["refine_camera"] + window["refine_time_offset"]
    return 15 * states + 3 * landmarks + int(extra)


def perturbed(window: dict[str, Any], scale: float, seed: int = 3) -> dict[str, Any]:
    """Move states and depths away from the truth."""
    rng = np.random.default_rng(seed)
    sizes = scale * np.r_[[0.01] * 3, [0.05] * 3, [0.05] * 3, [0.002] * 3, [0.02] * 3]
    states = np.array([moved(s, sizes * rng.normal(size=15)) for s in window["states"]])
    points = window["points"].copy()
    points[:, 2] *= np.exp(scale * rng.normal(0, 0.05, len(points)))
    points[:, :2] += scale * rng.normal(0, 1e-3, (len(points), 2))
    return {**window, "states": states, "anchors": states, "points": points}


FREE = [(False, False), (True, True)]


@pytest.mark.parametrize(("camera", "offset"), FREE)
def test_the_cost_is_that_of_the_definition(camera: bool, offset: bool) -> None:
    flight = Flight(4, landmarks=12)
    window, motions = make_window(
        flight, noise=1 / FOCAL, refine_camera=camera, refine_time_offset=offset
    )
    window = perturbed(window, 1.0)
    solved = _core.solve_window(window, {**SOLVE, "max_num_iterations": 1}, None)
    r = residuals(window, motions, np.zeros(size_of(window)))
    assert sum(solved["costs_before"].values()) == pytest.approx(0.5 * r @ r, rel=1e-9)


@pytest.mark.parametrize(("camera", "offset"), FREE)
def test_the_first_step_is_levenberg_and_marquardts(camera: bool, offset: bool) -> None:
    flight = Flight(4, 1, landmarks=14)
    window, motions = make_window(
        flight, noise=1 / FOCAL, refine_camera=camera, refine_time_offset=offset
    )
    window = perturbed(window, 0.3)
    size = size_of(window)
    function = lambda x: residuals(window, motions, x)  # noqa: E731
    j, r = jacobian(function, size), function(np.zeros(size))
    scale = 1 / (1 + np.linalg.norm(j, axis=0))
    damping = np.clip((scale * np.linalg.norm(j, axis=0)) ** 2, 1e-6, 1e32) / scale**2 / 1e4
    step = np.linalg.solve(j.T @ j + np.diag(damping), -j.T @ r)
    solved = _core.solve_window(window, {**SOLVE, "max_num_iterations": 1}, None)
    assert solved["num_rejected"] == 0
    for k, state in enumerate(window["states"]):
        expected = moved(state, step[15 * k : 15 * k + 15])
        np.testing.assert_allclose(solved["states"][k], expected, rtol=0, atol=2e-6)
    at = 15 * len(window["states"])
    points = window["points"] + step[at : at + window["points"].size].reshape(-1, 3)
    np.testing.assert_allclose(solved["points"], points, rtol=0, atol=2e-6)
    if offset:
        assert solved["time_offset"] == pytest.approx(step[-1], abs=1e-6)


@pytest.mark.parametrize("keyframes", [5, 30])  # dense, and sparse by supernodes
def test_noiseless_windows_come_back_to_the_truth(keyframes: int) -> None:
    flight = Flight(keyframes, 2, landmarks=60)
    window, _ = make_window(flight, xy_velocity=None, anchor_velocity=None)
    window["xy_velocity"] = np.zeros_like(window["xy"])
    window["anchor_velocity"] = np.zeros_like(window["anchor_xy"])
    solved = _core.solve_window(perturbed(window, 0.3), SOLVE, None)
    assert sum(solved["costs_after"].values()) < 1e-9
    # Up to position and yaw, which nothing sees.
    difference = solved["states"][:, 13:16] - flight.accel_bias
    assert np.abs(difference).max() < 1e-4
    speeds = np.linalg.norm(solved["states"][:, 7:10], axis=1)
    np.testing.assert_allclose(speeds, np.linalg.norm(flight.states[:, 7:10], axis=1), rtol=1e-5)


def oldest_goes(window: dict[str, Any], **changes: Any) -> dict[str, Any]:
    states = np.zeros(len(window["states"]), np.uint8)
    states[0] = 1
    return {
        "states": states,
        "landmarks": (window["anchor_states"] == 0).astype(np.uint8),
        "imu": states[:-1],
        "keep_points": True,
        "square_root": False,
        "single_precision": False,
        **changes,
    }


def schur(window: dict[str, Any], motions: list[Any]) -> tuple[Any, Any]:
    """Lambda and eta of the kept states, camera and offset by dense numerical algebra."""
    goes = window["anchor_states"] == 0
    rows = np.repeat(np.r_[goes[window["landmarks"]], goes], 2)
    inertial = np.zeros(15 * len(motions), bool)
    inertial[:15] = True
    size = size_of(window)
    function = lambda x: residuals(window, motions, x)[np.r_[rows, inertial]]  # noqa: E731
    j, r = jacobian(function, size), function(np.zeros(size))
    n = 15 * len(window["states"])
    landmarks = n + np.arange(3 * len(goes))
    a = np.r_[np.arange(15), landmarks[np.repeat(goes, 3)]]
    b = np.r_[np.arange(15, n), np.arange(n + 3 * len(goes), size)]
    h, g = j.T @ j, j.T @ r
    gain = np.linalg.solve(h[np.ix_(a, a)], np.c_[h[np.ix_(a, b)], g[a]])
    return h[np.ix_(b, b)] - h[np.ix_(b, a)] @ gain[:, :-1], h[np.ix_(b, a)] @ gain[:, -1] - g[b]


def spread(found: dict[str, Any], window: dict[str, Any]) -> tuple[Any, Any]:
    """A prior's Lambda and eta over all kept coordinates."""
    prior, states = found["prior"], len(window["states"])
    at: list[int] = []
    for block in prior["blocks"]:
        if block < 2 * states:
            begin = 15 * (block // 2 - 1) + 6 * (block % 2)
            at += range(begin, begin + (9 if block % 2 else 6))
        else:
            begin = 15 * (states - 1) + (0 if block == 2 * states else 6)
            at += range(begin, begin + (6 if block == 2 * states else 1))
    total = 15 * (states - 1) + 6 * window["refine_camera"] + window["refine_time_offset"]
    m, v = prior["matrix"], prior["vector"]
    lambda_, eta = (m.T @ m, -m.T @ v) if prior["square_root"] else (m, v)
    out, vector = np.zeros((total, total)), np.zeros(total)
    out[np.ix_(at, at)], vector[at] = lambda_, eta
    return out, vector


@pytest.mark.parametrize("square_root", [False, True])
@pytest.mark.parametrize(("camera", "offset"), FREE)
def test_marginalization_is_the_schur_complement(
    camera: bool, offset: bool, square_root: bool
) -> None:
    flight = Flight(4, 3, landmarks=14)
    window, motions = make_window(
        flight, noise=1 / FOCAL, refine_camera=camera, refine_time_offset=offset
    )
    window = perturbed(window, 0.2)
    found = _core.marginalize_window(window, oldest_goes(window, square_root=square_root))
    assert found["is_regular"]
    assert found["num_landmarks"] == np.sum(window["anchor_states"] == 0)
    lambda_, eta = spread(found, window)
    expected, expected_eta = schur(window, motions)
    size = np.abs(expected).max()
    np.testing.assert_allclose(lambda_, expected, rtol=0, atol=1e-6 * size)
    np.testing.assert_allclose(eta, expected_eta, rtol=0, atol=1e-6 * np.abs(expected_eta).max())


def without_oldest(window: dict[str, Any], found: dict[str, Any]) -> dict[str, Any]:
    """Return the window that is left, with its prior."""
    stays = window["anchor_states"] != 0
    rows = stays[window["landmarks"]]
    renumbered = np.cumsum(stays) - 1
    prior = found["prior"]
    return {
        **window,
        "states": window["states"][1:],
        "anchors": window["anchors"][1:],
        "anchored": window["anchored"][1:],
        "points": window["points"][stays],
        "anchor_states": window["anchor_states"][stays] - 1,
        "anchor_xy": window["anchor_xy"][stays],
        "anchor_velocity": window["anchor_velocity"][stays],
        "landmarks": renumbered[window["landmarks"][rows]],
        "observers": window["observers"][rows] - 1,
        "xy": window["xy"][rows],
        "xy_velocity": window["xy_velocity"][rows],
        "imu": window["imu"][1:],
        "priors": [{**prior, "blocks": [b - 2 for b in prior["blocks"]]}],
    }


@pytest.mark.parametrize("square_root", [False, True])
@pytest.mark.parametrize("anchored", [0, 1])
def test_what_is_left_keeps_the_minimum(square_root: bool, anchored: int) -> None:
    """At the batch's minimum the prior's gradient balances that of the factors that stay."""
    flight = Flight(6, 4, landmarks=30)
    window, _ = make_window(flight, noise=1 / FOCAL)
    solved = _core.solve_window(window, SOLVE, None)
    window = {
        **window,
        "states": solved["states"],
        "anchors": solved["states"],
        "anchored": np.full(6, anchored, np.uint8),
        "points": solved["points"],
    }
    found = _core.marginalize_window(window, oldest_goes(window, square_root=square_root))
    rest = without_oldest(window, found)
    again = _core.solve_window(rest, SOLVE, None)
    np.testing.assert_allclose(again["states"], solved["states"][1:], rtol=0, atol=1e-6)
    before, after = sum(solved["costs_after"].values()), sum(again["costs_before"].values())
    assert after == pytest.approx(before, rel=1e-9)  # the prior's constant is what is left of them


def shifted(window: dict[str, Any], seed: int = 7) -> dict[str, Any]:
    """Move the current states off their anchors."""
    return {**perturbed(window, 0.3, seed), "anchors": window["states"]}


@pytest.mark.parametrize("keep", [True, False])
def test_both_forms_say_the_same_off_their_points(keep: bool) -> None:
    """Marginalising once more, with states that have moved since, in both forms."""
    flight = Flight(7, 5, landmarks=40)
    window, _ = make_window(flight, noise=1 / FOCAL)
    forms = []
    for form in (False, True):
        found = _core.marginalize_window(window, oldest_goes(window, square_root=form))
        rest = shifted(without_oldest(window, found))
        twice = _core.marginalize_window(
            rest, oldest_goes(rest, square_root=form, keep_points=keep)
        )
        forms.append((spread(twice, rest), twice["prior"]["points"]))
    (a, eta_a), (b, eta_b) = forms[0][0], forms[1][0]
    np.testing.assert_allclose(a, b, rtol=0, atol=1e-8 * np.abs(a).max())
    np.testing.assert_allclose(eta_a, eta_b, rtol=0, atol=1e-8 * np.abs(eta_a).max())
    np.testing.assert_array_equal(forms[0][1], forms[1][1])


def test_first_estimates_keep_four_free_directions() -> None:
    flight = Flight(6, 6, landmarks=40)
    window, _ = make_window(flight, noise=1 / FOCAL)
    assert nullity(window) == 4
    found = _core.marginalize_window(window, oldest_goes(window))
    rest = shifted(without_oldest(window, found))
    touched = {b // 2 for b in rest["priors"][0]["blocks"]}
    flags = np.array([k in touched for k in range(len(rest["states"]))], np.uint8)
    assert nullity({**rest, "anchored": flags}) == 4
    assert nullity(rest) == 3  # yaw seems known


def nullity(window: dict[str, Any]) -> int:
    values = _core.solve_window({**window}, {**SOLVE, "max_num_iterations": 0}, None)["spectrum"]
    return int(np.sum(np.array(values) < len(values) * np.finfo(float).eps * values[-1]))


def test_the_covariance_is_that_of_the_gauge() -> None:
    """Biases and tilt do not depend on which position and yaw are held."""
    flight = Flight(5, 8, landmarks=25)
    window, motions = make_window(flight, noise=1 / FOCAL)
    solved = _core.solve_window(window, SOLVE, None)
    window = {**window, "states": solved["states"], "points": solved["points"]}
    j = jacobian(lambda x: residuals(window, motions, x), size_of(window))
    inner = np.linalg.pinv(j.T @ j, rcond=1e-14)
    last = slice(15 * 4 + 9, 15 * 5)
    np.testing.assert_allclose(
        solved["covariance"][9:, 9:], inner[last, last], rtol=1e-3, atol=1e-12
    )


def test_what_imu_factors_should_cost() -> None:
    flight = Flight(4, 8, landmarks=12)
    window, motions = make_window(flight, sigma=0.1 / FOCAL, noise=0.1 / FOCAL)
    solved = _core.solve_window(window, {**SOLVE, "expected_imu_cost": True}, None)
    window = {**window, "states": solved["states"], "points": solved["points"]}
    j = jacobian(lambda x: residuals(window, motions, x), size_of(window))
    follows = np.diag(j @ np.linalg.pinv(j, rcond=1e-9))  # share that states can follow
    of_imu = len(j) - 15 * len(motions) + np.arange(15 * len(motions)).reshape(-1, 15)[:, :9]
    degrees = np.sum(1 - follows[of_imu])
    assert 1 < degrees < of_imu.size
    assert solved["expected_imu_cost"] == pytest.approx(0.5 * degrees, rel=1e-4)


def test_states_without_images_follow_their_imu() -> None:
    """A long chain has a sparse system: as many rows as unknowns cost nothing."""
    flight = Flight(40, 8, landmarks=1)
    window, motions = make_window(flight)
    nothing = {
        "points": np.zeros((0, 3)), "anchor_xy": np.zeros((0, 2)), "xy": np.zeros((0, 2)),
        "anchor_velocity": np.zeros((0, 2)), "xy_velocity": np.zeros((0, 2)),
        "anchor_states": np.zeros(0, np.int32), "landmarks": np.zeros(0, np.int32),
        "observers": np.zeros(0, np.int32),
    }  # fmt: skip
    prior = {
        "blocks": [0, 1], "points": np.repeat(flight.states[:1], 2, axis=0), "square_root": True,
        "matrix": 10 * np.eye(15), "vector": np.zeros(15), "constant": 0.0,
    }  # fmt: skip
    options = {**SOLVE, "expected_imu_cost": True, "fix_gauge": False}
    solved = _core.solve_window({**window, **nothing, "priors": [prior]}, options, None)
    assert abs(solved["expected_imu_cost"]) < 1e-5 * 9 * len(motions)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("states", np.full((4, 16), np.nan)),
        ("landmarks", np.array([99])),
        ("observers", np.array([-1])),
        ("sigma", 0.0),
        ("imu", []),
        ("anchored", np.zeros(2, np.uint8)),
        ("gravity", np.zeros(2)),
    ],
)
def test_arrays_that_do_not_fit_are_refused(name: str, value: Any) -> None:
    window, _ = make_window(Flight(4, landmarks=8))
    with pytest.raises(InputError, match=name):
        _core.solve_window({**window, name: value}, SOLVE, None)


def test_landmarks_that_stay_may_not_lose_their_anchor() -> None:
    window, _ = make_window(Flight(4, landmarks=8))
    request = oldest_goes(window, landmarks=np.zeros(len(window["points"]), np.uint8))
    with pytest.raises(InputError, match="landmark"):
        _core.marginalize_window(window, request)


def test_a_landmark_behind_a_camera_is_refused_at_the_start() -> None:
    window, _ = make_window(Flight(4, landmarks=8))
    points = window["points"].copy()
    points[:, 2] = 50.0  # two centimetres ahead, and passed by the next image
    with pytest.raises(InputError, match="in front of the cameras"):
        _core.solve_window({**window, "points": points}, SOLVE, None)
