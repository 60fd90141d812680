"""Sequence folders: exact numbers there and back, bad content in one line."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import bundle
from bundle.io.sequences.sequence_folder import load_sequence, read_sequence, save_sequence
from tests.inertial.vio.sequences import START, calibration, edited, sequence

ARRAYS = ("imu_timestamps_ns", "gyro", "accel", "track_timestamps_ns", "track_ids", "xy")


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"camera_model": "PINHOLE", "camera_params": (400.0, 410.0, 320.0, 240.0)},
        {"time_offset": 0.0123456789, "imu_rate": 199.99, "pixel_sigma": 0.7},
    ],
    ids=["normalised", "pinhole", "offset"],
)
def test_every_number_comes_back(tmp_path: Path, changes: dict[str, Any]) -> None:
    written = sequence(calibration=calibration(**changes))
    save_sequence(written, tmp_path / "s")
    read = load_sequence(tmp_path / "s")
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(read, name), getattr(written, name))
    assert read.calibration == written.calibration


def test_tracks_may_be_sorted_by_track_and_lines_end_as_on_windows(tmp_path: Path) -> None:
    save_sequence(sequence(), tmp_path)
    head, *rows = (tmp_path / "tracks.csv").read_text().splitlines()
    rows.sort(key=lambda row: int(row.split(",")[1]))
    (tmp_path / "tracks.csv").write_bytes("\r\n".join([head, *rows, "", ""]).encode("utf-8-sig"))
    read = load_sequence(tmp_path)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(read, name), getattr(sequence(), name))


def imu_row(sample: int, *, stamp: int | None = None, ax: float = 0.0) -> str:
    return f"{START + 5_000_000 * sample if stamp is None else stamp},0,0,0,{ax},0,9.81"


@pytest.mark.parametrize(
    ("name", "line", "text", "found"),
    [
        ("imu.csv", 7, imu_row(3), "time goes back"),
        ("imu.csv", 7, imu_row(4), "duplicate"),
        ("imu.csv", 7, imu_row(5, ax=float("nan")), "finite"),
        ("imu.csv", 7, "1,2,3", "7 columns"),
        ("imu.csv", 7, imu_row(5) + ",8", "7 columns"),
        ("imu.csv", 7, "1.5,0,0,0,0,0,9.8", "'1.5'"),
        ("imu.csv", 7, "99999999999999999999,0,0,0,0,0,9.8", "64 bits"),
        ("imu.csv", 7, f"{START + 25_000_000},0,0,x,0,0,9.8", "wz"),
        ("tracks.csv", 9, f"{START + 100_000_000},4,0,inf", "finite"),
        ("tracks.csv", 9, f"{START + 100_000_000},3,0,0", "track 3 twice"),
        ("tracks.csv", 9, f"{START - 1},4,0,0", "time goes back"),
        ("tracks.csv", 9, f"{START},4.5,0,0", "track_id"),
    ],
)
def test_a_bad_line_is_named(tmp_path: Path, name: str, line: int, text: str, found: str) -> None:
    with pytest.raises(bundle.InputError) as caught:
        load_sequence(edited(tmp_path, name, line, text))
    message = str(caught.value)
    assert f"{tmp_path / name}: line {line}:" in message
    assert found in message
    assert "\n" not in message


@pytest.mark.parametrize("unit", [10**3, 10**6, 10**9])
@pytest.mark.parametrize("names", [("imu",), ("tracks",), ("imu", "tracks")])
def test_stamps_in_another_unit_are_refused(
    tmp_path: Path, unit: int, names: tuple[str, ...]
) -> None:
    """In whole seconds stamps repeat, which counts once."""
    save_sequence(sequence(), tmp_path)
    for name in names:
        head, *rows = (tmp_path / f"{name}.csv").read_text().splitlines()
        cells = [row.split(",", 1) for row in rows]
        whole = [f"{int(stamp) // unit},{rest}" for stamp, rest in cells]
        (tmp_path / f"{name}.csv").write_text("\n".join([head, *whole]))
    if unit == 10**9:  # one stamp, or two
        with pytest.raises(bundle.InputError):
            read_sequence(tmp_path)
        return
    word = {10**3: "microseconds", 10**6: "milliseconds"}[unit]
    with pytest.raises(bundle.InputError, match=f"{names[0]}.csv: line 2: .*{word}"):
        read_sequence(tmp_path)


@pytest.mark.parametrize("factor", [0.01, 0.2, 3.0, 100.0])
def test_rates_that_are_off_tell_no_unit(factor: float) -> None:
    rates = {"imu_rate": 200 * factor, "camera_rate": 20 * factor}
    assert sequence(calibration=calibration(**rates)).num_frames > 1


@pytest.mark.parametrize("unit", [10**3, 10**6])
def test_arrays_in_another_unit_are_refused(unit: int) -> None:
    given = sequence()
    stamps = {
        name: getattr(given, name) // unit for name in ("imu_timestamps_ns", "track_timestamps_ns")
    }
    with pytest.raises(bundle.InputError, match="IMU sample 0: expected stamps in nanoseconds"):
        sequence(**stamps)
    with pytest.raises(bundle.InputError, match="observation 0: expected stamps in nanoseconds"):
        sequence(**stamps, calibration=calibration(imu_rate=200 * unit))


@pytest.mark.parametrize(
    ("key", "value", "found"),
    [
        ("camera_from_imu", [0, 0, 0, 2, 0, 0, 0], "norm 2"),
        ("camera_from_imu", [0, 0, 0, 1], "4x4"),
        ("camera_from_imu", np.diag([2.0, 1, 1, 1]).tolist(), "rigid"),
        ("camera_from_imu", "north", "'north'"),
        ("camera_model", "PINHOL", "PINHOLE"),
        ("camera_model", "PINHOLE", "fx"),
        ("imu_rate", 0, "above 0"),
        ("gyro_noise_density", -1, "found -1"),
        ("focal", None, "focal"),
        ("gyro_noise_density", ..., "gyro_noise_density"),
        ("focal", ..., "focal"),
        ("acel_noise_density", 1, "accel_noise_density"),
    ],
)
def test_a_bad_value_of_the_calibration_is_named(
    tmp_path: Path, key: str, value: Any, found: str
) -> None:
    save_sequence(sequence(), tmp_path)
    path = tmp_path / "calibration.yaml"
    content = yaml.safe_load(path.read_text()) | {key: value}
    if key == "camera_model":
        content["camera_params"] = [1.0]
    path.write_text(yaml.safe_dump({k: v for k, v in content.items() if v is not ...}))
    with pytest.raises(bundle.InputError, match=re.escape(found)) as caught:
        load_sequence(tmp_path)
    assert str(path) in str(caught.value)


def test_the_calibration_takes_matrices_and_numbers_without_a_point(tmp_path: Path) -> None:
    save_sequence(sequence(), tmp_path)
    path = tmp_path / "calibration.yaml"
    content = yaml.safe_load(path.read_text())
    content["camera_from_imu"] = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    path.write_text(yaml.safe_dump(content).replace("0.00017", "17e-5"))
    read = load_sequence(tmp_path).calibration
    half = np.sqrt(0.5)
    np.testing.assert_allclose(read.camera_from_imu, [0, 0, half, half, 1, 2, 3], atol=1e-15)
    assert read.noise.gyro_noise_density == 1.7e-4


@pytest.mark.parametrize("text", ["a: [1", "\t- 3: :", "5", ""])
def test_what_is_no_yaml_is_refused(tmp_path: Path, text: str) -> None:
    save_sequence(sequence(), tmp_path)
    (tmp_path / "calibration.yaml").write_text(text)
    with pytest.raises(bundle.InputError, match=r"calibration\.yaml"):
        load_sequence(tmp_path)


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"accel": np.tile([0, 0, 1.0], (401, 1))}, "probably g"),
        ({"accel": np.tile([0, 0, 2.5], (401, 1))}, "median norm of 2.5"),
        ({"gyro": np.tile([0, 0, 90.0], (401, 1))}, "probably degrees"),
        ({"track_timestamps_ns": np.repeat(np.arange(21), 5)}, "images from 0 to 20 ns"),
        ({"gyro": np.zeros((400, 3))}, "gyro: expected shape (401, 3)"),
        ({"xy": np.zeros((105, 3))}, "xy: expected shape (105, 2)"),
        ({"track_ids": np.zeros(104, int)}, "track_ids: expected shape (105,)"),
        ({"imu_timestamps_ns": np.array([1.5, 2])}, "imu_timestamps_ns: expected whole"),
        ({"calibration": None}, "calibration: expected a Calibration"),
        ({"track_ids": np.tile([9, 8, 7, 4, 3], 21)}, "observation 1: expected ids that ascend"),
    ],
)
def test_bad_arrays_are_refused(changes: dict[str, Any], found: str) -> None:
    with pytest.raises(bundle.InputError, match=re.escape(found)):
        sequence(**changes)


def test_a_gap_is_fatal_where_a_bad_stretch_of_its_length_is_not_bridged(tmp_path: Path) -> None:
    for milliseconds, is_fatal in ((15, False), (2000, False), (2001, True)):
        stamps = sequence().imu_timestamps_ns.copy()
        stamps[11:] += 1_000_000 * (milliseconds - 5)
        save_sequence(sequence(imu_timestamps_ns=stamps), tmp_path)
        finding = read_sequence(tmp_path)[1][0]
        assert (finding.kind, finding.count, finding.is_fatal) == ("imu gap", 1, is_fatal)
        if is_fatal:
            with pytest.raises(bundle.InputError, match=r"imu\.csv: line 13: .* 2 s: too long"):
                load_sequence(tmp_path)
        else:
            load_sequence(tmp_path)
            assert finding.sentence.endswith("bridged with more uncertainty")


def test_frames_and_stamps_on_the_clock_of_the_imu() -> None:
    given = sequence(calibration=calibration(time_offset=0.005))
    stamps, begin = given.frames()
    np.testing.assert_array_equal(stamps, START + 100_000_000 * np.arange(21))
    np.testing.assert_array_equal(begin, 5 * np.arange(22))
    np.testing.assert_array_equal(given.image_timestamps_ns, given.track_timestamps_ns + 5_000_000)
    assert given.num_frames == 21
    assert given.duration == pytest.approx(2.0, abs=1e-12)


def test_pixels_become_coordinates_of_rays() -> None:
    lens = ("OPENCV", (400.0, 410.0, 320.0, 240.0, -0.1, 0.02, 1e-3, -2e-3))
    pixels = np.random.default_rng(1).uniform(100, 400, (105, 2))
    given = sequence(
        xy=pixels, calibration=calibration(camera_model=lens[0], camera_params=lens[1])
    )
    rays = np.c_[given.normalized(), np.ones(105)]
    np.testing.assert_allclose(bundle.project(lens[0], lens[1], rays)[0], pixels, atol=1e-6)
    assert given.calibration.focal == 405.0
    np.testing.assert_array_equal(sequence().normalized(), sequence().xy)


def test_other_folders_are_not_written_into(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    for path in (tmp_path, tmp_path / "notes.txt"):
        with pytest.raises(bundle.InputError):
            save_sequence(sequence(), path)
    assert [file.name for file in tmp_path.iterdir()] == ["notes.txt"]
