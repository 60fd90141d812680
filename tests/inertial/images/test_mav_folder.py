"""Folders of EuRoC and TUM-VI: their variants, and one line for everything that is wrong."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

import bundle
from bundle.cli.main import main
from bundle.errors import InputError
from bundle.io.sequences.grey_images import grey_images, images_of_files
from bundle.io.sequences.recordings import read_mav
from bundle.model.rigid_motions import rotation_matrices
from tests.inertial.images.rendered_flight import CAMERA_FROM_IMU, NOISE, SMALL, Flight, render

Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A second of a flight."""
    return render(Flight(duration=1.2, **SMALL), tmp_path_factory.mktemp("flight"))


@pytest.fixture
def mav(rendered: Path, tmp_path: Path) -> Path:
    """A copy of the flight, to change."""
    return Path(shutil.copytree(rendered, tmp_path / rendered.name))


def rows(mav: Path, table: str = "cam0") -> list[str]:
    return (mav / table / "data.csv").read_text().splitlines()


def write(mav: Path, lines: list[str], table: str = "cam0") -> None:
    (mav / table / "data.csv").write_text("\n".join([*lines, ""]))


def test_the_calibration_of_euroc(mav: Path) -> None:
    calibration = read_mav(mav.parent).calibration
    pose = np.array(calibration.camera_from_imu)
    np.testing.assert_allclose(rotation_matrices(pose[None, :4])[0], CAMERA_FROM_IMU[:3, :3])
    np.testing.assert_allclose(pose[4:], CAMERA_FROM_IMU[:3, 3], atol=1e-12)
    assert calibration.camera_params == SMALL["lens"][1]
    assert (calibration.camera_rate, calibration.imu_rate) == (20.0, 200.0)
    assert calibration.noise.accel_bias_random_walk == NOISE["accelerometer_random_walk"]


def test_a_pose_of_the_imu_in_the_body_is_taken_along(mav: Path) -> None:
    path = mav / "imu0/sensor.yaml"
    content = yaml.safe_load(path.read_text())
    content["T_BS"]["data"][3] = 0.5  # m along the body's x axis
    path.write_text(
        "%YAML:1.0\n" + yaml.safe_dump(content).replace("T_BS:", "T_BS: !!opencv-matrix")
    )
    pose = np.array(read_mav(mav).calibration.camera_from_imu)
    expected = CAMERA_FROM_IMU[:3, 3] + 0.5 * CAMERA_FROM_IMU[:3, 0]
    np.testing.assert_allclose(pose[4:], expected, atol=1e-12)


def camchain(**changes: Any) -> dict[str, Any]:
    return {
        "T_cam_imu": CAMERA_FROM_IMU.tolist(),
        "camera_model": "pinhole",
        "distortion_coeffs": list(SMALL["lens"][1][4:]),
        "distortion_model": "radtan",
        "intrinsics": list(SMALL["lens"][1][:4]),
        "resolution": [320, 240],
        "timeshift_cam_imu": -0.004,
        **changes,
    }


@pytest.mark.parametrize("where", ["given", "beside", "tum"])
def test_kalibrs_files_in_place_of_euroc(mav: Path, where: str) -> None:
    (mav / "cam0/sensor.yaml").unlink()
    (mav / "imu0/sensor.yaml").unlink()
    folder = mav.parent / "dso"
    folder.mkdir()
    names = ("camchain.yaml", "imu_config.yaml" if where == "tum" else "imu.yaml")
    (folder / names[0]).write_text(yaml.safe_dump({"cam0": camchain()}))
    (folder / names[1]).write_text(yaml.safe_dump({**NOISE, "update_rate": 200.0}))
    given = {"given": names, "beside": names[:1], "tum": ()}[where]
    calibration = read_mav(mav, [folder / name for name in given]).calibration
    assert calibration.time_offset == -0.004
    np.testing.assert_allclose(calibration.camera_from_imu[4:], CAMERA_FROM_IMU[:3, 3], atol=1e-12)
    assert calibration.camera_rate == pytest.approx(20.0)


