"""Units, axes and time offset of an IMU against the rotations of the tracks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bundle.inertial.preintegration.preintegration import Preintegration
from bundle.inertial.tracking import track_recording
from bundle.inertial.tracking.relative_rotation import Turn, refined_rotation, turns_of_tracks
from bundle.inertial.tracking.rotation_check import (
    RotationCheck,
    RotationPairs,
    check_rotations,
    tracking_findings,
)
from bundle.inertial.tracking.sequence_axes import _recording
from bundle.inertial.tracking.track_recording import Tracking
from bundle.inertial.vio.sequence_images import ImuSlices, SequenceImages
from bundle.interface.window_options import TrackingOptions
from bundle.io.sequences.recordings import read_mav
from bundle.model.sequence.sequence import Recording, Sequence
from bundle.synthetic.synthetic_flight import synthesize_flight
from tests.inertial.images.rendered_flight import SMALL, Flight, render


@pytest.fixture(scope="module")
def tracked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Recording, Sequence, Tracking]:
    """A recording, its tracks and their statistics."""
    mav = render(Flight(duration=5.0, seed=3, **SMALL), tmp_path_factory.mktemp("flight"))
    recording = read_mav(mav)
    return recording, *track_recording.track_recording(recording, TrackingOptions())


@pytest.fixture(scope="module")
def given(tracked: tuple[Recording, Sequence, Tracking]) -> tuple[Recording, list[Turn]]:
    """The recording, and the rotations of its tracks."""
    return tracked[0], turns_of_tracks(SequenceImages(tracked[1]), 100)


def test_a_right_calibration_agrees(given: tuple[Recording, list[Turn]]) -> None:
    check = check_rotations(*given)
    assert (check.cause, check.num_pairs > 60) == ("", True)
    assert check.unexplained < 0.03
    assert check.angle < 0.7
    assert abs(check.time_shift) < 2e-3
    assert check.ratio == pytest.approx(1, abs=0.1)
    assert tracking_findings(given[0], check) == ()


@pytest.mark.parametrize(
    ("change", "kind", "words"),
    [
        ("degrees", "gyro units", ("imu0/data.csv", "times as large", "degrees/s")),
        ("inverse", "axes", ("camera_from_imu", "inverse")),
        ("swapped", "axes", ("imu0/data.csv", "-y +x +z")),
        ("mirrored", "axes", ("-x +y +z",)),
        ("turned", "axes", ("camera_from_imu", "another rotation")),
        ("late", "time offset", ("ms", "--refine-time-offset")),
        ("slightly turned", "axes", ("camera_from_imu", "degrees", "--refine-extrinsics")),
        ("reversed", "rotation", ("disagrees",)),
    ],
)
def test_errors_are_named(
    given: tuple[Recording, list[Turn]], change: str, kind: str, words: tuple[str, ...]
) -> None:
    recording, turns = given
    pose = np.array(recording.calibration.camera_from_imu)
    half = np.radians(2 if change == "slightly turned" else 20)
    x, y, z, w = pose[:4]
    turn = np.array([*(np.sin(half) * np.array([0.6, 0.0, 0.8])), np.cos(half)])
    product = np.array([
        w * turn[0] + x * turn[3] + y * turn[2] - z * turn[1],
        w * turn[1] - x * turn[2] + y * turn[3] + z * turn[0],
        w * turn[2] + x * turn[1] - y * turn[0] + z * turn[3],
        w * turn[3] - x * turn[0] - y * turn[1] - z * turn[2],
    ])  # fmt: skip
    gyro, stamps = recording.gyro, recording.imu_timestamps_ns
    changed = {
        "degrees": lambda: replace(recording, gyro=np.degrees(gyro)),
        "inverse": lambda: posed(recording, [*-pose[:3], *pose[3:]]),
        "swapped": lambda: replace(recording, gyro=gyro[:, [1, 0, 2]] * [1, -1, 1]),
        "mirrored": lambda: replace(recording, gyro=gyro * [-1, 1, 1]),
        "turned": lambda: posed(recording, [*product, *pose[4:]]),
        "slightly turned": lambda: posed(recording, [*product, *pose[4:]]),
        "late": lambda: replace(recording, imu_timestamps_ns=stamps + 30_000_000),
        "reversed": lambda: replace(recording, gyro=gyro[::-1]),
    }[change]()
    check = check_rotations(changed, turns)
    found = tracking_findings(changed, check)
    assert [finding.kind for finding in found] == [kind]
    assert all(word in found[0].sentence for word in words), found[0].sentence
    assert found[0].is_problem == (change not in ("late", "slightly turned"))
    if change == "late":
        assert check.time_shift == pytest.approx(0.03, abs=3e-3)
    if change == "slightly turned":
        assert check.angle == pytest.approx(4.0, abs=1.5)


@pytest.mark.parametrize("scale", [1.0, np.pi / 180])
def test_rotations_by_samples_are_those_of_their_preintegration(scale: float) -> None:
    """Between samples, where the end of an interval is interpolated, to second order."""
    flight = synthesize_flight(motion="loop", duration=3.0, num_tracks=5, seed=1).sequence
    stamps = flight.imu_timestamps_ns
    turns = [
        Turn(int(stamps[k]), int(stamps[k + 50]), np.diag([1.0, -1.0, -1.0]), np.eye(3))
        for k in range(100, 530, 25)
    ]
    pairs = RotationPairs(_recording(flight, "S"), turns)
    assert len(pairs.spans) == len(turns)
    for shift, error in ((0.0, 1e-14), (-0.005, 1e-14), (0.0031, 1e-6)):
        found = pairs.imu(shift, scale)
        for span, vector in zip(pairs.spans + round(1e9 * shift), found, strict=True):
            interval = ImuSlices(stamps, flight.gyro, flight.accel, "midpoint").between(*span)
            motion = Preintegration(flight.calibration.noise, rule="midpoint")
            motion.integrate(scale * interval.gyro, interval.accel, interval.dt)
            turned = Rotation.from_rotvec(vector) * Rotation.from_matrix(motion.delta_rotation)
            assert turned.magnitude() < error
    ends = pairs.imu(10.0)  # beyond the last sample
    np.testing.assert_array_equal(ends, np.zeros_like(ends))


def posed(recording: Recording, pose: list[float]) -> Recording:
    return replace(
        recording, calibration=replace(recording.calibration, camera_from_imu=tuple(pose))
    )


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize("sign", [1, -1])
def test_images_are_compared_with_the_signs_of_the_forces(
    tracked: tuple[Recording, Sequence, Tracking], sign: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Forces have no part in tracking."""
    recording, sequence = (replace(each, accel=sign * each.accel) for each in tracked[:2])
    monkeypatch.setattr(track_recording, "read_recording", lambda *_: recording)
    monkeypatch.setattr(track_recording, "track_recording", lambda *_: (sequence, tracked[2]))
    found = track_recording.track_images("mav0").findings
    assert [each.kind for each in found] == ([] if sign > 0 else ["accelerometer axes"])
    assert all(each.is_problem and "imu0/data.csv" in each.sentence for each in found)


