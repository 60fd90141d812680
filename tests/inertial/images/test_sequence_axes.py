"""Axes, units and clocks of given tracks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bundle.cli.main import main
from bundle.inertial.tracking import relative_rotation, sequence_axes
from bundle.inertial.tracking.relative_rotation import turns_of_tracks
from bundle.inertial.tracking.rotation_check import RotationCheck
from bundle.inertial.tracking.sequence_axes import (
    CLEAR,
    GIVEN,
    _recording,
    _Start,
    axes_findings,
    check_tracks,
    explanations,
    recording_findings,
)
from bundle.inertial.vio.sequence_images import SequenceImages
from bundle.inertial.vio.trajectory_comparison import states_at
from bundle.interface.finding import Finding
from bundle.io.sequences.sequence_folder import save_sequence
from bundle.model.sequence.sequence import Sequence
from bundle.synthetic.synthetic_flight import SyntheticFlight, synthesize_flight


@pytest.fixture(scope="module")
def flight() -> SyntheticFlight:
    return synthesize_flight(motion="loop", duration=10.0, num_tracks=50, seed=4)


pytestmark = pytest.mark.usefixtures("few")


@pytest.fixture(autouse=True)
def fewer_pairs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer pairs of images: enough here, and quick."""
    monkeypatch.setattr(sequence_axes, "MANY", 70)


def changed(flight: SyntheticFlight, gyro: Any = (1, 1, 1), accel: Any = (1, 1, 1)) -> Sequence:
    given = flight.sequence
    return replace(given, gyro=given.gyro * np.array(gyro), accel=given.accel * np.array(accel))


@pytest.mark.parametrize(("motion", "sign"), [("loop", 1), ("loop", -1), ("room", 1)])
def test_turns_of_tracks_are_those_of_the_truth(
    flight: SyntheticFlight, motion: str, sign: int
) -> None:
    """Reversed rates start far away; in a room, linear equations often do."""
    if motion == "room":
        flight = synthesize_flight(motion="room", duration=8.0, num_tracks=50, seed=5)
    images = SequenceImages(replace(flight.sequence, gyro=sign * flight.sequence.gyro))
    turns = turns_of_tracks(images, 40)
    assert len(turns) > 30
    lens = Rotation.from_quat(flight.sequence.calibration.camera_from_imu[:4])
    errors = []
    for turn in turns:
        stamps = np.array([turn.earlier, turn.later])
        assert 0.2 < 1e-9 * (stamps[1] - stamps[0]) < 0.4
        one, other = Rotation.from_quat(states_at(flight.ground_truth, stamps)[:, :4])
        true = lens * other.inv() * one * lens.inv()
        errors.append((Rotation.from_matrix(turn.rotation) * true.inv()).magnitude())
    assert np.quantile(errors, 0.75) < np.radians(0.55)


def test_images_without_tracks_do_not_move_pairs(flight: SyntheticFlight) -> None:
    given = flight.sequence
    stamps = np.unique(given.track_timestamps_ns)
    kept = given.track_timestamps_ns > stamps[20]
    holed = replace(
        given, track_timestamps_ns=given.track_timestamps_ns[kept],
        track_ids=given.track_ids[kept], xy=given.xy[kept],
    )  # fmt: skip
    recording = replace(_recording(holed, "S"), image_timestamps_ns=stamps)
    check = check_tracks(SequenceImages(holed), recording)
    assert check.unexplained < 0.2
    assert abs(check.time_shift) < 5e-3  # twenty images are a second


