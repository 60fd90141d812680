"""Runs that end as unusable: their rules on both sides, and what is left of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bundle.cli.main import main
from bundle.errors import InputError
from bundle.inertial.vio.keyframe_record import KeyframeRecord
from bundle.inertial.vio.odometry import OdometryResult, run_odometry
from bundle.inertial.vio.sliding_window import SlidingWindow
from bundle.inertial.vio.window_alarms import DISAGREEMENT, LAGS, WindowAlarms
from bundle.inertial.vio.window_run import WindowRun, _lost_reason, _out_of_time
from bundle.interface.window_options import WindowOptions
from bundle.io.sequences.sequence_folder import save_sequence
from bundle.io.sequences.trajectory_files import load_tum
from bundle.reports.terminal.vio_reports import odometry_headline
from bundle.synthetic.synthetic_flight import SyntheticFlight, synthesize_flight

SECOND = 10**9


@pytest.fixture(scope="module")
def flight() -> SyntheticFlight:
    return synthesize_flight(duration=4.0, rest=1.5, num_tracks=20, seed=2)


@pytest.fixture(scope="module")
def result(flight: SyntheticFlight) -> OdometryResult:
    return run_odometry(flight.sequence, time_budget=100.0)


def records(result: OdometryResult, changed: dict[int, dict[str, Any]]) -> list[KeyframeRecord]:
    """Return 100 records, one every half second, some of them changed."""
    plain = replace(result.keyframes[-1], alarms=(), prior_definiteness=0.0)
    return [replace(plain, timestamp_ns=k * SECOND // 2, **changed.get(k, {})) for k in range(100)]


@pytest.mark.parametrize(("factor", "expected"), [(0.5, "2 times faster"), (4, "4 times slower")])
def test_the_pace_is_relative_to_real_time(
    result: OdometryResult, factor: float, expected: str
) -> None:
    slowed = replace(result, solve_time=factor * result.duration)
    assert f"({expected} than real time)" in odometry_headline(slowed, None)[0]


def test_camera_and_imu_may_contradict_each_other_at_a_fifth_of_the_keyframes(
    result: OdometryResult,
) -> None:
    alarm = {"alarms": (f"{DISAGREEMENT}: the IMU cost is high",)}
    for count, expected in ((20, ""), (21, "21 of 100")):
        found = _lost_reason(records(result, {4 * k: alarm for k in range(count)}))
        assert expected in found and bool(found) == bool(expected)


def test_a_burst_of_contradictions_counts(result: OdometryResult) -> None:
    alarm = {"alarms": (f"{DISAGREEMENT}: the IMU cost is high",)}
    for last, expected in ((46, ""), (47, "3.5 s")):  # from 40 on: 3 and 3.5 s
        found = _lost_reason(records(result, dict.fromkeys(range(40, last + 1), alarm)))
        assert expected in found and bool(found) == bool(expected)


@pytest.mark.parametrize("name", ["gyroscope", "accelerometer"])
@pytest.mark.parametrize("fast", [True, False])
def test_a_bias_may_change_too_fast_at_a_tenth_of_the_keyframes(
    result: OdometryResult, name: str, fast: bool
) -> None:
    alarm = {"alarms": (f"{name} bias {LAGS if fast else 'changes'}: by 1 rad/s",)}
    for count, expected in ((10, ""), (11, f"the {name} bias" if fast else "")):
        found = _lost_reason(records(result, dict.fromkeys(range(count), alarm)))
        assert expected in found and bool(found) == bool(expected)
        assert ("11 of 100" in found) == bool(expected)
    assert _lost_reason([]) == ""


def test_a_short_run_without_excitation_gets_its_alarm_at_the_end(result: OdometryResult) -> None:
    run = object.__new__(WindowRun)
    for count, verdict, expected in (
        (1, "unobservable", 1), (4, "unobservable", 1), (5, "unobservable", 0), (4, "healthy", 0),
    ):  # fmt: skip
        quiet = {"excitation_verdict": "unobservable"}
        known = records(result, dict.fromkeys(range(count), quiet))[:count]
        known[0] = replace(known[0], excitation_verdict=verdict)
        run.window = SimpleNamespace(records=known)  # type: ignore[assignment]
        found = run.records()
        assert [len(each.alarms) for each in found] == [0] * (count - 1) + [expected]
    run.window = SimpleNamespace(records=[])  # type: ignore[assignment]
    assert run.records() == ()


def test_a_budget_that_ends_more_than_half_of_the_solves_before_a_step_counts(
    result: OdometryResult,
) -> None:
    late = {"out_of_time": True, "num_iterations": 0}
    for count, expected in ((50, ""), (51, "51 of 100")):
        found = _out_of_time(records(result, dict.fromkeys(range(count), late)))
        assert expected in found and bool(found) == bool(expected)
    stepped = {"out_of_time": True, "num_iterations": 1}
    assert _out_of_time(records(result, dict.fromkeys(range(100), stepped))) == ""


def test_a_contradicted_prior_counts_at_a_tenth(result: OdometryResult) -> None:
    alarm = {"alarms": ("prior contradicted: it costs 100 with 60 coordinates",)}
    for count, expected in ((10, ""), (11, "11 of 100")):
        found = _lost_reason(records(result, {4 * k: alarm for k in range(count)}))
        assert expected in found and bool(found) == bool(expected)


def test_an_indefinite_prior_counts_at_a_fifth(result: OdometryResult) -> None:
    for count, expected in ((20, False), (21, True)):
        changed = {k: {"prior_definiteness": -1e-8} for k in range(count)}
        assert bool(_lost_reason(records(result, changed))) == expected


@pytest.mark.parametrize(("share", "images", "every", "is_lost"), [
    (0.51, 6, 1, True), (0.51, 5, 1, False), (0.5, 10, 1, False), (0.51, 10, 2, False),
])  # fmt: skip
def test_tracks_far_from_their_landmarks(
    flight: SyntheticFlight, monkeypatch: pytest.MonkeyPatch, share: float, images: int,
    every: int, is_lost: bool,
) -> None:  # fmt: skip
    reject, calls = SlidingWindow._reject, []

    def far(self: SlidingWindow, table: Any, norms: Any) -> None:
        reject(self, table, norms)
        calls.append(1)
        if 5 <= len(calls) < 5 + images * every and len(calls) % every == 0:
            self.far_share = share

    monkeypatch.setattr(SlidingWindow, "_reject", far)
    found = run_odometry(flight.sequence, time_budget=100.0)
    assert ("far from" in found.message) == is_lost
    assert found.is_usable != is_lost


def test_the_share_of_far_observations_is_that_of_the_newest_image(
    flight: SyntheticFlight,
) -> None:
    stamps = np.unique(flight.sequence.track_timestamps_ns)
    xy = flight.sequence.xy.copy()
    late = flight.sequence.track_timestamps_ns >= stamps[60]
    odd = flight.sequence.track_ids % 4 == 0
    xy[late & odd] += 200.0
    shares = []
    reject = SlidingWindow._reject

    def watched(self: SlidingWindow, table: Any, norms: Any) -> None:
        reject(self, table, norms)
        shares.append((self.frames[-1].stamp, self.far_share))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SlidingWindow, "_reject", watched)
        run_odometry(replace(flight.sequence, xy=xy), time_budget=100.0)
    assert max(share for stamp, share in shares if stamp < stamps[60]) == 0
    first = next(share for stamp, share in shares if stamp >= stamps[60])
    assert 0.05 < first < 0.5


@pytest.mark.parametrize("jump", [0.0, 0.5])
def test_new_landmarks_without_parallax_do_not_hide_those_that_are_far(jump: float) -> None:
    given = synthesize_flight(motion="hover", duration=18.0, num_tracks=60, seed=5).sequence
    late = given.imu_timestamps_ns >= given.imu_timestamps_ns[0] + 14 * SECOND
    accel = given.accel + late[:, None] * [jump, 0, 0]
    found = run_odometry(replace(given, accel=accel), time_budget=100.0)
    assert ("far from" in found.message) == (jump > 0)
    assert found.is_usable == (jump == 0)


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize("where", ["start", "add_frame"])
def test_a_window_without_a_solution_ends_as_lost_with_report_and_trajectory(
    where: str, flight: SyntheticFlight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    original, calls = getattr(SlidingWindow, where), []

    def fails(self: SlidingWindow, *given: Any, **named: Any) -> Any:
        calls.append(1)
        found = original(self, *given, **named)
        if where == "start" or len(calls) > 20:
            raise InputError("window: expected eliminated landmarks in front of the camera")
        return found

    monkeypatch.setattr(SlidingWindow, where, fails)
    save_sequence(flight.sequence, tmp_path / "s")
    target, report = tmp_path / "x.tum", tmp_path / "x.json"
    arguments = [str(tmp_path / "s"), "-o", str(target), "--json", str(report), "--quiet"]
    assert main(["vio", *arguments]) == 1
    said = capsys.readouterr()
    assert "no solution" in said.out and said.err == ""
    assert report.exists()
    assert len(load_tum(target).timestamps_ns) == (4 if where == "start" else 24)


def test_a_more_robust_loss_is_not_advised_to_those_who_use_it() -> None:
    for loss, expected in (("cauchy", False), ("huber", True), ("trivial", True)):
        alarms = WindowAlarms(WindowOptions(loss=loss), (1e-4, 1e-2))
        prior = {"prior_asymmetry": 0.0, "prior_ratio": 1e-3, "prior_definiteness": 0.0}
        for k in range(2):
            state = np.zeros(16)
            changes = alarms.bias_changes(k, state)
            said = alarms.of(state, (None, 4), prior, (100.0, 60), "healthy", (None, 0.0), changes)
        assert ("--loss" in " ".join(said)) == expected
