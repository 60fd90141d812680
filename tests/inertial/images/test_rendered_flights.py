"""Odometry from images: rendered flights end near the truth, in every run at the same place."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

import bundle
from bundle.cli.main import main
from bundle.inertial.vio.trajectory_comparison import compare_trajectories, states_at
from bundle.io.sequences.trajectory_files import load_trajectory
from bundle.reports.json_schema import described_entries, report_schema
from tests.inertial.images.rendered_flight import SMALL, SMALL_FISHEYE, Flight, render

SHARE = 0.02  # of the path


def end_error(path: Path, mav: Path) -> float:
    """Return the largest of the errors of positions and of the distance to the end / the path."""
    truth = load_trajectory(mav / "state_groundtruth_estimate0/data.csv")
    found = load_trajectory(path)
    error = compare_trajectories(found, truth)
    stamps = found.timestamps_ns[[0, -1]]
    ends = np.linalg.norm(np.diff(found.states[[0, -1], 4:7], axis=0))
    true = np.linalg.norm(np.diff(states_at(truth, stamps)[:, 4:7], axis=0))
    return max(error.ate_yaw, error.ate, abs(ends - true)) / error.path_length


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return render(Flight(duration=6.0, **SMALL), tmp_path_factory.mktemp("flight"))


@pytest.fixture(scope="module")
def followed(flight: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The trajectory of the flight's images, and the report."""
    folder = tmp_path_factory.mktemp("followed")
    report, out = folder / "report.json", folder / "out.tum"
    words = ["vio", str(flight), "-o", str(out), "--json", str(report), "--time-budget", "10"]
    assert main([*words, "--quiet"]) == 0
    return out, report


def test_a_flight_ends_within_two_per_cent_of_its_path(
    flight: Path, followed: tuple[Path, Path]
) -> None:
    out, report = followed
    assert end_error(out, flight) < SHARE
    found = json.loads(report.read_text())
    jsonschema.Draft202012Validator(report_schema()).validate(found)
    assert set(found) <= described_entries()["vio"]
    assert found["input"]["format"] == "mav"
    tracking = found["tracking"]
    assert tracking["num_images"] == 118
    assert tracking["tracks_per_image"] > 60
    assert tracking["mean_track_length"] > 8
    assert sum(tracking["share_lost"].values()) < 0.2
    assert tracking["share_predicted"] > 0.8
    assert tracking["check"]["unexplained"] < 0.1
    assert found["findings"] == []
    assert any("tracks of" in sentence for sentence in found["headline"])


def test_tracks_written_by_convert_give_the_same_bits(
    flight: Path, followed: tuple[Path, Path], tmp_path: Path
) -> None:
    folder, out = tmp_path / "tracks", tmp_path / "b.tum"
    assert main(["convert", str(flight.parent), str(folder), "--quiet"]) == 0
    assert main(["vio", str(folder), "-o", str(out), "--time-budget", "10", "--quiet"]) == 0
    assert out.read_bytes() == followed[0].read_bytes()
    calibration = bundle.load_sequence(folder).calibration
    assert calibration.camera_model == "OPENCV"


@pytest.mark.parametrize(
    "settings",
    [
        {"seed": 14, **SMALL_FISHEYE, "offset": 0.005},
        {"seed": 15, "still": 1.5, "duration": 7.0},
        {"seed": 16, "bare": (3.0, 4.0), "duration": 6.0},
        {"seed": 18, "speed": 0.6},
    ],
    ids=lambda settings: "-".join(map(str, settings)),
)
def test_other_flights(tmp_path: Path, settings: dict[str, Any]) -> None:
    mav = render(Flight(**{"duration": 5.0, **SMALL, **settings}), tmp_path)
    if "bare" in settings:  # and a dropped image
        table = mav / "cam0/data.csv"
        lines = table.read_text().splitlines()
        table.write_text("\n".join(lines[:40] + lines[41:]))
    tracked = bundle.track_images(mav)
    result = bundle.run_odometry(tracked.sequence, time_budget=10.0)
    assert result.is_usable
    assert result.start == ("static" if "still" in settings else "moving")
    truth = load_trajectory(mav / "state_groundtruth_estimate0/data.csv")
    error = compare_trajectories(result.trajectory, truth)
    assert error.ate / error.path_length < SHARE
    offset = settings.get("offset", 0.0)
    assert tracked.tracking.time_offset == offset
    check = tracked.tracking.check
    assert abs(check.time_shift) < 3e-3
    assert check.time_sigma < 5e-3
    assert check.angle < 1.0
    assert not [each for each in tracked.findings if each.kind in ("axes", "gyro units")]
