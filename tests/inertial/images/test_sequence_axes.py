"""Axes, units and clocks of given tracks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bundle.cli.main import main
from bundle.inertial.tracking import force_check, sequence_axes, track_turns
from bundle.inertial.tracking.sequence_axes import axes_findings, explanations
from bundle.inertial.tracking.track_turns import turns_of_tracks
from bundle.inertial.vio.sequence_images import SequenceImages
from bundle.inertial.vio.trajectory_comparison import states_at
from bundle.interface.finding import Finding
from bundle.io.sequences.sequence_folder import save_sequence
from bundle.model.sequence.sequence import Sequence
from bundle.synthetic.flight.synthetic_flight import SyntheticFlight, synthesize_flight


@pytest.fixture(scope="module")
def flight() -> SyntheticFlight:
    return synthesize_flight(motion="loop", duration=10.0, num_tracks=50, seed=4)


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer pairs of images and spans: enough here, and quick."""
    monkeypatch.setattr(sequence_axes, "MANY", 70)
    monkeypatch.setattr(force_check, "SPANS", 3)


def changed(flight: SyntheticFlight, gyro: Any = (1, 1, 1), accel: Any = (1, 1, 1)) -> Sequence:
    given = flight.sequence
    return replace(given, gyro=given.gyro * np.array(gyro), accel=given.accel * np.array(accel))


def test_turns_of_tracks_are_those_of_the_truth(flight: SyntheticFlight) -> None:
    images = SequenceImages(flight.sequence)
    turns = turns_of_tracks(images, 40)
    assert len(turns) > 30
    lens = Rotation.from_quat(flight.sequence.calibration.camera_from_imu[:4])
    errors = []
    for turn in turns:
        stamps = images.stamps[[turn.earlier, turn.later]]
        assert 0.2 < 1e-9 * (stamps[1] - stamps[0]) < 0.4
        one, other = Rotation.from_quat(states_at(flight.ground_truth, stamps)[:, :4])
        true = lens * other.inv() * one * lens.inv()
        errors.append((Rotation.from_matrix(turn.rotation) * true.inv()).magnitude())
    assert np.median(errors) < np.radians(0.4)


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
    monkeypatch.setattr(track_turns, "refined_rotation", lambda *given: given[2])
    images = SequenceImages(holed)
    covered = np.flatnonzero(images.covered)
    turns = turns_of_tracks(images, 1000)
    lens = Rotation.from_quat(given.calibration.camera_from_imu[:4])
    errors, angles = [], []
    for turn in turns:
        pair = covered[[turn.earlier, turn.later]]  # no image beyond the samples
        assert 0.25 <= 1e-9 * np.diff(images.stamps[pair])[0] <= 0.5
        one, other = Rotation.from_quat(states_at(flight.ground_truth, images.stamps[pair])[:, :4])
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
    assert explanations(flight.sequence, "S") == ()


def test_an_unknown_cause_does_not_refuse_a_sequence(
    flight: SyntheticFlight, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sequence_axes, "check_rotations", lambda *_: None)
    monkeypatch.setattr(sequence_axes, "turns_of_tracks", lambda *_: [])
    monkeypatch.setattr(sequence_axes, "share_unexplained", lambda *_: 1.0)
    monkeypatch.setattr(sequence_axes, "is_reversed", lambda _: False)
    for kind, is_problem, count in (("rotation", True, 0), ("axes", True, 1), ("axes", False, 0)):
        found = Finding(kind=kind, sentence="", is_problem=is_problem)
        monkeypatch.setattr(sequence_axes, "tracking_findings", lambda *_, found=found: (found,))
        assert len(axes_findings(flight.sequence, "S")) == count
    monkeypatch.setattr(sequence_axes, "tracking_findings", lambda *_: ())
    for signs, count in (((1, 1, 1), 0), (None, 0), ((1, -1, 1), 1)):
        monkeypatch.setattr(sequence_axes, "right_signs", lambda _, signs=signs: signs)
        assert len(explanations(flight.sequence, "S")) == count


@pytest.mark.parametrize(
    ("spans", "expected"),
    [
        ([(1.0, ""), (1.0, "bias")], True),
        ([(0.95, ""), (0.95, "")], True),
        ([(0.94, ""), (0.94, "")], False),
        ([(0.96, ""), (0.51, ""), (0.96, "")], True),
        ([(0.96, ""), (0.5, ""), (0.96, "")], False),
        ([(1.0, "")], False),
        ([(1.0, "no parallax"), (1.0, "")], False),
        ([], False),
    ],
)
def test_two_spans_behind_the_camera_and_none_before_it_are_reversed(
    monkeypatch: pytest.MonkeyPatch, spans: list[tuple[float, str]], expected: bool
) -> None:
    monkeypatch.setattr(force_check, "_spans", lambda _: iter(spans))
    monkeypatch.setattr(force_check, "_start", lambda _, span: span)
    assert force_check.is_reversed(None) == expected  # type: ignore[arg-type]


X, Y = (-1.0, 1.0, 1.0), (1.0, -1.0, 1.0)


@pytest.mark.parametrize(
    ("spans", "expected"),
    [
        ([{X}, {X}], (-1, 1, 1)),
        ([{X, Y}, {X}], (-1, 1, 1)),
        ([{X, Y}, {X, Y}], None),
        ([{X}, {Y}], None),
        ([{X}], None),
        ([{X}, {(1.0, 1.0, 1.0), Y}], None),
        ([{X}, {(1.0, 1.0, 1.0), Y}, {X}], (-1, 1, 1)),
    ],
)
def test_signs_that_explain_two_spans_alone_are_right(
    monkeypatch: pytest.MonkeyPatch, spans: list[set[Any]], expected: Any
) -> None:
    @dataclass
    class Given:
        accel: Any

    def start(images: Any, span: set[Any]) -> tuple[float, str]:
        return 0.0, "" if tuple(images.sequence.accel) in span else "bias"

    monkeypatch.setattr(force_check, "_spans", lambda _: iter(spans))
    monkeypatch.setattr(force_check, "_start", start)
    monkeypatch.setattr(
        force_check, "SequenceImages", lambda given: SimpleNamespace(sequence=given)
    )
    images: Any = SimpleNamespace(sequence=Given(np.ones(3)))
    assert force_check.right_signs(images) == expected


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


def test_a_reversed_accelerometer_is_refused_in_one_line(
    flight: SyntheticFlight, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_sequence(changed(flight, accel=(-1, -1, -1)), tmp_path / "s")
    target = tmp_path / "x.tum"
    assert main(["vio", str(tmp_path / "s"), "-o", str(target), "--quiet"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ") and said.count("\n") == 1 and "reversed" in said
    assert not target.exists()
