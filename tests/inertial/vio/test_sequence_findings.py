"""Findings on a sequence, and its figures."""

from __future__ import annotations

import numpy as np
import pytest

from bundle.inertial.vio.sequence_statistics import sequence_statistics
from bundle.model.sequence.sequence import Sequence
from bundle.model.sequence.sequence_findings import SequenceFinding, sequence_findings
from tests.inertial.vio.sequences import NOISE, START, calibration, sequence


def findings(given: Sequence) -> dict[str, SequenceFinding]:
    found = sequence_findings(given, lambda row: f"S{row}", lambda row: f"O{row}")
    return {finding.kind: finding for finding in found}


def test_nothing_is_wrong_with_noise() -> None:
    assert findings(sequence()) == {}


def test_saturated_samples_are_found_with_their_row() -> None:
    accel = np.array(sequence().accel)
    accel[100:106, 1] = accel[200:203, 1] = 156.96
    found = findings(sequence(accel=accel))["saturated"]
    assert found.count == 6
    assert found.sentence.startswith("S100:")
    accel[100:103] = [0, 0, 9.81]
    assert "saturated" not in findings(sequence(accel=accel))


def test_degrees_gaps_images_without_samples_and_single_views_are_found() -> None:
    gyro = np.array(sequence().gyro)
    gyro[40:60] += [100, 0, 0]
    assert findings(sequence(gyro=gyro))["rate"].sentence.startswith("S40:")

    stamps = np.array(sequence().track_timestamps_ns)
    stamps[50:] += 1_500_000_000
    given = sequence(track_timestamps_ns=stamps)
    assert findings(given)["image gap"].sentence.startswith("O50:")
    assert findings(given)["no samples"].count == 11  # from 2.5 s to 3.5 s, behind the samples
    ids = np.arange(105)
    assert findings(sequence(track_ids=ids))["one view"].count == 105


def test_figures_are_those_that_the_sequence_was_made_with() -> None:
    rng = np.random.default_rng(0)
    size = 4001
    stamps = START + 5_000_000 * np.arange(size)
    given = sequence(
        imu_timestamps_ns=stamps,
        gyro=rng.normal(0, NOISE.gyro_noise_density * np.sqrt(200), (size, 3)),
        accel=rng.normal([0, 0, 9.81], NOISE.accel_noise_density * np.sqrt(200), (size, 3)),
        track_timestamps_ns=np.repeat(START + 1_000_000_000 * np.arange(21), 5),
        calibration=calibration(time_offset=-0.5),
    )
    statistics = sequence_statistics(given)
    assert statistics.imu_rate == pytest.approx(200)
    assert statistics.camera_rate == pytest.approx(1)
    assert statistics.gyro_noise_density == pytest.approx(NOISE.gyro_noise_density, rel=0.05)
    assert statistics.accel_noise_density == pytest.approx(NOISE.accel_noise_density, rel=0.05)
    assert statistics.overlap == pytest.approx(19.5)
    assert statistics.verdict == "unobservable"
    assert statistics.tracks_per_image["median"] == 5
    assert statistics.track_length["max"] == 21
    shaken = sequence(accel=given.accel[:401] * (1 + 0.2 * np.sin(np.arange(401))[:, None]))
    assert sequence_statistics(shaken).verdict == "healthy"
