"""Starts in motion and from rest, against the truth of synthetic flights and of EuRoC."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.inertial.vio.initialize import VioStart, initialize_vio
from bundle.inertial.vio.odometry import run_odometry
from bundle.inertial.vio.trajectory_comparison import states_at
from bundle.io.sequences.sequence_folder import read_track_csv
from bundle.io.sequences.trajectory_files import Trajectory, load_ground_truth
from bundle.model.sequence.sequence import Sequence

EXACT = {"imu_noise_scale": 0.0, "gyro_bias": 0.0, "accel_bias": 0.0, "pixel_noise": 0.0}


def later(given: Sequence, seconds: float) -> Sequence:
    """Leave out the first seconds."""
    start = given.imu_timestamps_ns[0] + round(1e9 * seconds)
    samples, rows = given.imu_timestamps_ns >= start, given.track_timestamps_ns >= start
    return Sequence(
        given.imu_timestamps_ns[samples],
        given.gyro[samples],
        given.accel[samples],
        given.track_timestamps_ns[rows],
        given.track_ids[rows],
        given.xy[rows],
        given.calibration,
    )


def errors(start: VioStart, truth: Trajectory) -> tuple[float, float, float, float]:
    """Return tilt in degrees, log of scale, gyroscope bias, and velocity as a share of speed."""
    assert start.kind == "moving"
    wanted = states_at(truth, start.timestamps_ns)
    down = [
        Rotation.from_quat(np.array(states[0, :4])).inv().apply([0, 0, -1])
        for states in (start.states, wanted)
    ]
    tilt = np.degrees(np.arccos(min(1.0, float(down[0] @ down[1]))))
    sizes = [np.linalg.norm(s[:, 4:7] - s[0, 4:7]) for s in (start.states, wanted)]
    turn, true_turn = (Rotation.from_quat(np.array(s[:, :4])) for s in (start.states, wanted))
    found = turn.inv().apply(start.states[:, 7:10])
    speed = true_turn.inv().apply(wanted[:, 7:10])
    velocity = np.linalg.norm(found - speed) / np.linalg.norm(speed)
    bias = np.abs(start.states[0, 10:13] - wanted[0, 10:13]).max()
    return float(tilt), float(abs(np.log(sizes[0] / sizes[1]))), float(bias), float(velocity)


def test_without_noise_a_start_is_the_truth() -> None:
    flight = bundle.synthesize_flight(motion="room", duration=3, rest=0, seed=2, **EXACT)
    start = initialize_vio(flight.sequence)
    tilt, scale, bias, velocity = errors(start, flight.ground_truth)
    assert tilt < 0.02  # integration between samples is left
    assert scale < 1e-3
    assert bias < 1e-5
    assert velocity < 2e-3
    turned = Rotation.from_quat(start.states[:, :4])
    rays = turned[0].inv().apply(start.points - start.states[0, 4:7])
    assert (rays[:, 0] > 0).all()  # the camera looks along the IMU's x axis
    assert len(start.track_ids) == len(start.points) > 20


@pytest.mark.parametrize("motion", ["loop", "room", "motorway"])
@pytest.mark.parametrize("seed", [1, 2])
def test_starts_in_motion(motion: str, seed: int) -> None:
    flight = bundle.synthesize_flight(motion=motion, duration=6, rest=0, seed=seed)
    given = later(flight.sequence, 3 if motion == "motorway" else 0)
    start = initialize_vio(given)
    tilt, scale, bias, velocity = errors(start, flight.ground_truth)
    assert tilt < 1
    assert scale < 0.04
    assert bias < 0.003
    assert velocity < 0.05
    assert scale < 5 * start.scale_sigma
    assert 0.3 < start.median_error < 1.2


def test_large_biases_and_outliers() -> None:
    flight = bundle.synthesize_flight(
        motion="room", duration=3, rest=0, seed=1, gyro_bias=0.1, outlier_share=0.02
    )
    assert np.abs(flight.ground_truth.states[0, 10:13]).max() > 0.05
    tilt, scale, bias, _ = errors(initialize_vio(flight.sequence), flight.ground_truth)
    assert tilt < 1.5
    assert scale < 0.06
    assert bias < 0.005


@pytest.mark.parametrize(
    ("motion", "skipped", "reasons"),
    [
        ("rotation_only", 0, {"no parallax"}),
        ("motorway", 20, {"no excitation", "points behind the camera", "biases too large"}),
    ],
)
def test_what_shows_no_scale_is_told(motion: str, skipped: float, reasons: set[str]) -> None:
    flight = bundle.synthesize_flight(motion=motion, duration=skipped + 3, rest=0, seed=1)
    given = later(flight.sequence, skipped)
    start = initialize_vio(given)
    assert not start
    assert start.kind == "none"
    assert start.reason in reasons
    assert len(start.states) == 0
    assert start.reason in repr(start)
    with pytest.raises(bundle.InputError, match=start.reason) as caught:
        run_odometry(given)
    assert "\n" not in str(caught.value)


def test_rest_is_taken_where_there_is_any() -> None:
    flight = bundle.synthesize_flight(duration=4, rest=2, accel_bias=0.01, seed=1)
    start = initialize_vio(flight.sequence)
    assert start.kind == "static"
    truth = flight.ground_truth.states[0]
    down = Rotation.from_quat(start.states[0, :4]).inv().apply([0, 0, -1])
    np.testing.assert_allclose(
        down, Rotation.from_quat(np.array(truth[:4])).inv().apply([0, 0, -1]), atol=0.005
    )
    np.testing.assert_allclose(start.states[0, 10:13], truth[10:13], atol=0.001)


def test_too_few_tracks() -> None:
    flight = bundle.synthesize_flight(duration=3, rest=0, num_tracks=4)
    assert initialize_vio(flight.sequence).reason == "too few tracks"


@pytest.mark.parametrize("begin", [12, 18])
def test_euroc_in_flight(bundle_data: Path, begin: float) -> None:
    folder = bundle_data / "vio"
    given = later(read_track_csv(folder / "euroc_V1_01_tracks_imu_30s.csv"), begin)
    truth = load_ground_truth(folder / "euroc_V1_01_ground_truth.csv")
    tilt, scale, bias, _ = errors(initialize_vio(given), truth)
    assert tilt < 1
    assert scale < 0.08
    assert bias < 0.005


def test_an_odometry_begins_in_flight(bundle_data: Path) -> None:
    folder = bundle_data / "vio"
    given = later(read_track_csv(folder / "euroc_V1_01_tracks_imu_30s.csv"), 24)
    result = run_odometry(given, time_budget=10)
    assert result.start == "moving"
    truth = load_ground_truth(folder / "euroc_V1_01_ground_truth.csv")
    error = bundle.compare_trajectories(result.trajectory, truth)
    assert error.ate < 0.02
    assert abs(error.scale - 1) < 0.03