def test_pairs_have_a_quarter_of_a_second_inside_the_samples_and_start_near_the_truth(
    flight: SyntheticFlight, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = flight.sequence
    seconds = 1e-9 * (given.track_timestamps_ns - given.imu_timestamps_ns[0])
    kept = (seconds < 4.0) | (seconds > 4.8)
    inside = 1e-9 * (given.imu_timestamps_ns - given.imu_timestamps_ns[0])
    inside = (inside > 0.5) & (inside < 8.0)
    holed = replace(
        given, track_timestamps_ns=given.track_timestamps_ns[kept],
        track_ids=given.track_ids[kept], xy=given.xy[kept], gyro=given.gyro[inside],
        accel=given.accel[inside], imu_timestamps_ns=given.imu_timestamps_ns[inside],
    )  # fmt: skip
    start = lambda *given: (given[2], np.eye(3), 0)  # noqa: E731
    monkeypatch.setattr(relative_rotation, "refined_rotation", start)
    images = SequenceImages(holed)
    covered = images.stamps[images.covered]
    turns = turns_of_tracks(images, 1000)
    lens = Rotation.from_quat(given.calibration.camera_from_imu[:4])
    errors, angles = [], []
    for turn in turns:
        pair = np.array([turn.earlier, turn.later])
        assert np.isin(pair, covered).all()  # no image beyond the samples
        assert 0.25 <= 1e-9 * np.diff(pair)[0] <= 0.5
        one, other = Rotation.from_quat(states_at(flight.ground_truth, pair)[:, :4])
        true = lens * other.inv() * one * lens.inv()
        errors.append((Rotation.from_matrix(turn.rotation) * true.inv()).magnitude())
        angles.append(true.magnitude())
    assert len(turns) > 80
    assert np.median(errors) < 0.7 * np.median(angles)


@pytest.mark.parametrize(
    ("changes", "kind", "words"),
    [
        ({}, "", ""),
        ({"gyro": (-1, -1, -1)}, "axes", "axes -x -y -z"),
        ({"gyro": (1, 1, -1)}, "axes", "axes +x +y -z"),
        ({"gyro": np.full(3, 180 / np.pi)}, "gyro units", "degrees"),
        ({"accel": (-1, -1, -1)}, "accelerometer axes", "is reversed"),
    ],
)
def test_wrong_axes_are_found_before_the_odometry(
    flight: SyntheticFlight, changes: dict[str, Any], kind: str, words: str
) -> None:
    found = axes_findings(changed(flight, **changes), "S")
    assert [(each.kind, each.is_problem) for each in found] == ([(kind, True)] if kind else [])
    assert not kind or words in found[0].sentence


def test_one_reversed_axis_of_the_accelerometer_is_found_afterwards(
    flight: SyntheticFlight,
) -> None:
    wrong = changed(flight, accel=(-1, 1, 1))
    assert axes_findings(wrong, "S") == ()
    (found,) = explanations(wrong, "S")
    assert found.kind == "accelerometer axes"
    assert "-x +y +z" in found.sentence
    assert explanations(wrong, "S", [found]) == ()
    assert explanations(flight.sequence, "S") == ()


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_a_wrong_focal_length_accuses_rays_and_not_the_accelerometer(
    flight: SyntheticFlight, factor: float
) -> None:
    right = flight.sequence.calibration
    focal, *center = np.array(right.camera_params)[[0, 2, 3]]
    params = (factor * focal, factor * focal, *center)
    wrong = replace(flight.sequence, calibration=replace(right, camera_params=params))
    (found,) = explanations(wrong, "S")
    assert (found.kind, found.is_problem) == ("rotation", False)
    assert found.evidence["variance"] > 4
    for kind in ("noise", "stamps"):
        assert explanations(wrong, "S", [replace(found, kind=kind)]) == ()


def test_an_axis_that_is_dead_is_named(flight: SyntheticFlight) -> None:
    wrong = changed(flight, gyro=(1, 1, 0), accel=(0, 1, 1))
    found = explanations(wrong, "S")
    assert [each.kind for each in found] == 2 * ["constant axis"]
    for each, words in zip(
        found, ("gyro: expected axes that vary, found 0 on z", "0 on x"), strict=True
    ):
        assert words in each.sentence


def test_an_unknown_cause_does_not_refuse_a_sequence(
    flight: SyntheticFlight, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sequence_axes, "check_rotations", lambda *_: None)
    monkeypatch.setattr(sequence_axes, "turns_of_tracks", lambda *_: [])
    monkeypatch.setattr(sequence_axes, "share_unexplained", lambda *_: 1.0)
    monkeypatch.setattr(sequence_axes, "right_signs", lambda *_, **__: None)
    for kind, is_problem, count in (("rotation", True, 0), ("axes", True, 1), ("axes", False, 0)):
        found = Finding(kind=kind, sentence="", is_problem=is_problem)
        monkeypatch.setattr(sequence_axes, "tracking_findings", lambda *_, found=found: (found,))
        assert len(axes_findings(flight.sequence, "S")) == count
    monkeypatch.setattr(sequence_axes, "tracking_findings", lambda *_: ())
    for signs, count in ((None, 0), ((1, -1, 1), 1)):
        monkeypatch.setattr(sequence_axes, "right_signs", lambda _, signs=signs: signs)
        assert len(explanations(flight.sequence, "S")) == count


BEST, OTHER = (-1, 1, 1), (1, -1, 1)
ALL = tuple(product((1, -1), repeat=3))


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, BEST),
        ({OTHER: _Start("", 0.0, 100 + CLEAR - 0.01)}, None),
        ({OTHER: _Start("", 0.0, 100 + CLEAR + 0.01)}, BEST),
        ({OTHER: _Start("", 0.0, 90 + CLEAR - 0.01, prior=10.0)}, None),
        ({OTHER: _Start("", 0.0, 90 + CLEAR + 0.01, prior=10.0)}, BEST),
        ({BEST: _Start("no excitation", 0.0, 100.0)}, None),
    ],
)
def test_signs_of_a_span_are_clear_by_a_likelihood_ratio(
    changes: dict[Any, Any], expected: Any
) -> None:
    assert pytest.approx(2 * np.log(7e4)) == CLEAR
    starts = dict.fromkeys(ALL, _Start("points behind the camera", 1.0, 1e4))
    starts |= {BEST: _Start("", 0.0, 100.0), **changes}
    for variance in (1.0, 4.0):
        scaled = {
            signs: start._replace(misfit=variance * start.misfit, freedom=100)
            for signs, start in starts.items()
        }
        assert sequence_axes._clear_signs(scaled) == expected


