"""Calibration of a recording: its files in the formats of EuRoC and Kalibr, and their combination.

``--calibration`` names up to two files: ``calibration.yaml`` of this package alone, or Kalibr's
``camchain-imucam.yaml`` and ``imu.yaml``. Missing values come from the recording: the files
``sensor.yaml`` of EuRoC, or the folder ``dso`` of TUM-VI.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import at
from bundle.errors import InputError, brief, shown
from bundle.model.rigid_motions import quaternion_from_matrix, rotation_matrices
from bundle.model.sequence.calibration import (
    Calibration,
    ImuNoise,
    finite_numbers,
    load_calibration,
    one_number,
    pose_numbers,
    read_yaml,
)

RATES = {"camera": 20.0, "imu": 200.0}  # Hz, where stamps and files give no plausible rate


class FoundCalibration(NamedTuple):
    """Calibration, size of its images (None: unknown), and sentences about its sources."""

    calibration: Calibration
    size: tuple[int, int] | None
    notes: tuple[str, ...]


def find_calibration(
    given: Sequence[Path],
    camera_files: Sequence[Path],
    imu_files: Sequence[Path],
    camera: str,
    stamps: tuple[Any, Any],
) -> FoundCalibration:
    """Read a calibration from given files; missing values come from the recording's files.

    ``given``: files of ``--calibration``. ``stamps``: stamps of images and of samples, for rates
    that the files lack.
    """
    contents = {path: read_yaml(path) for path in given}
    kinds = {path: kind_of_yaml(content) for path, content in contents.items()}
    for path, kind in kinds.items():
        if not kind:
            raise InputError(
                f"{shown(path)}: expected calibration.yaml, Kalibr's camchain-imucam.yaml or "
                f"imu.yaml, found the keys {', '.join(map(str, contents[path]))[:60]}"
            )
    own = next((path for path, kind in kinds.items() if kind == "own"), None)
    if own is not None:
        if len(given) > 1:
            raise InputError(f"{shown(own)}: expected no second file of --calibration beside it")
        calibration = load_calibration(own)
        if calibration.camera_model is None:
            raise InputError(
                f"{shown(own)}: camera_model: expected a model of COLMAP for images, found null"
            )
        return FoundCalibration(calibration, None, (f"Calibration: {shown(own)}.",))
    cameras = [path for path, kind in kinds.items() if kind in ("camchain", "camera")]
    imus = [path for path, kind in kinds.items() if kind == "imu"]
    beside = [each for path in cameras for each in _beside(path)]
    camera_path = _first(
        [*cameras, *camera_files], "the camera", "camchain-imucam.yaml", b"intrinsics"
    )
    imu_path = _first([*imus, *beside, *imu_files], "the IMU", "imu.yaml", b"noise_density")
    sensor = camera_sensor(camera_path, contents.get(camera_path) or read_yaml(camera_path), camera)
    imu = imu_sensor(imu_path, contents.get(imu_path) or read_yaml(imu_path))
    notes = (
        f"Camera: {shown(camera_path)}, {sensor.key}.",
        f"Noise of the IMU: {shown(imu_path)}.",
    )
    return FoundCalibration(_combined(sensor, imu, stamps), sensor.size, notes)


def _combined(sensor: CameraSensor, imu: ImuSensor, stamps: tuple[Any, Any]) -> Calibration:
    pose = sensor.from_imu
    if sensor.key == "T_BS":
        pose = pose @ imu.in_body
    quaternion = quaternion_from_matrix(pose[None, :3, :3])[0]
    return Calibration(
        camera_from_imu=(*quaternion.tolist(), *pose[:3, 3].tolist()),
        noise=imu.noise,
        camera_model=sensor.model,
        camera_params=sensor.params,
        imu_rate=imu.rate or _measured(stamps[1], "imu"),
        camera_rate=sensor.rate or _measured(stamps[0], "camera"),
        time_offset=sensor.time_offset,
    )


def _measured(stamps: Any, sensor: str) -> float:
    """Return the rate of stamps in nanoseconds, or a usual rate if theirs is implausible."""
    step = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    return 1e9 / step if 1e5 < step < 2e9 else RATES[sensor]


def _beside(path: Path) -> list[Path]:
    """Return the files beside a camchain that describe an IMU, if they are unique."""
    found = sorted([*path.parent.glob("*imu.y*ml"), *path.parent.glob("imu*.y*ml")])
    found = [each for each in dict.fromkeys(found) if kind_of_yaml(read_yaml(each)) == "imu"]
    return found if len(found) == 1 else []


def _first(paths: Iterable[Path], what: str, kalibr: str, key: bytes) -> Path:
    """Return the first path that exists and has a key; else the first one that exists."""
    tried = list(dict.fromkeys(paths))
    files = [path for path in tried if path.is_file()]
    if files:
        return next((path for path in files if key in path.read_bytes()), files[0])
    missing = "".join(f"{shown(path)} or " for path in tried)
    raise InputError(
        f"calibration of {what}: expected {missing}--calibration FILE, such as Kalibr's {kalibr}"
    )


# Calibrations of EuRoC and Kalibr, converted to this package's.
#
# ========================  ========================================================================
# EuRoC ``sensor.yaml``     one per sensor. ``T_BS`` takes points of the sensor to the body, so
#                           camera_from_imu = T_BS(camera)^-1 T_BS(IMU)
# Kalibr's camchain         one table per camera. ``T_cam_imu`` takes points of the IMU to the
# camera;
#                           ``timeshift_cam_imu`` is added to stamps of images:
#                           t_imu = t_cam + timeshift_cam_imu
# Kalibr's ``imu.yaml``     keys of the IMU as in ``sensor.yaml``, also below ``imu0``
# ========================  ========================================================================
#
# Both count pixels from the centre of the first one, as OpenCV does; tracks do so, too. Lenses map
# exactly: radial-tangential (4, 5 or 8 terms) to OPENCV or FULL_OPENCV, equidistant to
# OPENCV_FISHEYE, fov to FOV, eucm to EUCM, no distortion to PINHOLE.

Table = Mapping[Any, Any]

_NOISE = {
    "gyroscope_noise_density": "gyro_noise_density",
    "accelerometer_noise_density": "accel_noise_density",
    "gyroscope_random_walk": "gyro_bias_random_walk",
    "accelerometer_random_walk": "accel_bias_random_walk",
}
_RADTAN = ("radtan", "radial-tangential", "radial_tangential", "plumb_bob", "rational_polynomial")
_EQUIDISTANT = ("equidistant", "fisheye", "kannala_brandt")
_PADDED_RADTAN = {4: ("OPENCV", 4), 5: ("FULL_OPENCV", 8), 8: ("FULL_OPENCV", 8)}


class CameraSensor(NamedTuple):
    """Camera of a calibration."""

    # model, params: COLMAP's name of the lens model and its parameters
    model: str
    params: tuple[float, ...]
    from_imu: NDArray[np.float64]  # (4, 4) camera_from_imu for Kalibr; camera_from_body for EuRoC
    size: tuple[int, int] | None  # width and height; None if unknown
    rate: float | None  # images per second; None if unknown
    time_offset: float  # seconds that are added to stamps of images
    key: str  # the key that gave ``from_imu``


class ImuSensor(NamedTuple):
    """IMU of a calibration: noise, pose body_from_imu (4, 4), and rate if it is known."""

    noise: ImuNoise
    in_body: NDArray[np.float64]
    rate: float | None


def kind_of_yaml(content: Table) -> str:
    """Return "own", "camchain", "camera", "imu", or "" for another content."""
    if "camera_from_imu" in content or "gyro_noise_density" in content:
        return "own"
    if any(str(key).startswith("cam") and isinstance(content[key], dict) for key in content):
        return "camchain"
    if "intrinsics" in content:
        return "camera"
    is_imu = any(key in content for key in _NOISE) or content.get("sensor_type") == "imu"
    return "imu" if is_imu or isinstance(content.get("imu0"), dict) else ""


def rostopic(content: Table, camera: str, sensor: str) -> str:
    """Return the topic that a calibration names for "image" or "imu"; "" if it names none."""
    kind = kind_of_yaml(content)
    if sensor == "image":
        content = content[camera] if isinstance(content.get(camera), dict) else {}
    elif isinstance(content.get("imu0"), dict):
        content = content["imu0"]
    fits = kind == {"image": "camchain", "imu": "imu"}[sensor]
    return str(content.get("rostopic", "")) if fits else ""


def camera_sensor(path: Path, content: Table, name: str) -> CameraSensor:
    """Convert the table of a camera: EuRoC's ``sensor.yaml``, or camera ``name`` of a camchain."""
    place = shown(path)
    if kind_of_yaml(content) == "camchain":
        if not isinstance(content.get(name), dict):
            cameras = ", ".join(str(key) for key in content)
            raise InputError(f"{place}: expected the camera {name}, found {cameras}")
        content, place = content[name], f"{place}: {name}"
    for key in ("camera_model", "intrinsics", "distortion_model"):
        if key not in content:
            raise InputError(f"{place}: expected the key {key}; it is missing")
    if "T_cam_imu" in content:
        key, pose = "T_cam_imu", _motion(place, content, "T_cam_imu")
    elif "T_BS" in content:
        key, pose = "T_BS", np.asarray(np.linalg.inv(_motion(place, content, "T_BS")), np.float64)
    else:
        raise InputError(
            f"{place}: expected the key T_cam_imu (of Kalibr's camchain-imucam.yaml) or T_BS; both "
            "are missing"
        )
    model, params = _lens(place, content)
    return CameraSensor(
        model,
        params,
        pose,
        _size(place, content),
        _rate(place, content),
        one_number(f"{place}: timeshift_cam_imu", content.get("timeshift_cam_imu", 0.0)),
        key,
    )


