"""Synthetic flights: samples against derivatives, noise against its densities, tracks, truth."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

import bundle
from bundle.cli.main import main
from bundle.inertial.vio.trajectory_comparison import states_at
from bundle.interface.scene_options import MOTIONS
from bundle.io.sequences.sequence_folder import load_sequence
from bundle.io.sequences.trajectory_files import load_trajectory
from bundle.model.rigid_motions import inverse_poses, multiply_poses, quaternion_rotate
from bundle.synthetic.synthetic_flight import (
    DEGREE,
    DENSITIES,
    GRAVITY,
    control_points,
    control_times,
    imu_samples,
    motion_at,
    spline_at,
    surroundings,
)

QUIET = {"imu_noise_scale": 0.0, "gyro_bias": 0.0, "accel_bias": 0.0, "pixel_noise": 0.0}


def test_the_spline_and_its_derivatives_are_those_of_scipy() -> None:
    rng = np.random.default_rng(0)
    control = rng.normal(size=(len(control_times(3.0, 0.3)), 2))
    knots = 0.3 * (np.arange(len(control) + DEGREE + 1) - DEGREE)
    times = np.sort(rng.uniform(0, 3.0, 50))
    oracle = BSpline(knots, control, DEGREE)
    for derivative in range(DEGREE):
        expected = oracle(times, derivative)
        found = spline_at(control, 0.3, times, derivative)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * 0.3**-derivative)
    line = control_times(3.0, 0.3)[:, None]
    np.testing.assert_allclose(spline_at(line, 0.3, times)[:, 0], times, atol=1e-12)


@pytest.mark.parametrize("motion", MOTIONS)
def test_samples_are_derivatives_of_the_motion(motion: str) -> None:
    control = control_points(motion, 6.0, 0.5, np.random.default_rng(1))
    step = 1e-4
    times = np.array([0.2, 1.1, 2.5, 4.0, 5.7])
    before, now, after = (motion_at(control, times + shift) for shift in (-step, 0, step))
    turns = [Rotation.from_quat(states[:, :4]) for states in (before, now, after)]
    gyro, accel = imu_samples(control, times, "instant")
    rate = (turns[0].inv() * turns[2]).as_rotvec() / (2 * step)
    np.testing.assert_allclose(gyro, rate, atol=1e-6)
    velocity = (after[:, 4:7] - before[:, 4:7]) / (2 * step)
    np.testing.assert_allclose(now[:, 7:], velocity, atol=1e-5)
    force = turns[1].inv().apply((after[:, 7:] - before[:, 7:]) / (2 * step) - GRAVITY)
    np.testing.assert_allclose(accel, force, atol=1e-5)
    assert np.linalg.norm(gyro[0]) < 1e-12  # at rest
    np.testing.assert_allclose(accel[0], -GRAVITY, atol=1e-12)


def test_samples_of_intervals_add_up_to_the_motion() -> None:
    flight = bundle.synthesize_flight(duration=4, rest=0.2, motion="room", **QUIET)
    given, truth = flight
    turn, velocity = Rotation.from_quat(np.array(truth.states[0, :4])), truth.states[0, 7:10]
    step = np.diff(given.imu_timestamps_ns) * 1e-9
    for gyro, accel, h in zip(np.array(given.gyro), np.array(given.accel), step, strict=False):
        velocity = velocity + (turn.apply(accel) + GRAVITY) * h
        turn = turn * Rotation.from_rotvec(gyro * h)
    assert (turn.inv() * Rotation.from_quat(np.array(truth.states[-1, :4]))).magnitude() < 1e-10
    np.testing.assert_allclose(velocity, truth.states[-1, 7:10], atol=1e-10)


def test_noise_and_walks_have_their_densities() -> None:
    settings = {"duration": 50.0, "camera_rate": 1.0, "num_tracks": 3, "seed": 4}
    noisy = bundle.synthesize_flight(**settings, imu_noise_scale=2.0)
    quiet = bundle.synthesize_flight(**settings, **QUIET)
    truth = noisy.ground_truth
    biases = states_at(truth, noisy.sequence.imu_timestamps_ns)[:, 10:]
    for index, name in enumerate(("gyro", "accel")):
        difference = getattr(noisy.sequence, name) - getattr(quiet.sequence, name)
        white = difference - biases[:, 3 * index : 3 * index + 3]
        assert white.std() == pytest.approx(2 * DENSITIES[index] * np.sqrt(200), rel=0.03)
        walk = np.diff(truth.states[:, 10 + 3 * index : 13 + 3 * index], axis=0)
        assert walk.std() == pytest.approx(2 * DENSITIES[2 + index], rel=0.2)
        assert noisy.sequence.calibration.noise.astuple()[index] == 2 * DENSITIES[index]
    assert 0.001 < np.abs(truth.states[0, 10:13]).max() < 0.08
    assert 0.002 < np.abs(truth.states[0, 13:]).max() < 0.2


@pytest.mark.parametrize("motion", MOTIONS)
def test_every_track_is_one_point_of_the_surroundings(motion: str) -> None:
    flight = bundle.synthesize_flight(
        motion=motion, duration=5, rest=1, num_tracks=25, track_length=12, time_offset=0.02, **QUIET
    )
    given, truth = flight
    control = control_points(
        motion, 5.0, 1.0, np.random.default_rng(np.random.SeedSequence(0).spawn(4)[0])
    )
    around = surroundings(
        motion, control, np.random.default_rng(np.random.SeedSequence(0).spawn(4)[2])
    )
    states = states_at(truth, given.image_timestamps_ns)
    mount = np.tile(given.calibration.camera_from_imu, (len(states), 1))
    cameras = multiply_poses(mount, inverse_poses(states[:, :7]))
    xy = given.normalized()
    for track in np.unique(given.track_ids)[::7]:
        rows = np.flatnonzero(given.track_ids == track)
        cam = cameras[rows[0]]
        local = (
            quaternion_rotate(np.tile(cam[:4], (len(around.points), 1)), around.points) + cam[4:]
        )
        error = np.abs(local[:, :2] / local[:, 2:] - xy[rows[0]]).max(axis=1)
        point = around.points[np.argmin(np.where(local[:, 2] > 0, error, 1))]
        seen = quaternion_rotate(cameras[rows, :4], np.tile(point, (len(rows), 1)))
        seen += cameras[rows, 4:]
        np.testing.assert_allclose(seen[:, :2] / seen[:, 2:], xy[rows], atol=1e-9)
    _, begin = given.frames()
    assert (np.diff(begin) == 25).all()
    lengths = np.unique(given.track_ids, return_counts=True)[1]
    assert 2 < lengths.mean() < 15
    assert lengths.max() > 15


def test_the_seed_decides_and_pixels_have_their_noise() -> None:
    settings = {"duration": 4.0, "rest": 0.5}
    first, again = (bundle.synthesize_flight(**settings, seed=3) for _ in range(2))
    for name in ("gyro", "accel", "track_ids", "xy"):
        np.testing.assert_array_equal(getattr(first.sequence, name), getattr(again.sequence, name))
    other = bundle.synthesize_flight(**settings, seed=4)
    assert not np.array_equal(first.sequence.gyro, other.sequence.gyro)
    exact = bundle.synthesize_flight(**settings, seed=3, pixel_noise=0)
    difference = first.sequence.xy - exact.sequence.xy
    assert difference.std() == pytest.approx(0.5, rel=0.05)
    wrong = bundle.synthesize_flight(**settings, seed=3, outlier_share=0.2).sequence
    far = np.linalg.norm(wrong.xy - exact.sequence.xy, axis=1) > 10
    assert far.mean() == pytest.approx(0.2, abs=0.03)


def test_motions_are_what_they_are_called() -> None:
    speeds = {}
    for motion in MOTIONS:
        settings = {"duration": 40.0, "camera_rate": 2.0, "num_tracks": 4, "rest": 1.5}
        given, truth = bundle.synthesize_flight(motion=motion, **settings, **QUIET)
        speeds[motion] = np.linalg.norm(truth.states[:, 7:10], axis=1)
        assert speeds[motion][0] < 1e-12
        late = given.accel[-2000:]
        healthy = motion in ("loop", "room")
        assert (bundle.excitation(late).verdict == "healthy") == healthy
    assert np.ptp(speeds["motorway"][-40:]) < 1e-6
    assert speeds["motorway"][-1] == pytest.approx(30)
    assert 0 < speeds["hover"][-40:].max() < 0.01
    assert speeds["rotation_only"].max() < 1e-12


def test_the_command_writes_what_the_function_makes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "flight"
    command = ["synth", str(folder), "--scene", "flight", "--duration", "2", "--motion", "room"]
    assert main([*command, "--seed", "7", "--json", "-"]) == 0
    report = json.loads(capsys.readouterr().out)
    expected = bundle.synthesize_flight(duration=2, motion="room", seed=7)
    read, truth = load_sequence(folder), load_trajectory(folder / "ground_truth.csv")
    np.testing.assert_array_equal(read.gyro, expected.sequence.gyro)
    np.testing.assert_array_equal(read.xy, expected.sequence.xy)
    np.testing.assert_allclose(truth.states, expected.ground_truth.states, rtol=0, atol=1e-15)
    assert report["options"]["motion"] == "room"
    assert report["contents"]["num_observations"] == len(read.xy)
    assert main([*command, "--quiet"]) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert main([*command, "--quiet", "--overwrite"]) == 0


@pytest.mark.parametrize(
    ("flags", "found"),
    [
        (("--scene", "flight", "--images", "5"), "--images: "),
        (("--scene", "flight", "--format", "bal"), "--format: "),
        (("--scene", "flight", "--duration", "nan"), "--duration: "),
        (("--scene", "flight", "--duration", "1e9"), "--duration: "),
        (("--scene", "flight", "--duration", "0.01"), "--duration: "),
        (("--scene", "flight", "--motion", "dance"), "--motion"),
        (("--motion", "room"), "--motion: "),
    ],
)
def test_refusals(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], flags: tuple[str, ...], found: str
) -> None:
    assert main(["synth", str(tmp_path / "a"), "--quiet", *flags]) == 2
    err = capsys.readouterr().err
    assert err.startswith("error: ")
    assert found in err
    assert err.count("\n") == 1
    assert not (tmp_path / "a").exists()


def test_a_seed_gives_the_same_tracks_on_every_processor():
    """NumPy's order of equal numbers, as on a wall, depends on the instruction set."""
    code = (
        "import bundle, hashlib; found = bundle.synthesize_flight(duration=1.0, seed=3).sequence\n"
        "print(hashlib.sha256(found.normalized().round(3).tobytes()).hexdigest())"
    )
    core = np._core._multiarray_umath
    used = " ".join(name for name in core.__cpu_dispatch__ if core.__cpu_features__[name])
    found = {
        subprocess.check_output(
            [sys.executable, "-W", "ignore", "-c", code],
            env=os.environ | {"NPY_DISABLE_CPU_FEATURES": disabled},
        )
        for disabled in ("", used)
    }
    assert len(found) == 1