UNCLEAR = None
PASSED, BEHIND, BETWEEN, QUIET = ("", 0.0), ("x", 0.95), ("x", 0.94), ("no excitation", 0.0)
STILL = ("no parallax", 1.0)


@pytest.mark.parametrize(
    ("spans", "gross", "after"),
    [
        ([(BEST, BEHIND), (BEST, BEHIND)], BEST, BEST),
        ([(BEST, BEHIND)], None, None),
        ([(BEST, STILL), (BEST, STILL)], None, None),
        ([], None, None),
        ([(BEST, BETWEEN), (BEST, BETWEEN)], None, BEST),
        ([(BEST, PASSED), (BEST, PASSED)], None, BEST),
        ([(BEST, BEHIND), (OTHER, BEHIND), (BEST, BEHIND)], None, None),
        ([(BEST, BEHIND), (UNCLEAR, BEHIND), (BEST, BEHIND)], BEST, BEST),
        ([(BEST, BEHIND), (UNCLEAR, QUIET), (BEST, BEHIND)], BEST, BEST),
        ([(BEST, BEHIND), (GIVEN, PASSED), (BEST, BEHIND)], None, None),
        ([(BEST, BEHIND), (UNCLEAR, PASSED), (BEST, BEHIND)], None, BEST),
    ],
)
def test_two_spans_name_the_signs_unless_one_before_contradicts(
    monkeypatch: pytest.MonkeyPatch, spans: list[Any], gross: Any, after: Any
) -> None:
    @dataclass
    class Given:
        accel: Any

    def start(images: Any, span: Any) -> _Start:
        best, given = span
        if best == tuple(images.sequence.accel):
            return _Start("", given[1] if best == GIVEN else 0.0, 1.0)
        return _Start(*given, misfit=2.0 if best is UNCLEAR else 100.0)

    monkeypatch.setattr(sequence_axes, "_spans", lambda _: iter(spans))
    monkeypatch.setattr(sequence_axes, "_start", start)
    monkeypatch.setattr(
        sequence_axes, "SequenceImages", lambda given: SimpleNamespace(sequence=given)
    )
    images: Any = SimpleNamespace(sequence=Given(np.ones(3)))
    assert sequence_axes.right_signs(images, is_gross=True) == gross
    assert sequence_axes.right_signs(images) == after


@pytest.mark.parametrize("milliseconds", [-100, 30, 130])
def test_a_wrong_clock_is_found_afterwards(flight: SyntheticFlight, milliseconds: int) -> None:
    stamps = flight.sequence.track_timestamps_ns + milliseconds * 1_000_000
    (found,) = explanations(replace(flight.sequence, track_timestamps_ns=stamps), "S")
    assert found.kind == "time offset"
    assert 1e3 * found.evidence["time_shift"] == pytest.approx(-milliseconds, abs=5)


def test_a_sensor_that_stops_is_its_own_cause(flight: SyntheticFlight) -> None:
    frozen = flight.sequence.gyro.copy()
    frozen[800:] = frozen[800]
    stopped = replace(flight.sequence, gyro=frozen)
    assert axes_findings(stopped, "S") == explanations(stopped, "S") == ()
    turned = RotationCheck(num_pairs=50, cause="axes", axes="+y -x +z")
    assert recording_findings(SequenceImages(stopped), _recording(stopped, "S"), turned) == ()


def test_wrong_axes_of_images_are_one_finding(flight: SyntheticFlight) -> None:
    """Forces are not tested with them: every test would find something."""
    wrong = changed(flight, accel=(-1, -1, -1))
    images, recording = SequenceImages(wrong), _recording(wrong, "S")
    for check in (
        RotationCheck(num_pairs=50, cause="axes", axes="+y -x +z"),
        RotationCheck(num_pairs=50, time_shift=0.02, time_sigma=1e-3),
    ):
        kinds = [each.kind for each in recording_findings(images, recording, check)]
        assert kinds == (["axes"] if check.cause else ["time offset", "accelerometer axes"])


def test_a_reversed_accelerometer_is_refused_in_one_line(
    flight: SyntheticFlight, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_sequence(changed(flight, accel=(-1, -1, -1)), tmp_path / "s")
    target = tmp_path / "x.tum"
    assert main(["vio", str(tmp_path / "s"), "-o", str(target), "--quiet"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ") and said.count("\n") == 1 and "reversed" in said
    assert not target.exists()
