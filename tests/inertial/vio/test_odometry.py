"""Odometry over whole sequences, in Python and on the command line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bundle import _core
from bundle.cli.main import main
from bundle.errors import InputError
from bundle.inertial.vio.initialize import find_static_start
from bundle.inertial.vio.odometry import run_odometry
from bundle.inertial.vio.sequence_images import ImuSlices, SequenceImages
from bundle.inertial.vio.trajectory_comparison import compare_trajectories
from bundle.io.sequences.sequence_folder import read_track_csv, save_sequence
from bundle.io.sequences.trajectory_files import load_tum
from bundle.model.sequence.sequence import Sequence
from bundle.synthetic.synthetic_flight import synthesize_flight
from tests.inertial.vio.sequences import sequence


@pytest.fixture(scope="module")
def real(bundle_data: Path) -> Sequence:
    return read_track_csv(bundle_data / "vio" / "euroc_V1_01_tracks_imu_30s.csv")


def test_thirty_seconds_of_euroc(bundle_data: Path, tmp_path: Path) -> None:
    """From rest, without a look at the truth; every figure of the report is there."""
    folder = bundle_data / "vio"
    target, report = tmp_path / "x.tum", tmp_path / "x.json"
    lines = tmp_path / "x.jsonl"
    arguments = ["vio", str(folder / "euroc_V1_01_tracks_imu_30s.csv"), "-o", str(target)]
    arguments += ["--ground-truth", str(folder / "euroc_V1_01_ground_truth.csv")]
    arguments += ["--json", str(report), "--telemetry", str(lines), "--nullity", "--quiet"]
    # A loaded machine must not change what is found.
    assert main([*arguments, "--time-budget", "10"]) == 0
    found = json.loads(report.read_text())
    assert found["error"]["ate"] < 0.03
    assert abs(found["error"]["scale"] - 1) < 0.01
    assert found["error"]["rotation_rms"] < 1.5
    keyframes = found["keyframes"]
    assert {k["nullity"] for k in keyframes} == {4}
    assert {k["expected_nullity"] for k in keyframes} == {4}
    healthy = [k for k in keyframes if k["marginalized"]]
    assert not any(k["alarms"] for k in keyframes)
    assert max(k["prior_asymmetry"] for k in healthy) < 1e-9
    assert min(k["prior_ratio"] for k in healthy) > 1e-7
    assert [json.loads(line) for line in lines.read_text().splitlines()] == keyframes
    poses = load_tum(target)
    assert len(poses) == found["summary"]["num_images"]
    np.testing.assert_allclose(np.linalg.norm(poses.states[:, :4], axis=1), 1, atol=1e-9)


def test_a_batch_is_a_window_that_keeps_everything(real: Sequence, bundle_data: Path) -> None:
    from bundle.inertial.vio.trajectory_comparison import compare_trajectories
    from bundle.io.sequences.trajectory_files import load_trajectory

    result = run_odometry(
        real, marginalize="keep", frame_rate=4.0, min_parallax=0.0, min_translation=0.0
    )
    truth = load_trajectory(bundle_data / "vio" / "euroc_V1_01_ground_truth.csv")
    error = compare_trajectories(result.trajectory, truth)
    assert error.ate < 0.016
    assert abs(error.scale - 1) < 0.01


def test_rest_is_found_and_told_from_motion(real: Sequence) -> None:
    found = find_static_start(SequenceImages(real))
    assert found is not None
    seconds = 1e-9 * (real.frames()[0][found.last_image] - real.frames()[0][found.first_image])
    assert 3.0 < seconds < 4.7  # it takes off after 4.7 s
    np.testing.assert_allclose(found.state[10:13], [-0.0022, 0.0215, 0.0770], atol=2e-3)
    late = real.track_timestamps_ns > real.track_timestamps_ns[0] + 6_000_000_000
    moving = replace(
        real,
        track_timestamps_ns=real.track_timestamps_ns[late],
        track_ids=real.track_ids[late],
        xy=real.xy[late],
    )
    assert find_static_start(SequenceImages(moving)) is None


@pytest.mark.parametrize("rule", ["zero_order_hold", "midpoint"])
def test_slices_cover_what_was_asked_for(rule: str) -> None:
    stamps = np.array([0, 10, 20, 30, 40], np.int64) * 1_000_000
    ramp = np.arange(5.0)[:, None] * np.ones(3)
    slices = ImuSlices(stamps, ramp, 10 * ramp, rule)
    found = slices.between(5_000_000, 32_000_000)
    np.testing.assert_allclose(found.dt, [0.005, 0.01, 0.01, 0.002])
    if rule == "midpoint":
        np.testing.assert_allclose(found.gyro[:, 0], [0.5, 1, 2, 3, 3.2])
        both = slices.between(5_000_000, 20_000_000).then(slices.between(20_000_000, 32_000_000))
        np.testing.assert_allclose(both.accel, found.accel)
    else:
        np.testing.assert_allclose(found.gyro[:, 0], [0, 1, 2, 3])
    whole = slices.between(10_000_000, 30_000_000)
    np.testing.assert_allclose(whole.dt, [0.01, 0.01])
    with pytest.raises(InputError, match="IMU"):
        slices.between(0, 50_000_000)


def test_noise_is_a_rest_without_end(tmp_path: Path) -> None:
    """Nothing moves: a trajectory that stays, and the alarm that scale is not told."""
    still = sequence(
        accel=np.random.default_rng(1).normal([0, 0, 9.81], 0.02, (401, 3)),
        gyro=np.random.default_rng(2).normal(0, 0.002, (401, 3)),
    )
    save_sequence(still, tmp_path / "still")
    report = tmp_path / "r.json"
    arguments = ["vio", str(tmp_path / "still"), "-o", str(tmp_path / "x.tum"), "--quiet"]
    assert main([*arguments, "--json", str(report)]) == 0
    found = json.loads(report.read_text())
    assert found["keyframes"][0]["excitation_verdict"] == "unobservable"
    assert any("scale" in alarm for alarm in found["keyframes"][0]["alarms"])
    assert np.abs(load_tum(tmp_path / "x.tum").states[:, 4:7]).max() < 0.2


def test_a_sequence_that_begins_in_motion_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(4)
    wild = sequence(xy=rng.uniform(-0.5, 0.5, (105, 2)), gyro=rng.normal(0, 1.0, (401, 3)))
    save_sequence(wild, tmp_path / "wild")
    target = tmp_path / "x.tum"
    assert main(["vio", str(tmp_path / "wild"), "-o", str(target), "--quiet"]) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("error: ")
    assert captured.err.count("\n") == 1
    assert not target.exists()


@pytest.mark.parametrize(
    "words",
    [
        ["--window", "1"],
        ["--jacobians", "second-estimate"],
        ["--imu-noise-scale", "0"],
        ["--ground-truth", "missing.csv"],
        ["--time-budget", "-1"],
    ],
)
def test_bad_flags_are_one_line(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_sequence(sequence(), tmp_path / "s")
    code = main(["vio", str(tmp_path / "s"), "-o", str(tmp_path / "x.tum"), "--quiet", *words])
    assert code == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("error: ")
    assert captured.err.count("\n") == 1
    assert not (tmp_path / "x.tum").exists()


@pytest.mark.parametrize(
    "words",
    [
        ("-o", "s/tracks.csv"),
        ("-o", "x.tum", "--json", "s/imu.csv"),
        ("-o", "x.tum", "--telemetry", "x.tum"),
        ("-o", "x.tum", "--html", "page", "--publish", "page"),
        ("-o", "x.tum", "--html", "truth.tum", "--ground-truth", "truth.tum"),
        ("-o", "x.tum", "--publish", "loops.csv", "--loops", "loops.csv"),
    ],
)
def test_no_output_replaces_what_is_read_or_written(
    words: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_sequence(sequence(), tmp_path / "s")
    for name in ("truth.tum", "loops.csv"):
        (tmp_path / name).write_text("untouched")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    given = [word if word.startswith("-") else str(tmp_path / word) for word in words]
    assert main(["vio", str(tmp_path / "s"), *given, "--quiet"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1
    assert "would replace" in error
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_a_gap_of_the_imu_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stamps = sequence().imu_timestamps_ns.copy()
    stamps[150:] += 2_000_000_000  # a gap just beyond 2 s, within the images
    late = sequence().track_timestamps_ns + 2_000_000_000 * (np.arange(105) >= 60)
    holed = sequence(imu_timestamps_ns=stamps, track_timestamps_ns=late)
    save_sequence(holed, tmp_path / "holed")
    target = tmp_path / "x.tum"
    assert main(["vio", str(tmp_path / "holed"), "-o", str(target), "--quiet"]) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("error: ")
    assert captured.err.count("\n") == 1
    assert not target.exists()


@pytest.mark.parametrize("where", ["between images", "in a solve"])
def test_ctrl_c_keeps_what_is_solved(where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    flight = synthesize_flight(duration=4.0, rest=1.5, num_tracks=20, seed=2)

    def progress(done: int, _count: int, _record: object) -> bool:
        if done > 50:
            if where == "between images":
                raise KeyboardInterrupt
            monkeypatch.setattr(_core, "solve_window", interrupted_solve)
        return True

    solve = _core.solve_window

    def interrupted_solve(*arguments: Any) -> dict[str, Any]:
        return {**solve(*arguments), "interrupted": True}

    result = run_odometry(flight.sequence, progress=progress)
    assert result.interrupted
    assert 5 < len(result.trajectory) < 40
    assert result.is_usable


def test_the_fill_of_a_batch_is_counted() -> None:
    flight = synthesize_flight(duration=14.0, rest=1.5, num_tracks=20, seed=2)
    settings: dict[str, Any] = {"min_parallax": 0.0, "min_translation": 0.0, "frame_rate": 4.0}
    batch = run_odometry(flight.sequence, marginalize="keep", **settings)
    assert batch.keyframes[0].fill_ratio == 1  # dense
    assert 1 < batch.keyframes[-1].fill_ratio < 4


@pytest.mark.usefixtures("few")
def test_a_motion_that_is_lost_is_no_result(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The accelerometer gains 3000 m/s^2 in flight: report and trajectory end there."""
    flight = synthesize_flight(duration=5.0, rest=1.5, num_tracks=20, seed=2).sequence
    accel = flight.accel.copy()
    accel[500:, 0] += 3000
    save_sequence(replace(flight, accel=accel), tmp_path / "s")
    target, report = tmp_path / "x.tum", tmp_path / "r.json"
    arguments = ["vio", str(tmp_path / "s"), "-o", str(target), "--json", str(report), "--quiet"]
    assert main(arguments) == 1
    seconds = np.ptp(load_tum(target).timestamps_ns) * 1e-9
    assert 1 < seconds < 3
    found = json.loads(report.read_text())
    assert found["summary"]["is_solution_usable"] is False
    assert "lost" in found["summary"]["message"]
    assert found["output"]["path"] == str(target)
    assert "lost" in capsys.readouterr().out


