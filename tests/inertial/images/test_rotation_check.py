"""Units, axes and time offset of an IMU against the rotations of the tracks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bundle.inertial.tracking import track_recording as tracks
from bundle.inertial.tracking.feature_tracker import Turn
from bundle.inertial.tracking.rotation_check import check_rotations
from bundle.inertial.tracking.tracking_findings import tracking_findings
from bundle.interface.tracking_options import TrackingOptions
from bundle.io.sequences.mav_folder import read_mav
from bundle.model.sequence.recording import Recording
from tests.inertial.images.rendered_flight import SMALL, Flight, render


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> tuple[Recording, list[Turn]]:
    """A recording, and the rotations of its tracks."""
    mav = render(Flight(duration=5.0, seed=3, **SMALL), tmp_path_factory.mktemp("flight"))
    recording = read_mav(mav)
    kept: list[list[Turn]] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            tracks,
            "check_rotations",
            lambda *given: (kept.append(given[1]), check_rotations(*given))[1],
        )
        tracks.track_recording(recording, TrackingOptions())
    return recording, kept[0]


def test_a_right_calibration_agrees(given: tuple[Recording, list[Turn]]) -> None:
    check = check_rotations(*given)
    assert (check.cause, check.num_pairs > 60) == ("", True)
    assert check.unexplained < 0.1
    assert check.angle < 1.5
    assert abs(check.time_shift) < 4e-3
    assert check.ratio == pytest.approx(1, abs=0.1)
    assert tracking_findings(given[0], check) == ()


@pytest.mark.parametrize(
    ("change", "kind", "words"),
    [
        ("degrees", "gyro units", ("imu0/data.csv", "57", "degrees/s")),
        ("inverse", "axes", ("camera_from_imu", "inverse")),
        ("swapped", "axes", ("imu0/data.csv", "-y +x +z")),
        ("mirrored", "axes", ("-x +y +z",)),
        ("turned", "axes", ("camera_from_imu", "another rotation")),
        ("late", "time offset", ("ms", "--refine-time-offset")),
        ("reversed", "rotation", ("disagrees",)),
    ],
)
def test_errors_are_named(
    given: tuple[Recording, list[Turn]], change: str, kind: str, words: tuple[str, ...]
) -> None:
    recording, turns = given
    pose = np.array(recording.calibration.camera_from_imu)
    half = np.sin(np.radians(20)) * np.array([0.6, 0.0, 0.8])
    x, y, z, w = pose[:4]
    turn = np.array([*half, np.cos(np.radians(20))])
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
        "late": lambda: replace(recording, imu_timestamps_ns=stamps + 30_000_000),
        "reversed": lambda: replace(recording, gyro=gyro[::-1]),
    }[change]()
    check = check_rotations(changed, turns)
    found = tracking_findings(changed, check)
    assert [finding.kind for finding in found] == [kind]
    assert all(word in found[0].sentence for word in words), found[0].sentence
    assert found[0].is_problem == (change != "late")
    if change == "late":
        assert check.time_shift == pytest.approx(0.03, abs=5e-3)


def posed(recording: Recording, pose: list[float]) -> Recording:
    return replace(
        recording, calibration=replace(recording.calibration, camera_from_imu=tuple(pose))
    )


def test_too_little_rotation_says_nothing(given: tuple[Recording, list[Turn]]) -> None:
    recording, turns = given
    still = [turn._replace(rotation=np.eye(3)) for turn in turns]
    for few in (still, turns[:5], []):
        check = check_rotations(recording, few)
        assert check.num_pairs == 0
        assert tracking_findings(recording, check) == ()
