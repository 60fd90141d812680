"""Faults of IMU samples: each kind on both sides of its bounds, and sensors without faults."""

import numpy as np
import pytest

import bundle
from bundle.inertial.preintegration.sample_faults import faulty_rows, sample_faults
from bundle.io.sequences.track_csv import read_track_csv

RNG = np.random.default_rng(4)
GYRO = RNG.normal(0, 0.01, (2000, 3))
ACCEL = np.array([0, 0, 9.81]) + RNG.normal(0, 0.1, (2000, 3))


def faults(gyro=GYRO, accel=ACCEL):
    return [
        (one.kind, one.sensor, one.first, one.last, len(one.rows))
        for one in sample_faults(gyro, accel)
    ]


def changed(values, rows, change):
    copy = values.copy()
    copy[rows] = change
    return copy


def test_a_run_is_frozen_from_ten_rows_on():
    for count, found in ((9, []), (10, [("frozen", "gyroscope", 500, 509, 10)])):
        rows = slice(500, 500 + count)
        assert faults(gyro=changed(GYRO, rows, GYRO[500])) == found
    accel = changed(ACCEL, slice(1990, 2000), ACCEL[1990])
    assert faults(accel=accel) == [("frozen", "accelerometer", 1990, 1999, 10)]


def test_a_slower_sensor_holds_its_values():
    held = np.repeat(ACCEL[:500], 4, axis=0)  # its runs have 4 rows
    assert faults(accel=held) == []
    for runs, found in ((8, []), (9, [("frozen", "accelerometer", 400, 435, 36)])):
        slow = held.copy()
        slow[400 : 400 + 4 * runs] = held[400]
        assert faults(accel=slow) == found


def test_a_frozen_run_ends_in_a_change():
    """Changes of 1 elsewhere; those at both ends of the run are smaller."""
    walk = np.cumsum(np.r_[np.ones(1000), -np.ones(1000)])
    for change, count in ((0.09, 0), (0.11, 1)):
        steps = np.diff(walk, prepend=0.0)
        steps[700:740] = 0.0
        steps[[700, 740]] = change
        values = np.column_stack([np.cumsum(steps), np.zeros(2000), np.zeros(2000)])
        assert len([one for one in sample_faults(values, ACCEL) if one.kind == "frozen"]) == count


def test_a_rest_at_the_begin_is_not_frozen_unless_it_ends_in_a_leap():
    for change, count in ((2.9, 0), (3.1, 1)):
        steps = np.r_[np.zeros(100), np.tile([1.0, -1.0], 950)]
        steps[100] = change
        values = np.column_stack([np.cumsum(steps), np.zeros(2000), np.zeros(2000)])
        assert len([one for one in sample_faults(values, ACCEL) if one.kind == "frozen"]) == count


def test_forces_of_zero_are_a_fault_and_rates_of_zero_are_not():
    assert faults(accel=changed(ACCEL, 30, 0.0)) == [("zero", "accelerometer", 30, 30, 1)]
    assert faults(accel=changed(ACCEL, 30, [0.0, 0.0, 1e-3]))[0][0] == "spike"
    assert faults(gyro=changed(GYRO, slice(30, 35), 0.0)) == []
    both = faults(changed(GYRO, slice(30, 60), 0.0), changed(ACCEL, slice(30, 60), 0.0))
    assert both == [
        ("frozen", "gyroscope", 30, 59, 30), ("zero", "accelerometer", 30, 59, 30),
    ]  # fmt: skip


@pytest.mark.parametrize("sign", [1, -1])
def test_a_range_ends_where_values_pile_up(sign):
    def at(rows):
        values = ACCEL.copy()
        values[rows, 1] = sign * 0.6
        return faults(accel=values)

    run = [100, 101, 102, 103]
    assert at([*run, 300, 400, 500]) == []
    assert at([*run, 300, 400, 500, 600]) == [("clipped", "accelerometer", 100, 600, 8)]
    assert at([*run[:3], 200, 300, 400, 500, 600]) == []
    assert faults(accel=np.clip(ACCEL, -9.85, 9.85))[0][:2] == ("clipped", "accelerometer")


