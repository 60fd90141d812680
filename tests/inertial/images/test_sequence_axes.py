"""Axes, units and clocks of given tracks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bundle.cli.main import main
from bundle.inertial.tracking.sequence_axes import axes_findings, explanations
from bundle.inertial.tracking.track_turns import turns_of_tracks
from bundle.inertial.vio.sequence_images import SequenceImages
from bundle.inertial.vio.trajectory_comparison import states_at
from bundle.io.sequences.sequence_folder import save_sequence
from bundle.model.sequence.sequence import Sequence
from bundle.synthetic.flight.synthetic_flight import SyntheticFlight, synthesize_flight


@pytest.fixture(scope="module")
def flight() -> SyntheticFlight:
    return synthesize_flight(motion="loop", duration=10.0, seed=4)


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


@pytest.mark.parametrize("milliseconds", [-30, 30])
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
