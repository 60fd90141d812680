"""Findings on a sequence, and its figures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bundle.inertial.vio.odometry import sequence_statistics
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
    assert found.count == 9
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


@pytest.mark.parametrize(
    ("ratio", "count"), [(1.0, 0), (1.45, 0), (1 / 1.45, 0), (1.55, 1), (1 / 1.55, 1)]
)
def test_a_calibrated_rate_that_the_samples_do_not_have(ratio: float, count: int) -> None:
    given = sequence(calibration=calibration(imu_rate=200 * ratio))
    found = [each for each in findings(given).values() if each.kind == "imu rate"]
    assert [each.is_fatal for each in found] == [False] * count
    assert all("200 Hz" in each.sentence for each in found)


@pytest.mark.parametrize("sensor", [0, 1])
@pytest.mark.parametrize(
    ("factor", "found", "is_fatal"),
    [(0.08, 1, False), (0.12, 0, False), (40.0, 0, False), (60.0, 1, True), (2e3, 0, False)],
)
def test_stated_noise_is_compared_with_that_of_the_samples(
    sensor: int, factor: float, found: int, is_fatal: bool
) -> None:
    rng = np.random.default_rng(0)
    true = 1e-3, 2e-2
    gyro, accel = (rng.normal(0, d * 200**0.5, (4001, 3)) for d in true)
    slow = np.sin(5e-3 * np.arange(4001))[:, None]
    stated = [d * (factor if k == sensor else 1.0) for k, d in enumerate(true)]
    given = sequence(
        imu_timestamps_ns=START + 5_000_000 * np.arange(4001),
        gyro=gyro + slow,
        accel=accel + [0, 0, 9.81] + 3 * slow,
        calibration=calibration(noise=replace(NOISE, gyro_noise_density=stated[0],
                                              accel_noise_density=stated[1])),
    )  # fmt: skip
    kinds = [each for each in findings(given).values() if each.kind == "noise"]
    assert len(kinds) == found
    if found:
        assert kinds[0].is_fatal == is_fatal
        assert ("gyro", "accel")[sensor] + "_noise_density" in kinds[0].sentence


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


def test_excitation_counts_while_there_are_images() -> None:
    given = sequence()
    accel = np.array(given.accel)
    accel[201:] *= 1 + 0.3 * np.sin(np.arange(200))[:, None]  # after the last image
    kept = given.track_timestamps_ns <= START + 1_000_000_000
    short = sequence(
        accel=accel,
        track_timestamps_ns=given.track_timestamps_ns[kept],
        track_ids=given.track_ids[kept],
        xy=given.xy[kept],
    )
    assert sequence_statistics(short).verdict == "unobservable"
    assert sequence_statistics(sequence(accel=accel)).verdict == "healthy"
