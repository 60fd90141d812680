"""Search for the files of a recording's calibration, and their combination.

``--calibration`` names up to two files: ``calibration.yaml`` of this package alone, or Kalibr's
``camchain-imucam.yaml`` and ``imu.yaml``. What they lack comes from the recording: the files
``sensor.yaml`` of EuRoC, or the folder ``dso`` of TUM-VI.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bundle.errors import InputError, shown
from bundle.io.sequences.sensor_yaml import (
    CameraSensor,
    ImuSensor,
    camera_sensor,
    imu_sensor,
    kind_of_yaml,
)
from bundle.model.rotations import quaternion_from_matrix
from bundle.model.sequence.calibration import Calibration, load_calibration
from bundle.model.sequence.yaml_files import read_yaml

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
    """Read a calibration from given files, and what they lack from the recording's.

    Args:
        given: files of ``--calibration``.
        camera_files: files of the recording that may exist, the first has precedence.
        imu_files: likewise for the IMU.
        camera: name of the camera in a camchain.
        stamps: stamps of images and of samples, for rates that the files lack.

    Raises:
        InputError: a file or a key is missing; one line with the names that were expected.
        OSError: a file cannot be read.
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
        return _own(own, given)
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


def _own(path: Path, given: Sequence[Path]) -> FoundCalibration:
    if len(given) > 1:
        raise InputError(f"{shown(path)}: expected no second file of --calibration beside it")
    calibration = load_calibration(path)
    if calibration.camera_model is None:
        raise InputError(
            f"{shown(path)}: camera_model: expected a model of COLMAP for images, found null"
        )
    return FoundCalibration(calibration, None, (f"Calibration: {shown(path)}.",))


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