def imu_sensor(path: Path, content: Table) -> ImuSensor:
    """Convert the table of an IMU: EuRoC's ``sensor.yaml``, or Kalibr's ``imu.yaml``."""
    place = shown(path)
    if isinstance(content.get("imu0"), dict):
        content, place = content["imu0"], f"{place}: imu0"
    missing = [key for key in _NOISE if key not in content]
    if missing:
        raise InputError(
            f"{place}: expected the noise densities {', '.join(_NOISE)}; "
            f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing"
        )
    values = {own: one_number(f"{place}: {key}", content[key]) for key, own in _NOISE.items()}
    with at(place):
        noise = ImuNoise(**values)
    pose = _motion(place, content, "T_BS") if "T_BS" in content else np.eye(4)
    return ImuSensor(noise, pose, _rate(place, content))


def _lens(place: str, content: Table) -> tuple[str, tuple[float, ...]]:
    values = [
        finite_numbers(f"{place}: {key}", content.get(key) or []).ravel().tolist()
        for key in ("intrinsics", "distortion_coefficients", "distortion_coeffs")
    ]
    inner, terms = values[0], values[1] or values[2]
    model, lens = str(content["camera_model"]).lower(), str(content["distortion_model"]).lower()
    if model == "eucm" and len(inner) == 6 and not any(terms):
        return "EUCM", (*inner[2:], *inner[:2])
    if model != "pinhole":
        raise InputError(
            f"{place}: camera_model: expected pinhole or eucm, found {brief(model)} (fit one of "
            "them with Kalibr)"
        )
    if len(inner) != 4:
        raise InputError(f"{place}: intrinsics: expected fx, fy, cx, cy, found {brief(inner)}")
    if lens in ("none", "null", "") or (lens in _RADTAN and not terms):
        return "PINHOLE", tuple(inner)
    if lens in _RADTAN and len(terms) in _PADDED_RADTAN:
        name, count = _PADDED_RADTAN[len(terms)]
        return name, (*inner, *terms, *[0.0] * (count - len(terms)))
    if lens in _EQUIDISTANT and len(terms) == 4:
        return "OPENCV_FISHEYE", (*inner, *terms)
    if lens == "fov" and len(terms) == 1:
        return "FOV", (*inner, *terms)
    known = (*_RADTAN, *_EQUIDISTANT, "fov")
    if lens not in known:
        raise InputError(
            f"{place}: distortion_model: expected radtan, equidistant, fov or none, found "
            f"{brief(lens)}"
        )
    raise InputError(f"{place}: expected the distortion coefficients of {lens}, found {len(terms)}")


def _motion(place: str, content: Table, key: str) -> NDArray[np.float64]:
    value = content[key]
    if isinstance(value, dict):  # OpenCV's matrix
        value = value.get("data")
    name = f"{place}: {key}"
    matrix = finite_numbers(name, value)
    if matrix.size != 16:
        raise InputError(f"{name}: expected a 4x4 matrix, found {brief(value)}")
    pose = np.array(pose_numbers(name, matrix.reshape(4, 4)))
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = rotation_matrices(pose[None, :4])[0], pose[4:]
    return found


def _size(place: str, content: Table) -> tuple[int, int] | None:
    if "resolution" not in content:
        return None
    size = finite_numbers(f"{place}: resolution", content["resolution"])
    if size.shape != (2,) or (size < 1).any():
        raise InputError(
            f"{place}: resolution: expected width and height, found {brief(content['resolution'])}"
        )
    return int(size[0]), int(size[1])


def _rate(place: str, content: Table) -> float | None:
    key = next((key for key in ("rate_hz", "update_rate") if key in content), None)
    if key is None:
        return None
    rate = one_number(f"{place}: {key}", content[key])
    return rate if rate > 0 else None