@pytest.mark.parametrize("wrong", ["nothing", "rotation", "translation", "time offset"])
def test_a_wrong_calibration_shows_in_the_cost_of_the_imu(wrong: str) -> None:
    sequence = synthesize_flight(duration=12.0, rest=1.5, num_tracks=40, seed=2).sequence
    pose = np.array(sequence.calibration.camera_from_imu)
    changes: dict[str, Any] = {}
    if wrong == "rotation":
        turned = Rotation.from_rotvec([0, np.radians(5), 0]) * Rotation.from_quat(pose[:4])
        changes = {"camera_from_imu": np.r_[turned.as_quat(), pose[4:]]}
    elif wrong == "translation":
        changes = {"camera_from_imu": pose + 0.5 * (np.arange(7) == 4)}
    elif wrong == "time offset":
        changes = {"time_offset": 0.02}
    calibration = replace(sequence.calibration, **changes)
    found = run_odometry(replace(sequence, calibration=calibration), time_budget=10.0)
    said = [
        any("contradict" in alarm for alarm in record.alarms)
        for record in found.keyframes
        if record.imu_excess is not None
    ]
    assert len(said) > 10
    if wrong == "nothing":
        assert not any(said)
    else:
        assert np.mean(said[len(said) // 2 :]) > 0.7


def test_the_noise_of_a_flight_explains_its_imu() -> None:
    """Mean over seeds, in units of the noise of the sequence."""
    excess = []
    for seed in range(3):
        flight = synthesize_flight(
            duration=8.0, rest=1.5, num_tracks=100, imu_noise_scale=10.0, pixel_noise=0.3, seed=seed
        )
        found = run_odometry(
            flight.sequence, imu_noise_scale=1.0, pixel_sigma=0.3, loss="trivial", time_budget=10.0
        )
        excess += [r.imu_excess for r in found.keyframes if r.imu_excess is not None]
    assert 0.6 < np.mean(excess) < 1.3


def test_the_sigma_of_the_calibration_counts_in_the_whole_run() -> None:
    flight = synthesize_flight(motion="loop", seed=22, duration=12.0, pixel_noise=5.0)
    assert flight.sequence.calibration.pixel_sigma == 5.0
    given, same, other = (
        run_odometry(flight.sequence, time_budget=100.0, **options)
        for options in ({}, {"pixel_sigma": 5.0}, {"pixel_sigma": 1.0})
    )
    np.testing.assert_array_equal(given.trajectory.states, same.trajectory.states)
    assert given.options.pixel_sigma == 5.0
    errors = [compare_trajectories(r.trajectory, flight.ground_truth).ate for r in (given, other)]
    assert errors[0] < 0.7 * errors[1]


@pytest.mark.parametrize(
    ("options", "message"),
    [({"time_budget": 1e-9}, "time budget"), ({"precision": "single"}, "prior")],
)
def test_a_window_that_never_estimated_is_no_result(options: Any, message: str) -> None:
    flight = synthesize_flight(duration=12.0, rest=1.5, num_tracks=40, seed=2)
    found = run_odometry(flight.sequence, **options)
    assert not found.is_usable
    assert message in found.message
    alarms = [alarm for record in found.keyframes[1:] for alarm in record.alarms]
    assert any(alarm.startswith("no step") for alarm in alarms) == ("time_budget" in options)
