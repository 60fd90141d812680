"""Calibrations of EuRoC and Kalibr, converted to this package's.

========================  ========================================================================
EuRoC ``sensor.yaml``     one per sensor. ``T_BS`` takes points of the sensor to the body, so
                          camera_from_imu = T_BS(camera)^-1 T_BS(IMU)
Kalibr's camchain         one table per camera. ``T_cam_imu`` takes points of the IMU to the camera;
                          ``timeshift_cam_imu`` is added to stamps of images:
                          t_imu = t_cam + timeshift_cam_imu
Kalibr's ``imu.yaml``     keys of the IMU as in ``sensor.yaml``, also below ``imu0``
========================  ========================================================================

Both count pixels from the centre of the first one, as OpenCV does; tracks do so, too. Lenses map
exactly: radial-tangential (4, 5 or 8 terms) to OPENCV or FULL_OPENCV, equidistant to
OPENCV_FISHEYE, fov to FOV, eucm to EUCM, no distortion to PINHOLE.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError, brief, shown
from bundle.model.rotations import rotation_matrices
from bundle.model.sequence.calibration import pose_numbers
from bundle.model.sequence.imu_noise import ImuNoise
from bundle.model.sequence.yaml_files import finite_numbers, one_number

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
    """Camera of a calibration.

    Attributes:
        model, params: COLMAP's name of the lens model and its parameters.
        from_imu: (4, 4) camera_from_imu for Kalibr; camera_from_body for EuRoC.
        size: width and height; None if unknown.
        rate: images per second; None if unknown.
        time_offset: seconds that are added to stamps of images.
        key: the key that gave ``from_imu``.
    """

    model: str
    params: tuple[float, ...]
    from_imu: NDArray[np.float64]
    size: tuple[int, int] | None
    rate: float | None
    time_offset: float
    key: str


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
    """Return the topic that a calibration names for "image" or "imu"; "" without."""
    kind = kind_of_yaml(content)
    if sensor == "image":
        content = content[camera] if isinstance(content.get(camera), dict) else {}
    elif isinstance(content.get("imu0"), dict):
        content = content["imu0"]
    fits = kind == {"image": "camchain", "imu": "imu"}[sensor]
    return str(content.get("rostopic", "")) if fits else ""


def camera_sensor(path: Path, content: Table, name: str) -> CameraSensor:
    """Convert the table of a camera: EuRoC's ``sensor.yaml``, or camera ``name`` of a camchain.

    Raises:
        InputError: a key is missing, or its value is not supported; the message begins with the
            path and names the key.
    """
    place = shown(path)
    if kind_of_yaml(content) == "camchain":
        if not isinstance(content.get(name), dict):
            cameras = ", ".join(str(key) for key in content)
            raise InputError(f"{place}: expected the camera {name}, found {cameras}")
        content, place = content[name], f"{place}: {name}"
    for key in ("camera_model", "intrinsics", "distortion_model"):
        _needed(place, content, key)
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
    """Convert the table of an IMU: EuRoC's ``sensor.yaml``, or Kalibr's ``imu.yaml``.

    Raises:
        InputError: as for :func:`camera_sensor`.
    """
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
    try:
        noise = ImuNoise(**values)
    except InputError as error:
        raise InputError(f"{place}: {error}") from None
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


def _needed(place: str, content: Table, key: str) -> None:
    if key not in content:
        raise InputError(f"{place}: expected the key {key}; it is missing")
