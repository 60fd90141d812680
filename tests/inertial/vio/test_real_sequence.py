"""EuRoC V1_01: its csv, the direction of its camera pose, and what `info` and `convert` say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bundle
from bundle.cli.main import main
from bundle.inertial.vio.odometry import sequence_statistics
from bundle.inertial.vio.trajectory_comparison import states_at
from bundle.io.sequences.sequence_folder import load_sequence, read_track_csv
from bundle.io.sequences.trajectory_files import load_ground_truth
from bundle.model.rigid_motions import inverse_poses, multiply_poses, rotation_matrices
from bundle.model.sequence.sequence import Sequence


def flight(bundle_data: Path) -> Path:
    return bundle_data / "vio" / "euroc_V1_01_tracks_imu_30s.csv"


def median_reprojection(sequence: Sequence, camera_from_imu: Any, truth: Path) -> float:
    """Triangulate every long track from the true poses; return the median error in pixels."""
    states = states_at(load_ground_truth(truth), sequence.track_timestamps_ns)
    lens = np.tile(camera_from_imu, (len(states), 1))
    poses = multiply_poses(lens, inverse_poses(states[:, :7]))
    turns, shifts = rotation_matrices(poses[:, :4]), poses[:, 4:]
    errors = []
    for track in np.unique(sequence.track_ids):
        rows = np.flatnonzero(sequence.track_ids == track)[::4]
        if len(rows) < 10:
            continue
        xy, r, t = sequence.xy[rows], turns[rows], shifts[rows]
        matrix = np.vstack([r[:, i] - xy[:, i, None] * r[:, 2] for i in (0, 1)])
        right = np.hstack([xy[:, i] * t[:, 2] - t[:, i] for i in (0, 1)])
        seen = r @ np.linalg.lstsq(matrix, right, rcond=None)[0] + t
        errors.append(np.linalg.norm(seen[:, :2] / seen[:, 2:] - xy, axis=1))
    return float(sequence.calibration.focal * np.median(np.concatenate(errors)))


def test_the_pose_of_the_camera_points_the_right_way(bundle_data: Path) -> None:
    sequence = read_track_csv(flight(bundle_data))
    truth = bundle_data / "vio" / "euroc_V1_01_ground_truth.csv"
    pose = np.array([sequence.calibration.camera_from_imu])
    assert median_reprojection(sequence, pose, truth) < 2
    assert median_reprojection(sequence, inverse_poses(pose), truth) > 100


def test_convert_and_info(
    bundle_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "flight"
    assert main(["convert", str(flight(bundle_data)), str(folder), "--quiet"]) == 0
    capsys.readouterr()
    written, direct = load_sequence(folder), read_track_csv(flight(bundle_data))
    for name in ("imu_timestamps_ns", "gyro", "accel", "track_timestamps_ns", "track_ids", "xy"):
        np.testing.assert_array_equal(getattr(written, name), getattr(direct, name))
    assert written.calibration == direct.calibration

    assert main(["info", str(folder), "--json", "-"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["input"] == {
        "path": str(folder),
        "format": "sequence",
        "num_imu_samples": 6001,
        "num_images": 601,
        "num_tracks": 307,
        "num_observations": 13316,
    }
    assert report["findings"] == []
    assert 4 < report["statistics"]["static_start"] < 5.2
    assert report["statistics"]["imu_rate"] == pytest.approx(200, rel=1e-3)
    assert report["statistics"]["camera_rate"] == pytest.approx(20, rel=1e-3)
    assert report["statistics"]["verdict"] == sequence_statistics(direct).verdict == "healthy"
    assert main(["info", str(folder)]) == 0
    assert "6001 IMU samples" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        (",T_ci_qw,0.7", ",T_ci_qw,x", "T_ci_qw"),
        (",T_ci_qw,0.7", ",T_ci_qw,7", "norm 1"),
        ("imu,", "gps,", "'gps'"),
        ("u_norm", "u", "u_norm"),
        (",0.2421445", ",north", "north"),
        ("\nimu,", "\nimu,,,", "columns"),
    ],
)
def test_bad_tables_are_refused(
    bundle_data: Path, tmp_path: Path, old: str, new: str, found: str
) -> None:
    text = "\n".join(flight(bundle_data).read_text().splitlines()[:80])
    path = tmp_path / "a.csv"
    path.write_text(text.replace(old, new, 1))
    assert old in text
    with pytest.raises(bundle.InputError, match=found) as caught:
        read_track_csv(path)
    assert str(path) in str(caught.value)


def test_commands_refuse_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "imu.csv").write_text("")
    for command in (["info", str(tmp_path)], ["convert", str(tmp_path), str(tmp_path / "b")]):
        assert main([*command, "--quiet"]) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.startswith("error: ")
        assert err.count("\n") == 1
        assert "calibration.yaml" in err
    assert not (tmp_path / "b").exists()
