"""The speed that is held where nothing excites the accelerometer."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from bundle import SlidingWindow
from bundle.inertial.vio.marginal_prior import steady_speed
from bundle.inertial.vio.odometry import OdometryResult, run_odometry
from bundle.inertial.vio.trajectory_comparison import states_at
from bundle.inertial.vio.window_alarms import NO_EXCITATION
from bundle.inertial.vio.window_frame import WindowFrame
from bundle.inertial.vio.window_telemetry import _speed_sigma
from bundle.reports.terminal.vio_reports import odometry_headline
from bundle.synthetic.synthetic_flight import synthesize_flight
from tests.inertial.vio.window_scenes import CAMERA, FOCAL, GRAVITY, NOISE, Flight

SIGMA = 0.05


def frames(seed: int = 0) -> list[WindowFrame]:
    rng = np.random.default_rng(seed)
    found = []
    for k in range(3):
        state = np.r_[0.0, 0.0, 0.0, 1.0, rng.normal(size=12)]
        state[7:10] += [4.0, 1.0, 0.0]
        frame = WindowFrame((k + 1) * (k + 1) * 10**8, state, None)  # type: ignore[arg-type]
        frame.anchor = state.copy()
        found.append(frame)
    return found


def by_hand(velocities: Any) -> Any:
    speeds = np.linalg.norm(np.reshape(velocities, (3, 3)), axis=1)
    return np.diff(speeds) / (SIGMA * np.array([0.3, 0.5]))


def test_rows_are_the_changes_of_speed_and_their_derivatives() -> None:
    given = frames()
    prior = steady_speed(given, SIGMA, square_root=True)
    assert prior is not None
    velocities = np.concatenate([frame.state[7:10] for frame in given])
    np.testing.assert_allclose(prior.vector, by_hand(velocities), rtol=1e-12)
    columns = np.concatenate([9 * k + np.arange(3) for k in range(3)])
    expected = approx_fprime(velocities, by_hand, 1e-7)
    np.testing.assert_allclose(prior.matrix[:, columns], expected, rtol=1e-5, atol=1e-5)
    assert not np.delete(prior.matrix, columns, axis=1).any()


def test_both_forms_are_one() -> None:
    root = steady_speed(frames(), SIGMA, square_root=True)
    form = steady_speed(frames(), SIGMA, square_root=False)
    assert root is not None and form is not None
    d = np.random.default_rng(3).normal(size=27)
    cost = form.constant - form.vector @ d + 0.5 * d @ form.matrix @ d
    rows = root.matrix @ d + root.vector
    assert cost == pytest.approx(0.5 * float(rows @ rows), rel=1e-10)


def test_yaw_stays_free_at_first_estimates() -> None:
    given = frames()
    for frame in given:
        frame.state[7:10] += [0.3, -0.2, 0.1]
    prior = steady_speed(given, SIGMA, square_root=True)
    assert prior is not None
    turned = np.zeros(27)
    for k, frame in enumerate(given):
        assert frame.anchor is not None
        turned[9 * k : 9 * k + 3] = np.cross(GRAVITY, frame.anchor[7:10])
    assert np.abs(prior.matrix @ turned).max() < 1e-10 * np.abs(prior.matrix).max()


def test_what_stands_has_no_speed_to_hold() -> None:
    given = frames()
    assert given[1].anchor is not None
    given[1].anchor[7:10] = [0.1, 0.0, 0.0]
    assert steady_speed(given, SIGMA, square_root=False) is None
    given[1].anchor = None
    assert steady_speed(given, SIGMA, square_root=False) is None
    assert steady_speed(given[:1], SIGMA, square_root=False) is None


def motorway(sigma: float) -> tuple[OdometryResult, Any, dict[int, float]]:
    """Follow a motorway; return the scale of the speed from the verdict on, and at each stamp."""
    flight = synthesize_flight(
        seed=1, duration=50.0, motion="motorway", camera_rate=5.0, num_tracks=30, track_length=15.0
    )
    result = run_odometry(
        flight.sequence,
        frame_rate=5.0,
        imu_noise_scale=1.0,
        steady_speed_sigma=sigma,
        time_budget=10.0,
        nullity=True,
    )
    stamps = result.trajectory.timestamps_ns
    quiet = [r.timestamp_ns for r in result.keyframes if r.excitation_verdict == "unobservable"]
    true = states_at(flight.ground_truth, stamps)
    scale = np.linalg.norm(result.trajectory.states[:, 7:10], axis=1)
    scale /= np.maximum(np.linalg.norm(true[:, 7:10], axis=1), 1e-9)
    late = stamps > next(s for s in quiet if s - stamps[0] > 12 * 10**9)
    return result, scale[late], dict(zip(stamps.tolist(), scale.tolist(), strict=True))


def test_a_window_holds_its_scale_where_nothing_excites_it() -> None:
    free, scale, scales = motorway(0.0)
    steady, held, _ = motorway(0.05)
    assert np.ptp(scale) > 0.02
    assert np.ptp(held) < 0.01
    for result in (free, steady):
        # Later the lever arm to the world's origin, 1 km, turns rounding into an eigenvalue.
        assert {record.nullity for record in result.keyframes[:100]} == {4}
    # the drift has a sigma, which the headline states
    known = [
        (record.timestamp_ns, record.speed_sigma)
        for record in free.keyframes
        if record.speed_sigma is not None and NO_EXCITATION in record.alarms
    ]
    errors = np.array([(scales[stamp] - 1) / sigma for stamp, sigma in known])
    assert len(known) > 50
    assert 0.3 < np.sqrt(np.mean(errors**2)) < 2.5
    largest = f"{100 * max(sigma for _, sigma in known):.2g} %"
    (said,) = [line for line in odometry_headline(free, None) if "excitation" in line]
    assert said == f"Without excitation, the scale has a standard deviation of up to {largest}."
    assert free.keyframes[-1].gyro_bias_sigma is None  # not requested


def test_the_sigma_of_a_speed_is_that_along_it() -> None:
    covariance, state = np.diag(np.full(15, 9.0)), np.zeros(16)
    covariance[6:9, 6:9] = np.diag([0.0, 0.25, 7.0])
    state[7:10] = 0.0, 5.0, 0.0
    assert _speed_sigma(covariance, state) == pytest.approx(0.1)
    assert _speed_sigma(None, state) is None
    state[8] = 0.49
    assert _speed_sigma(covariance, state) is None


def test_a_change_of_speed_goes_into_one_prior(monkeypatch: pytest.MonkeyPatch) -> None:
    """The one between the oldest two frames goes; solves have those of the frames that stay."""
    asked: list[list[int]] = []
    absorbed: list[tuple[int, int]] = []

    def spy(given: Any, sigma: float, square_root: bool) -> Any:
        asked.append([frame.stamp for frame in given])
        if len(given) == 2:
            absorbed.append((given[0].stamp, given[1].stamp))
        return steady_speed(given, sigma, square_root)

    monkeypatch.setattr("bundle.inertial.vio.sliding_window.steady_speed", spy)
    flight = Flight(14, 11, landmarks=80, speed=8.0, shake=0.0)
    settings: dict[str, Any] = {"window": 5, "min_parallax": 0.0, "min_translation": 0.0}
    window = SlidingWindow(CAMERA, NOISE, FOCAL, steady_speed_sigma=SIGMA, **settings)
    tracks, stamps = flight.tracks(), [int(stamp) for stamp in flight.stamps]
    window.start(stamps[:4], flight.states[:4], tracks[:4], flight.intervals[:3])
    for k in range(4, 14):
        window.add_frame(stamps[k], flight.intervals[k - 1], tracks[k])
    assert absorbed == list(pairwise(stamps))[: len(absorbed)]
    assert len(absorbed) == 14 - 6
    for given in asked:
        if len(given) > 2:
            assert given == stamps[stamps.index(given[0]) :][: len(given)]
    assert asked[-2][-1] == stamps[-1]


def test_an_excited_window_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any) -> None:
        raise AssertionError("steady_speed")

    monkeypatch.setattr("bundle.inertial.vio.sliding_window.steady_speed", fail)
    flight = Flight(6, 11, landmarks=80)
    window = SlidingWindow(CAMERA, NOISE, FOCAL, steady_speed_sigma=SIGMA)
    tracks, stamps = flight.tracks(), [int(stamp) for stamp in flight.stamps]
    window.start(stamps[:4], flight.states[:4], tracks[:4], flight.intervals[:3])
    window.add_frame(stamps[4], flight.intervals[3], tracks[4])