@pytest.mark.parametrize(
    ("rate", "shift", "count"),
    [(1000, 2.9e-3, 0), (1000, -3.1e-3, 1), (50, -11.9e-3, 0), (50, 12.1e-3, 1)],
)
def test_samples_that_are_means_are_no_time_offset(
    given: tuple[Recording, list[Turn]], rate: int, shift: float, count: int
) -> None:
    """Means over the interval that follows are half a period late: 10 ms at 50 Hz."""
    stamps = np.arange(len(given[0].gyro)) * (1_000_000_000 // rate)
    check = RotationCheck(num_pairs=50, unexplained=0.01, time_shift=shift, time_sigma=1e-4)
    found = tracking_findings(replace(given[0], imu_timestamps_ns=stamps), check)
    assert len(found) == count


def test_too_little_rotation_says_nothing(given: tuple[Recording, list[Turn]]) -> None:
    recording, turns = given
    still = [turn._replace(rotation=np.eye(3)) for turn in turns]
    for few in (still, turns[:5], []):
        check = check_rotations(recording, few)
        assert check.num_pairs == 0
        assert tracking_findings(recording, check) == ()


@pytest.mark.parametrize("baseline", [0.0, 0.1, 0.5])
def test_the_refined_rotation_is_as_certain_as_its_rays(baseline: float) -> None:
    """Monte Carlo: errors of some hundredths of a degree at a tenth of a pixel, f = 460."""
    rng = np.random.default_rng(5)
    errors, stated = [], []
    for _ in range(20):
        turn = Rotation.from_rotvec(rng.normal(0, 0.1, 3))
        way = rng.normal(size=3)
        way *= baseline / np.linalg.norm(way)
        points = np.column_stack([rng.uniform(-0.7, 0.7, (80, 2)), np.ones(80)])
        points *= rng.uniform(2, 5, (80, 1))
        seen = turn.apply(points) + way
        noise = rng.normal(0, 0.1 / 460, (2, 80, 2))
        one, other = points[:, :2] / points[:, 2:] + noise[0], seen[:, :2] / seen[:, 2:] + noise[1]
        other[:4] += rng.uniform(-0.02, 0.02, (4, 2))  # wrong tracks that survived
        start = (Rotation.from_rotvec(rng.normal(0, 0.01, 3)) * turn).as_matrix()
        guess = way / baseline + rng.normal(0, 0.2, 3) if baseline else rng.normal(size=3)
        found, information, _ = refined_rotation(one, other, start, guess, 0.3 / 460)
        stated.append(np.sqrt(np.trace(np.linalg.inv(information))))
        errors.append((Rotation.from_matrix(found) * turn.inv()).magnitude())
    assert np.degrees(np.median(errors)) < 0.05
    assert np.degrees(max(errors)) < 0.4
    # tracks are three times as precise as stated
    assert 1 < np.median(stated) / np.median(errors) < 6
