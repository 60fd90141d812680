"""Gaps in a recording: what they may hide counts as noise, and is said."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bundle.cli.main import main
from bundle.inertial.vio.odometry import run_odometry
from bundle.inertial.vio.sequence_images import ImuSlices, beyond_range
from bundle.inertial.vio.trajectory_comparison import compare_trajectories
from bundle.io.sequences.sequence_folder import save_sequence
from bundle.model.sequence.calibration import ImuNoise
from bundle.model.sequence.sequence import Sequence
from bundle.synthetic.synthetic_flight import synthesize_flight

NOISE = ImuNoise(1e-3, 1e-2, 1e-5, 1e-4)
STAMPS = np.array([0, 5, 10, 15, 90, 95, 100, 105], np.int64) * 1_000_000


def holed(sequence: Sequence, at: float, milliseconds: float) -> Sequence:
    stamps = sequence.imu_timestamps_ns
    begin = stamps[0] + round(1e9 * at)
    kept = (stamps <= begin) | (stamps >= begin + round(1e6 * milliseconds))
    return replace(
        sequence,
        imu_timestamps_ns=stamps[kept],
        gyro=sequence.gyro[kept],
        accel=sequence.accel[kept],
    )


@pytest.mark.parametrize("rule", ["zero_order_hold", "midpoint"])
def test_what_a_gap_may_hide(rule: str) -> None:
    ramp = np.arange(len(STAMPS))[:, None] * np.array([1.0, 0.0, 0.0])
    gyro, accel = ramp.copy(), 10 * ramp
    slices = ImuSlices(STAMPS, gyro, accel, rule)
    whole = slices.between(5_000_000, 100_000_000)
    step = max(1.0, float(np.var(np.arange(8.0)))) / 3  # all samples are near
    assert whole.doubt == pytest.approx((step * 0.075**2, 100 * step * 0.075**2))
    if rule == "zero_order_hold":  # the mean of both ends
        np.testing.assert_allclose(whole.gyro[:, 0], [1, 2, 3.5, 4, 5])
        np.testing.assert_allclose(whole.accel[:, 0], [10, 20, 35, 40, 50])
    half = slices.between(5_000_000, 40_000_000)
    other = slices.between(40_000_000, 100_000_000)
    assert half.doubt == pytest.approx((step * 0.025**2, 100 * step * 0.025**2))
    if rule == "zero_order_hold":  # the middle of the piece
        np.testing.assert_allclose(half.gyro[:, 0], [1, 2, 3 + 12.5 / 75])
    assert half.then(other).doubt[0] == pytest.approx(half.doubt[0] + other.doubt[0])
    assert slices.between(0, 15_000_000).doubt == (0.0, 0.0)
    np.testing.assert_array_equal(gyro, ramp)  # the recording stays
    np.testing.assert_array_equal(accel, 10 * ramp)


@pytest.mark.parametrize(("before", "is_near"), [(145, True), (155, False)])
def test_what_is_near_a_gap_is_twice_its_length_away(before: int, is_near: bool) -> None:
    stamps = 1_000_000 * np.r_[0:500:5, 570:1000:5]  # a gap from 495 to 570 ms
    gyro = np.zeros((len(stamps), 3))
    last = int(np.flatnonzero(stamps == 1_000_000 * (495 - before))[0])
    gyro[last - 12 : last + 1, 1] = 3.0
    rng = np.random.default_rng(0)
    gyro += rng.normal(0, 1e-3, gyro.shape)
    slices = ImuSlices(stamps, gyro, gyro + np.array([0, 0, 9.81]), "midpoint")
    doubt = slices.between(490_000_000, 575_000_000).doubt[0]
    assert (doubt > 1e-4) == is_near


def test_doubt_is_part_of_the_covariance() -> None:
    still = np.zeros((len(STAMPS), 3))
    for changes, sigmas in (({}, (0.0, 0.0)), ({"gyro": 0.4}, (0.4, 0.0)), ({"accel": 3}, (0, 3))):
        given = {"gyro": still.copy(), "accel": still.copy()}
        for name, jump in changes.items():
            given[name][4:, 0] = jump
        interval = ImuSlices(STAMPS, given["gyro"], given["accel"], "zero_order_hold").between(
            0, 105_000_000
        )
        found = interval.integrated(NOISE, np.zeros(16), "zero_order_hold").covariance
        clean = replace(interval, doubt=(0.0, 0.0)).integrated(
            NOISE, np.zeros(16), "zero_order_hold"
        )
        added = np.sqrt(np.maximum(np.diag(found - clean.covariance), 0))
        assert added[0] == pytest.approx(sigmas[0] * 0.075 / np.sqrt(3), abs=1e-9)
        assert added[6] >= sigmas[1] * 0.075 / np.sqrt(3) - 1e-9


@pytest.mark.parametrize("seconds", [1.9, 2.5])
@pytest.mark.parametrize("sensor", ["gyro", "accel"])
def test_clipped_samples_go_on_and_rates_keep_their_doubt(sensor, seconds) -> None:
    """Images measure rotations, too; without forces the scale gets lost."""
    count = round(200 * seconds)
    stamps = 5_000_000 * np.arange(2001)
    rng = np.random.default_rng(0)
    values = {"gyro": rng.normal(0, 0.1, (2001, 3)), "accel": rng.normal(0, 1.0, (2001, 3))}
    values[sensor][700 : 700 + count, 1] += 20.0
    values[sensor] = np.minimum(values[sensor], 8.0)
    slices = ImuSlices(stamps, values["gyro"], values["accel"], "zero_order_hold")
    inside = slices.between(int(stamps[720]), int(stamps[760]))
    hidden = getattr(inside, sensor) - values[sensor][720:760]
    is_bridged = sensor == "gyro" or seconds < 2
    assert (hidden[:, [0, 2]] == 0).all() and ((hidden[:, 1] > 1).all() == is_bridged)
    assert is_bridged or not hidden.any()
    own, other = inside.doubt if sensor == "gyro" else inside.doubt[::-1]
    assert (own > 0, other) == (is_bridged, 0.0)


@pytest.mark.parametrize(("seconds", "is_bridged"), [(2.0, True), (2.01, False)])
def test_a_bad_stretch_is_a_gap_of_its_sensor(seconds: float, is_bridged: bool) -> None:
    rng = np.random.default_rng(0)
    size, first = 2001, 800
    stamps = 5_000_000 * np.arange(size)
    gyro, accel = rng.normal(0, 0.1, (size, 3)), rng.normal(0, 1, (size, 3))
    last = first + round(200 * seconds)
    gyro[first : last + 1] = gyro[first]
    accel[200, 1] += 50.0
    slices = ImuSlices(stamps, gyro, accel, "zero_order_hold")
    share = np.linspace(0, 1, last - first + 3)[:, None]
    line = (1 - share) * gyro[first - 1] + share * gyro[last + 1]
    there = slices.between(int(stamps[first - 1]), int(stamps[last + 2]))
    expected = line if is_bridged else gyro[first - 1 : last + 2]
    np.testing.assert_allclose(there.gyro, expected, atol=1e-12)
    np.testing.assert_array_equal(there.accel, accel[first - 1 : last + 2])
    assert (there.doubt[0] > 0, there.doubt[1]) == (is_bridged, 0.0)
    spike = slices.between(int(stamps[195]), int(stamps[205]))
    np.testing.assert_allclose(spike.accel[5], (accel[199] + accel[201]) / 2)
    neighbours = np.median(accel[190:211], axis=0)
    size = float(np.linalg.norm(accel[200] - neighbours))
    assert spike.doubt == (0.0, pytest.approx(size**2 / 3 * 0.01**2))


@pytest.mark.parametrize("sign", [1, -1])
def test_clipped_samples_go_on_and_are_doubted(sign: int) -> None:
    """Waves of 0.6 and 1.3 Hz: of their mean beyond the range, a tenth remains."""
    rng = np.random.default_rng(0)
    stamps = 5_000_000 * np.arange(1000)
    true = sign * np.sin(2e-2 * np.arange(1000)[:, None] * [1, 2, 3])
    gyro = true + rng.normal(0, 0.01, (1000, 3))
    range_ends = np.array([0.5, 0.5, 9.0])
    clipped = np.clip(gyro, -9.0, range_ends) if sign > 0 else np.clip(gyro, -range_ends, 9.0)
    slices = ImuSlices(stamps, clipped, rng.normal(0, 1, (1000, 3)), "zero_order_hold")
    there = slices.between(0, int(stamps[-1]))
    cut = np.abs(clipped[:-1]) == 0.5
    assert cut.sum() > 600
    before, after = (
        float(sign * (true[:-1] - one)[cut].mean()) for one in (clipped[:-1], there.gyro)
    )
    assert before > 0.3 and abs(after) < 0.1 * before
    np.testing.assert_array_equal(there.gyro[~cut], clipped[:-1][~cut])
    assert there.doubt[0] > 0 and there.doubt[1] == 0


@pytest.mark.parametrize("most", [0.0, 0.2, 0.5])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_clipped_wave_has_the_integral_of_a_quintic(most: float, sign: int) -> None:
    """At irregular stamps. A half wave has no curvature at its cuts; smaller parts have some."""
    rng = np.random.default_rng(0)
    seconds = np.cumsum(rng.uniform(0.004, 0.006, 2000))
    stamps = np.round(1e9 * seconds).astype(np.int64)
    true = 2 + sign * 3 * np.sin(8.0 * seconds[:, None] * [1.0, 0, 0])
    end = 2 + sign * 3 * most
    values = (np.minimum if sign > 0 else np.maximum)(true, end)
    clipped = values[:, 0] == end
    hidden = beyond_range(stamps, values, clipped)
    inner = slice(200, 1800)
    assert (hidden[:, 1:] == 0).all() and not hidden[~clipped].any()
    assert (sign * hidden >= 0).all()
    half = np.arccos(most)  # of the phase that is cut off
    ratio = 0.4 * half**2 * np.sin(half) / (np.sin(half) - half * most)
    assert 0.98 < ratio < 1.12
    cut_off = (true - values)[inner, 0].sum()
    assert hidden[inner, 0].sum() == pytest.approx(ratio * cut_off, rel=0.04)
    # Runs that are not clipped, but quantised, stay.
    assert not beyond_range(stamps, values, np.zeros(2000, bool)).any()


@pytest.mark.parametrize("slope", [0.4, -0.05])
def test_slopes_are_those_of_cubics_through_samples_within_the_range(slope: float) -> None:
    """A run of three samples; of four beside it, a clipped one has no part of the slope."""
    x = np.arange(0.5, 5)  # from the cut, in samples
    outside = -(slope * x + 0.3 * x**2 - 0.02 * x**3)
    values = np.zeros((13, 3))
    values[:, 2] = 5 + np.r_[outside[::-1], 0, 0, 0, outside]
    values[1, 2] = 5.0
    clipped = values[:, 2] == 5
    hidden = beyond_range(5_000_000 * np.arange(13), values, clipped)[5:8, 2]
    s = np.arange(0.5, 3) / 3
    half = 3 * slope * s * (1 - s) ** 3 * (1 + 3 * s)
    np.testing.assert_allclose(hidden, np.maximum(half + half[::-1], 0), atol=1e-9)


def test_a_long_run_rises_by_the_extent_of_the_samples_at_most() -> None:
    values = np.zeros((400, 3))
    values[:, 2] = 20.0 * 0.005 * np.minimum(np.arange(400), np.arange(400)[::-1])
    values[:, 2] = np.minimum(values[:, 2], 3.0)
    clipped = values[:, 2] == 3.0
    hidden = beyond_range(5_000_000 * np.arange(400), values, clipped)
    assert hidden.max() == 3.0
    steep = beyond_range(2_500_000 * np.arange(400), values, clipped)
    np.testing.assert_allclose(hidden, steep, atol=1e-9)  # a slope in units of the run


def test_a_run_at_the_end_of_the_samples_or_of_one_sample_has_no_slopes() -> None:
    values = np.array([[1.0, 0, 0]] * 4 + [[0.0, 0, 0]] * 4 + [[1.0, 0, 0]] + [[0.5, 0, 0]] * 3)
    values[:, 1] = np.arange(12.0)
    clipped = values[:, 0] == 1
    assert not beyond_range(5_000_000 * np.arange(12), values, clipped).any()


@pytest.mark.parametrize(("at", "milliseconds"), [(2.2, 75), (4.0, 1000)])
def test_a_gap_below_the_fatal_one_does_no_harm(at: float, milliseconds: float) -> None:
    flight = synthesize_flight(motion="room", seed=5, duration=8.0, num_tracks=40)
    whole, holey = (
        compare_trajectories(
            run_odometry(sequence, time_budget=100.0).trajectory, flight.ground_truth
        ).ate
        for sequence in (flight.sequence, holed(flight.sequence, at, milliseconds))
    )
    assert holey < whole + 0.02


def test_a_real_gap_at_take_off(bundle_data: Path) -> None:
    from bundle.io.sequences.sequence_folder import read_track_csv
    from bundle.io.sequences.trajectory_files import load_trajectory

    real = read_track_csv(bundle_data / "vio" / "euroc_V1_01_tracks_imu_30s.csv")
    truth = load_trajectory(bundle_data / "vio" / "euroc_V1_01_ground_truth.csv")
    found = run_odometry(holed(real, 4.8, 75), time_budget=100.0)
    assert compare_trajectories(found.trajectory, truth).ate < 0.03  # 0.395 before
    assert not any(record.alarms for record in found.keyframes)


def test_vio_repeats_what_info_finds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flight = synthesize_flight(duration=4.0, rest=1.5, num_tracks=30, seed=2).sequence
    save_sequence(holed(flight, 2.5, 75), tmp_path / "s")
    report: dict[str, Any] = {}
    printed = ""
    for command in (["info"], ["vio", "-o", str(tmp_path / "x.tum"), "--time-budget", "100"]):
        target = tmp_path / f"{command[0]}.json"
        arguments = [command[0], str(tmp_path / "s"), *command[1:], "--json", str(target)]
        assert main([*arguments, "--quiet"]) == 0
        report[command[0]] = json.loads(target.read_text())
        printed = capsys.readouterr().out
    found = report["info"]["findings"]
    assert [entry["kind"] for entry in found] == ["imu gap"]
    assert report["vio"]["findings"] == found
    assert report["vio"]["summary"]["warnings"][0].startswith(found[0]["sentence"])
    assert "imu.csv:" in printed


def test_what_was_asked_for_is_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flight = synthesize_flight(duration=4.0, rest=1.5, num_tracks=30, seed=2).sequence
    save_sequence(flight, tmp_path / "s")
    arguments = ["vio", str(tmp_path / "s"), "-o", str(tmp_path / "x.tum"), "--quiet"]
    shown = []
    for flags in (
        [],
        ["--nullity"],
        ["--covariance"],
        ["--covariance", "--start-yaw-sigma", "3", "--start-position-sigma", "0.1"],
    ):
        assert main([*arguments, *flags]) == 0
        lines = capsys.readouterr().out.splitlines()
        shown.append({row.split("  ")[0]: row for row in lines})
    assert not {"nullity", "sigma of yaw"} & set(shown[0])
    assert "4 at" in shown[1]["nullity"]
    assert "--start-yaw-sigma" in shown[2]["sigma of yaw"]
    assert "3" in shown[3]["sigma of yaw"] and "degrees" in shown[3]["sigma of yaw"]


@pytest.mark.parametrize("fault", ["spike of a rate", "spike of a force", "frozen", "zero"])
def test_bad_samples_are_bridged_and_named(
    fault: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flight = synthesize_flight(motion="room", seed=5, duration=8.0, num_tracks=40)
    gyro, accel = flight.sequence.gyro.copy(), flight.sequence.accel.copy()
    if fault.startswith("spike"):
        (gyro if fault.endswith("rate") else accel)[800, 1] = 30.0 if "rate" in fault else 160.0
    else:
        gyro[800:900] = gyro[800] if fault == "frozen" else 0.0
        accel[800:900] = accel[800] if fault == "frozen" else 0.0
    given = replace(flight.sequence, gyro=gyro, accel=accel)
    save_sequence(given, tmp_path / "s")
    assert main(["info", str(tmp_path / "s"), "--json", str(tmp_path / "info.json")]) == 0
    (finding,) = json.loads((tmp_path / "info.json").read_text())["findings"]
    assert finding["kind"] == fault.split()[0]
    assert "imu.csv: line 802:" in finding["sentence"] and "4.00 s" in finding["sentence"]
    found = run_odometry(given, time_budget=100.0)
    assert found.is_usable
    error = compare_trajectories(found.trajectory, flight.ground_truth)
    assert error.ate < 0.05  # metres before
    assert not any(record.alarms for record in found.keyframes)
    capsys.readouterr()


def test_a_constant_sensor_at_rest_is_not_called_frozen(tmp_path: Path) -> None:
    flight = synthesize_flight(motion="room", seed=5, duration=5.0, rest=2.0, num_tracks=40)
    gyro = flight.sequence.gyro.copy()
    gyro[100:300] = gyro[100]
    gyro[301:307] = gyro[301]  # less than the time between two images
    save_sequence(replace(flight.sequence, gyro=gyro), tmp_path / "s")
    assert main(["info", str(tmp_path / "s"), "--json", str(tmp_path / "i.json"), "--quiet"]) == 0
    assert json.loads((tmp_path / "i.json").read_text())["findings"] == []