def test_levels_of_a_quantised_sensor_do_not_pile_up():
    assert faults(np.round(GYRO, 2), np.round(ACCEL, 1)) == []
    axis = np.repeat([0.5, 0.4, 0.3, 0.2], [12, 3, 2, 1])
    values = ACCEL.copy()
    values[:18, 1] = axis
    assert faults(accel=values) == [("clipped", "accelerometer", 0, 11, 12)]
    values[30, 1] = 0.4  # 4 times as often as the next value is required
    assert faults(accel=values) == []


def test_a_spike_is_ten_times_as_large_as_usual_differences():
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(GYRO[:, 0], 5, mode="edge"), 11)
    usual = np.percentile(np.abs(GYRO[:, 0] - np.median(windows, axis=1)), 98)
    middle = np.median(np.delete(GYRO[695:706, 0], 5))
    for factor, found in ((9.5, []), (10.5, [("spike", "gyroscope", 700, 700, 1)])):
        assert faults(gyro=changed(GYRO, (700, 0), middle + factor * usual)) == found
        assert faults(gyro=changed(GYRO, (700, 0), middle - factor * usual)) == found
    slow = GYRO + 0.4 * np.sin(np.arange(2000) / 300)[:, None]  # it turns by 3 times 0.4
    for size, count in ((1.0, 0), (1.6, 1)):
        assert len(faults(gyro=changed(slow, (700, 0), slow[700, 0] + size))) == count
    planar = GYRO * [0, 0, 1]
    assert faults(gyro=changed(planar, (700, 0), 1e-6)) == []  # no noise, no measure of a spike


def test_rows_of_two_faults_count_once():
    accel = np.clip(ACCEL, -9.85, 9.85)
    accel[500:520] = 9.85
    (clipped,) = sample_faults(GYRO, accel)
    assert clipped.kind == "clipped"
    assert set(range(500, 520)) <= set(clipped.rows.tolist())
    accel[500:520] = [0.1, 0.2, 9.85]
    accel[520:530] = [0.1, 0.2, 9.0]
    accel[530:550] = [0.1, 0.2, 9.0]
    found = sample_faults(GYRO, accel)
    rows = np.concatenate([one.rows for one in found])
    assert len(set(rows.tolist())) == len(rows)
    assert [one.kind for one in found] == ["clipped", "frozen"]


def test_rows_and_words_of_faults():
    found = sample_faults(changed(GYRO, slice(400, 500), GYRO[400]), changed(ACCEL, 40, 160.0))
    assert [one.kind for one in found] == ["spike", "frozen"]
    assert np.flatnonzero(faulty_rows(found, 2000)).tolist() == [40, *range(400, 500)]
    stamps = 10**18 + 5_000_000 * np.arange(2000)
    assert found[0].sentence(stamps, lambda row: f"line {row}") == (
        "line 40: the accelerometer jumps and returns in 1 sample (at 0.20 s)"
    )
    assert found[1].sentence(stamps, lambda row: f"line {row}") == (
        "line 400: the gyroscope repeats one value in 100 samples (from 2.00 to 2.50 s)"
    )


@pytest.mark.parametrize("noise", [0.0, 1.0])
@pytest.mark.parametrize("motion", ["loop", "motorway", "hover"])
def test_flights_have_no_faults(motion, noise):
    flight = bundle.synthesize_flight(
        motion=motion, duration=10, num_tracks=3, imu_noise_scale=noise
    )
    assert faults(flight.sequence.gyro, flight.sequence.accel) == []


def test_v1_01_has_no_faults(bundle_data):
    sequence = read_track_csv(bundle_data / "vio" / "euroc_V1_01_tracks_imu_30s.csv")
    assert faults(sequence.gyro, sequence.accel) == []