@pytest.mark.parametrize(
    ("changes", "model", "params"),
    [
        ({}, "OPENCV", SMALL["lens"][1]),
        ({"distortion_model": "equidistant"}, "OPENCV_FISHEYE", SMALL["lens"][1]),
        ({"distortion_model": "none", "distortion_coeffs": []}, "PINHOLE", SMALL["lens"][1][:4]),
        (
            {"distortion_model": "fov", "distortion_coeffs": [0.9]},
            "FOV",
            (*SMALL["lens"][1][:4], 0.9),
        ),
        (
            {"distortion_coeffs": [0.1, 0.2, 0.3, 0.4, 0.5]},
            "FULL_OPENCV",
            (*SMALL["lens"][1][:4], 0.1, 0.2, 0.3, 0.4, 0.5, 0, 0, 0),
        ),
        (
            {"camera_model": "eucm", "intrinsics": [0.6, 1.1, 200, 201, 160, 120],
             "distortion_model": "none", "distortion_coeffs": []},
            "EUCM",
            (200, 201, 160, 120, 0.6, 1.1),
        ),
        ({"camera_model": "omni"}, None, "pinhole or eucm"),
        ({"distortion_model": "spline"}, None, "radtan, equidistant, fov or none"),
        ({"distortion_coeffs": [0.1, 0.2]}, None, "coefficients"),
        ({"intrinsics": [1, 2, 3]}, None, "fx, fy, cx, cy"),
        ({"T_cam_imu": [[1, 2], [3, 4]]}, None, "4x4"),
        ({"T_cam_imu": (2 * np.eye(4)).tolist()}, None, "rigid motion"),
        ({"resolution": "large"}, None, "resolution"),
        ({"timeshift_cam_imu": "late"}, None, "timeshift_cam_imu"),
    ],
)  # fmt: skip
def test_lenses_of_kalibr(mav: Path, changes: Any, model: str | None, params: Any) -> None:
    path = mav / "chain.yaml"
    path.write_text(yaml.safe_dump({"cam0": camchain(**changes)}))
    if model is None:
        with pytest.raises(InputError, match=params) as raised:
            read_mav(mav, [path])
        assert str(path) in str(raised.value)
        return
    calibration = read_mav(mav, [path]).calibration
    assert calibration.camera_model == model
    np.testing.assert_allclose(calibration.camera_params, params)


def test_names_without_extension_and_16_bits(mav: Path) -> None:
    lines = rows(mav)
    write(mav, [line.removesuffix(".png") for line in lines])
    before = bundle.track_images(mav)
    for path in (mav / "cam0/data").iterdir():
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        cv2.imwrite(str(path), image.astype(np.uint16) * 256 + 77)
    after = bundle.track_images(mav)
    np.testing.assert_array_equal(after.sequence.xy, before.sequence.xy)
    path = mav / "twelve.png"
    cv2.imwrite(str(path), np.arange(4000, dtype=np.uint16).reshape(50, 80))
    (grey,) = grey_images(images_of_files([path]), None)
    np.testing.assert_array_equal(grey.ravel(), np.arange(4000) // 16)


def test_the_first_image_decides_size_and_scale() -> None:
    first, second = np.array([[4000, 16]], np.uint16), np.array([[255, 16]], np.uint16)
    found = [*grey_images([(first, "a"), (second, "b")], None)]
    np.testing.assert_array_equal(found, [[[250, 1]], [[15, 1]]])
    with pytest.raises(bundle.InputError, match=r"^b: .*2 x 1 .*1 x 2"):
        [*grey_images([(first, "a"), (first.T, "b")], None)]
    with pytest.raises(bundle.InputError, match=r"^a: .*int32"):
        [*grey_images([(first.astype(np.int32), "a")], None)]


def no_rows(mav: Path) -> None:
    write(mav, rows(mav)[:1])


def swapped_rows(mav: Path) -> None:
    lines = rows(mav)
    write(mav, [*lines[:5], lines[6], lines[5], *lines[7:]])


def seconds(table: str) -> Callable[[Path], None]:
    def change(mav: Path) -> None:
        head, *lines = rows(mav, table)
        parts = [line.split(",", 1) for line in lines]
        write(mav, [head, *(f"{int(a) / 1e9:.6f},{b}" for a, b in parts)], table)

    return change


def microseconds(mav: Path) -> None:
    for table in ("cam0", "imu0"):
        head, *lines = rows(mav, table)
        parts = [line.split(",", 1) for line in lines]
        write(mav, [head, *(f"{int(a) // 1000},{b}" for a, b in parts)], table)


def later_imu(mav: Path) -> None:
    head, *lines = rows(mav, "imu0")
    parts = [line.split(",", 1) for line in lines]
    write(mav, [head, *(f"{int(a) + 10**11},{b}" for a, b in parts)], "imu0")


def in_g(mav: Path) -> None:
    head, *lines = rows(mav, "imu0")
    parts = [line.split(",") for line in lines]
    write(mav, [head, *(",".join([*p[:4], *(str(float(x) / 9.81) for x in p[4:])]) for p in parts)],
          "imu0")  # fmt: skip


def without(path: str, key: str) -> Callable[[Path], None]:
    def change(mav: Path) -> None:
        content = yaml.safe_load((mav / path).read_text())
        del content[key]
        (mav / path).write_text(yaml.safe_dump(content))

    return change


def first_image(mav: Path) -> Path:
    return sorted((mav / "cam0/data").iterdir())[3]


def cut(mav: Path) -> None:
    path = first_image(mav)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def other_size(mav: Path) -> None:
    cv2.imwrite(str(first_image(mav)), np.zeros((100, 100), np.uint8))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda mav: first_image(mav).unlink(), ("cam0/data.csv: line 5", "missing", "1 of 22")),
        (cut, ("truncated",)),
        (lambda mav: first_image(mav).write_bytes(b"hello"), ("expected an image",)),
        (lambda mav: first_image(mav).write_bytes(b""), ("expected an image",)),
        (other_size, ("320 x 240", "100 x 100")),
        (no_rows, ("cam0/data.csv", "at least two images")),
        (swapped_rows, ("cam0/data.csv: line 7", "expected an image after")),
        (seconds("cam0"), ("cam0/data.csv: line 2", "seconds")),
        (seconds("imu0"), ("imu0/data.csv: line 2", "seconds instead of nanoseconds")),
        (microseconds, ("microseconds",)),
        (later_imu, ("expected images between the IMU samples",)),
        (in_g, ("imu0/data.csv", "probably g")),
        (lambda mav: write(mav, ["1,2", "3,4"], "imu0"), ("imu0/data.csv", "expected 7 columns")),
        (lambda mav: write(mav, ["1,a.png,3"]), ("cam0/data.csv: line 1", "a file name")),
        (without("imu0/sensor.yaml", "gyroscope_noise_density"), ("noise_density is missing",)),
        (without("cam0/sensor.yaml", "T_BS"), ("T_cam_imu", "T_BS")),
        (without("cam0/sensor.yaml", "intrinsics"), ("intrinsics",)),
        (lambda mav: (mav / "cam0/sensor.yaml").unlink(), ("sensor.yaml", "--calibration")),
        (lambda mav: (mav / "imu0/data.csv").unlink(), ("imu0/data.csv", "missing")),
        (lambda mav: (mav / "cam0/sensor.yaml").write_text("a: [1"), ("expected YAML",)),
    ],
)  # fmt: skip
def test_one_line_and_no_file(
    mav: Path,
    tmp_path: Path,
    capsys: Capture,
    change: Callable[[Path], Any],
    words: tuple[str, ...],
) -> None:
    change(mav)
    out, report = tmp_path / "out.tum", tmp_path / "report.json"
    assert main(["vio", str(mav), "-o", str(out), "--json", str(report), "--quiet"]) == 2
    found = capsys.readouterr()
    assert found.out == ""
    lines = [line for line in found.err.splitlines() if not line.startswith("[")]
    assert len(lines) == 1
    assert lines[0].startswith("error: ")
    assert all(word in lines[0] for word in words), lines[0]
    assert not out.exists()
    assert not report.exists()


