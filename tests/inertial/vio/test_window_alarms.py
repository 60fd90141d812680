"""Signs that are alarms at once, and signs that are once they persist."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bundle.inertial.vio.odometry import run_odometry
from bundle.inertial.vio.trajectory_comparison import compare_trajectories
from bundle.inertial.vio.window_alarms import LAGS, WindowAlarms, walks_down, yaw_falls
from bundle.interface.window_options import WindowOptions
from bundle.synthetic.synthetic_flight import synthesize_flight

HEALTHY = {"prior_asymmetry": 1e-16, "prior_ratio": 1e-3, "prior_definiteness": -1e-15}
SECOND = 10**9


def kinds(
    alarms: WindowAlarms, count: int = 1, at: int = 0, **changes: Any
) -> list[tuple[str, ...]]:
    """Return what so many keyframes in a row raise, a second apart."""
    found = []
    for k in range(count):
        given: dict[str, Any] = {
            "state": np.zeros(16),
            "nullity": (None, 4),
            "prior": HEALTHY,
            "prior_cost": (5.0, 60),
            "verdict": "healthy",
            "yaw": (None, 0.0),
        } | changes
        given["changes"] = alarms.bias_changes((at + k) * SECOND, given["state"])
        found.append(tuple(alarm.partition(":")[0] for alarm in alarms.of(**given)))
    return found


@pytest.fixture
def alarms() -> WindowAlarms:
    return WindowAlarms(WindowOptions(), (1e-4, 1e-2))


def test_a_healthy_keyframe_raises_none(alarms: WindowAlarms) -> None:
    assert kinds(alarms, 100) == [()] * 100


def test_no_excitation_has_to_last(alarms: WindowAlarms) -> None:
    quiet = kinds(alarms, 6, verdict="unobservable")
    assert [len(found) for found in quiet] == [0, 0, 0, 0, 1, 1]
    assert kinds(alarms) == [()]
    assert kinds(alarms, 4, verdict="unobservable") == [()] * 4


@pytest.mark.parametrize(
    ("cost", "expected"),
    [(59.0, [0, 0]), (61.0, [0, 1]), (-1e-3, [0, 0]), (-5.9, [0, 0]), (-6.1, [1, 1])],
)
def test_the_cost_of_a_prior_is_a_chi_square(
    alarms: WindowAlarms, cost: float, expected: list[int]
) -> None:
    found = kinds(alarms, 2, prior_cost=(cost, 60))
    assert [len(each) for each in found] == expected
    if sum(expected):
        word = "cost negative" if cost < 0 else "contradicted"
        assert word in found[-1][0]


@pytest.mark.parametrize("part", [10, 13])
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_bias_beyond_its_start_and_its_walk(part: int, sign: int) -> None:
    options = WindowOptions(start_gyro_bias_sigma=0.01, start_accel_bias_sigma=0.1)
    sigma, walk = (0.01, 1e-4) if part == 10 else (0.1, 1e-2)
    for factor, later, expected in ((5.9, 0, 0), (6.1, 0, 1), (6.1, 10000, 0)):
        alarms = WindowAlarms(options, (1e-4, 1e-2))
        start = np.zeros(16)
        start[part : part + 3] = 0.3
        kinds(alarms, state=start)
        state = start.copy()
        state[part + 1] += sign * factor * sigma
        assert np.sqrt(10000) * walk >= sigma  # the walk allows for it by then
        found = kinds(alarms, 2, at=later, state=state)
        assert [len(each) for each in found] == [0, expected]


@pytest.mark.parametrize("part", [10, 13])
def test_a_bias_that_changes_slowly_is_compared_with_all_its_estimates(part: int) -> None:
    """Steps of a sigma of the walk, 1e-4 or 1e-2, are noise; a slope of 0.4 of it is none."""
    walk, sensor = (1e-4, 0) if part == 10 else (1e-2, 1)

    def largest(biases: Any) -> tuple[float, float, float]:
        alarms = WindowAlarms(WindowOptions(), (1e-4, 1e-2))
        state = np.zeros(16)
        for k, bias in enumerate(biases):
            state[part : part + 3] = bias
            found = alarms.bias_changes(k * SECOND, state)
            alarms.know_biases(k * SECOND, state, (0.5 * walk) ** 2 * np.eye(15))
        assert found[0, 1 - sensor] == 0
        return tuple(found[:, sensor].tolist())

    rng = np.random.default_rng(1)
    assert largest(walk * rng.normal(size=(400, 3)).cumsum(axis=0))[0] < 5.0
    sigmas, size, seconds = largest(np.outer(np.arange(400), [0.0, 0.4 * walk, 0.0]))
    assert (size, seconds) == pytest.approx((399 * 0.4 * walk, 399))
    assert sigmas == pytest.approx(399 * 0.4 / np.sqrt(0.25 + 399))
    back = np.concatenate([np.linspace(0, 1, 200), np.linspace(1, 0, 201)])[:, None]
    assert largest(100 * walk * back)[1:] == pytest.approx((100 * np.sqrt(3) * walk, 201), rel=0.02)


@pytest.mark.parametrize(("speed", "bound"), [(0.0, 0.2), (4.0, 0.2), (30.0, 1.5)])
@pytest.mark.parametrize("part", [10, 13])
def test_a_bias_is_too_fast_by_its_effect_on_velocities(
    part: int, speed: float, bound: float
) -> None:
    """Ten sigmas of the bias are ten sigmas of the velocity, along its most uncertain axis."""
    turn = Rotation.random(random_state=1).as_matrix()
    for factor in (0.98, 1.02):
        alarms = WindowAlarms(WindowOptions(), (0.0, 0.0))
        covariance = np.diag(np.repeat([9.0, 1.0], [9, 6]))
        covariance[6:9, 6:9] = (factor * bound / 10) ** 2 * turn @ np.diag([0.5, 0.9, 1]) @ turn.T
        state = np.zeros(16)
        alarms.know_biases(0, state, covariance)
        state[7:10] = speed * turn[0]
        state[part : part + 3] = 10 * turn[2]
        name = "gyroscope" if part == 10 else "accelerometer"
        words = LAGS if factor > 1 else "changes"
        assert kinds(alarms, 2, state=state)[-1][-1] == f"{name} bias {words}"
    assert kinds(alarms, state=np.zeros(16)) == [()]


@pytest.mark.parametrize(
    ("rate", "force", "walk", "said", "is_usable"),
    [
        (0.0, 0.0, None, "", True),
        (0.02, 0.0, None, "gyroscope", True),
        (0.0, 0.4, None, "accelerometer", True),
        (0.0, 1.0, None, "accelerometer", False),
        (0.02, 0.0, 1e-3, "", True),  # as the alarm advises
    ],
)
def test_a_sensor_that_warms_up(
    rate: float, force: float, walk: float | None, said: str, is_usable: bool
) -> None:
    flight = synthesize_flight(motion="loop", seed=42, duration=16.0, num_tracks=60)
    given = flight.sequence
    share = np.linspace(0, 1, len(given.gyro))[:, None]
    noise = given.calibration.noise
    walk = walk or noise.gyro_bias_random_walk
    warm = replace(
        given,
        gyro=given.gyro + share * [0, rate, 0],
        accel=given.accel + share * [force, 0, 0],
        calibration=replace(given.calibration, noise=replace(noise, gyro_bias_random_walk=walk)),
    )
    found = run_odometry(warm, time_budget=100.0)
    alarms = {alarm.partition(":")[0] for each in found.keyframes for alarm in each.alarms}
    # Other alarms may also occur on the path that is not usable.
    assert alarms >= ({f"{said} bias changes"} if said else set())
    assert not is_usable or len(alarms) == bool(said)
    assert found.is_usable == is_usable
    assert (f"the {said} bias changed" in found.message) == (not is_usable)
    if rate and is_usable:
        error = compare_trajectories(found.trajectory, flight.ground_truth)
        assert error.ate == pytest.approx(0.08 if said else 0.03, abs=0.01)


def test_ratios_that_walk_down() -> None:
    rng = np.random.default_rng(1)
    noise = 0.1 * rng.normal(size=60)
    steps = np.arange(60)
    assert walks_down((10 ** (-3 - 0.04 * steps + noise)).tolist())
    assert not walks_down((10 ** (-3 - 0.04 * steps + noise)).tolist()[:49])
    assert not walks_down((10 ** (-3 - 0.015 * steps + noise)).tolist())  # less than a decade
    assert not walks_down((10 ** (-3 + 0.04 * steps + noise)).tolist())
    turns = np.where(steps < 35, steps, 30)
    assert not walks_down((10 ** (-3 - 0.08 * turns + noise)).tolist())


def test_a_ratio_that_walks_down_is_an_alarm_before_it_is_singular(alarms: WindowAlarms) -> None:
    found = [
        kinds(alarms, prior={**HEALTHY, "prior_ratio": 10 ** (-2 - 0.03 * k)})[0] for k in range(80)
    ]
    first = next(k for k, each in enumerate(found) if each)
    assert 45 < first < 60
    assert found[first] == ("prior loses digits",)


def test_a_sigma_of_yaw_that_falls() -> None:
    grows = np.linspace(1, 1.1, 30)
    turned = np.linspace(0, 3, 30)
    assert yaw_falls(grows.tolist(), turned.tolist()) is None
    spike = grows.copy()
    spike[10] = 5.0
    assert yaw_falls(spike.tolist(), turned.tolist()) is None
    falls = yaw_falls((grows[::-1]).tolist(), turned.tolist())
    assert falls is not None and falls[0] > falls[1]
    assert yaw_falls((grows[::-1]).tolist(), (0.05 * turned).tolist()) is None  # does not turn
    assert yaw_falls((1 - 0.005 * turned).tolist(), turned.tolist()) is None  # by 1.5 %


def test_two_checks_of_the_imu_have_to_agree(alarms: WindowAlarms) -> None:
    assert alarms.of_imu(None, is_new=False) == ()
    assert alarms.of_imu(9.0, is_new=True) == ()
    assert alarms.of_imu(9.0, is_new=False) == ()
    assert len(alarms.of_imu(8.0, is_new=True)) == 1
    assert len(alarms.of_imu(8.0, is_new=False)) == 1
    assert alarms.of_imu(2.0, is_new=True) == ()


@pytest.mark.parametrize("jacobians", ["first_estimate", "current"])
def test_a_flight_whose_yaw_nobody_measures(jacobians: str) -> None:
    flight = synthesize_flight(motion="loop", seed=11, duration=9.0, num_tracks=30)
    found = run_odometry(
        flight.sequence,
        jacobians=jacobians,
        covariance=True,
        start_yaw_sigma=6.0,
        start_position_sigma=0.1,
        time_budget=100.0,
    )
    said = Counter(a.partition(":")[0] for record in found.keyframes for a in record.alarms)
    assert set(said) == ({"sigma of yaw falls"} if jacobians == "current" else set())


@pytest.mark.parametrize(("motion", "seed"), [("loop", 3), ("room", 2)])
def test_a_healthy_flight_ends_without_an_alarm(motion: str, seed: int) -> None:
    flight = synthesize_flight(motion=motion, seed=seed, duration=6.0)
    found = run_odometry(flight.sequence, time_budget=100.0)
    assert found.keyframes[0].excitation_verdict == "unobservable"  # it rests
    assert not any(record.alarms for record in found.keyframes)


@pytest.mark.parametrize(("share", "seed"), [(0.1, 3), (0.1, 11), (0.05, 1), (0.05, 4), (0.02, 5)])
def test_wrong_tracks_in_the_prior_are_no_result(share: float, seed: int) -> None:
    """Some tracks are wrong, and only a loss rejects them."""
    flight = synthesize_flight(seed=seed, duration=6.0, num_tracks=40, outlier_share=share)
    found = run_odometry(flight.sequence, loss="trivial", time_budget=100.0)
    reasons = ("the prior was contradicted", "are far from", "contradicted each other")
    assert not found.is_usable and any(reason in found.message for reason in reasons)
    rejected = run_odometry(flight.sequence, time_budget=100.0)
    assert rejected.is_usable
    assert not any("prior contradicted" in a for r in rejected.keyframes for a in r.alarms)