def test_flags_of_images_need_images(mav: Path, tmp_path: Path, capsys: Capture) -> None:
    folder = tmp_path / "tracks"
    assert main(["convert", str(mav), str(folder), "--quiet"]) == 0
    for words in (["--camera", "cam1"], ["--num-features", "50"], ["--calibration", "x"]):
        assert main(["info", str(folder), *words]) == 2
        assert words[0] in capsys.readouterr().err
    assert main(["convert", str(folder), str(mav), "--quiet"]) == 2  # not among the images
    assert "other content" in capsys.readouterr().err
    assert main(["vio", str(mav), "-o", str(tmp_path / "x.tum"), "--camera", "cam7"]) == 2
    assert "cam7/data.csv" in capsys.readouterr().err


def test_without_opencv_the_line_names_pip(
    mav: Path, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    assert main(["vio", str(mav), "-o", str(tmp_path / "x.tum"), "--quiet"]) == 2
    assert "pip install opencv-python-headless" in capsys.readouterr().err


def test_info_names_what_looks_wrong(mav: Path, tmp_path: Path, capsys: Capture) -> None:
    report = tmp_path / "report.json"
    assert main(["info", str(mav), "--json", str(report), "--quiet"]) == 0
    found = json.loads(report.read_text())
    assert found["input"]["format"] == "mav"
    assert found["tracking"]["num_images"] == 22
    assert "tracks of" in capsys.readouterr().out


def test_the_page_names_every_key_and_column() -> None:
    page = (Path(__file__).parents[3] / "docs" / "vio_input.md").read_text()
    keys = {field.name for field in fields(bundle.Calibration)} - {"noise"}
    keys |= {field.name for field in fields(bundle.ImuNoise)} - {"integration_covariance"}
    for key in {*keys, *NOISE, "timestamp_ns", "track_id", "T_cam_imu", "timeshift_cam_imu"}:
        assert f"`{key}`" in page, key
