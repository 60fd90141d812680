"""What a problem keeps of the file or reconstruction that it comes from.

A COLMAP model's source is a ``pycolmap.Reconstruction``, which does not pickle: it travels as the
bytes of its binary files, beside what these do not hold.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pycolmap

__all__ = [
    "LOST_SIGMAS",
    "BalSource",
    "beside_the_problem",
    "is_reconstruction",
    "is_source",
    "packed",
    "unpacked",
]

LOST_SIGMAS = "Sigmas of observations are left out."
"""Of what is lost when a problem is written: no format has a place for them."""


@dataclass(frozen=True, eq=False)
class BalSource:
    """The rotations of a BAL file: the way over quaternions and back costs their last bits.

    Attributes:
        rotations: (num_images, 3) angle-axis in radians, as in the file.
        cam_from_world: (num_images, 7) the poses that they became, by image id.
    """

    rotations: NDArray[np.float64]
    cam_from_world: NDArray[np.float64]


def is_source(source: object) -> bool:
    """Tell whether a problem can have this as its source."""
    return source is None or isinstance(source, BalSource) or is_reconstruction(source)


def is_reconstruction(source: object) -> bool:
    """Tell whether a source is a pycolmap.Reconstruction, without importing pycolmap."""
    pycolmap = sys.modules.get("pycolmap")  # not imported: there is no reconstruction
    return pycolmap is not None and isinstance(source, pycolmap.Reconstruction)


def beside_the_problem(source: Any) -> list[str]:
    """Return what a source has that its problem has not."""
    if source is None or isinstance(source, BalSource):
        return []
    is_known = is_reconstruction(source)
    colours = not is_known or any(point.color.any() for point in source.points3D.values())
    without_pose = not is_known or source.num_reg_images() < source.num_images()
    return [
        *(["point colours"] if colours else []),
        "rigs",
        "frames",
        *(["images without a pose"] if without_pose else []),
    ]


class _Frame(NamedTuple):
    """A frame without a pose."""

    frame_id: int
    rig_id: int
    data: list[tuple[str, int, int]]  # type and id of the sensor, id of what it took


class _Image(NamedTuple):
    """An image without a pose, which observes no point."""

    image_id: int
    name: str
    camera_id: int
    frame_id: int
    keypoints: NDArray[np.float64]


class _Packed(NamedTuple):
    """A reconstruction that pickles."""

    files: dict[str, bytes]
    frames: list[_Frame]
    images: list[_Image]
    cameras_with_prior_focal_length: list[int]


def packed(source: Any) -> Any:
    """Return the source of a problem as something that pickles; see :func:`unpacked`."""
    if not is_reconstruction(source):
        return source
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        source.write_binary(folder)
        files = {path.name: path.read_bytes() for path in folder.iterdir()}
    registered = set(source.reg_image_ids())
    return _Packed(
        files=files,
        frames=[_frame(frame) for frame in source.frames.values() if not frame.has_pose()],
        images=[_image(i) for key, i in source.images.items() if key not in registered],
        cameras_with_prior_focal_length=[
            camera_id
            for camera_id, camera in source.cameras.items()
            if camera.has_prior_focal_length
        ],
    )


def unpacked(source: Any) -> Any:
    """Return the source that :func:`packed` was given."""
    if not isinstance(source, _Packed):
        return source
    import tempfile

    import pycolmap

    with tempfile.TemporaryDirectory() as name:
        for file, content in source.files.items():
            (Path(name) / file).write_bytes(content)
        reconstruction = pycolmap.Reconstruction()
        reconstruction.read_binary(name)
    for camera_id in source.cameras_with_prior_focal_length:
        reconstruction.camera(camera_id).has_prior_focal_length = True
    for frame_id, rig_id, data in source.frames:
        frame = pycolmap.Frame()
        frame.frame_id, frame.rig_id = frame_id, rig_id
        for sensor_type, sensor_id, data_id in data:
            sensor = pycolmap.sensor_t(pycolmap.SensorType.__members__[sensor_type], sensor_id)
            frame.add_data_id(pycolmap.data_t(sensor, data_id))
        reconstruction.add_frame(frame)
    for image_id, image_name, camera_id, frame_id, keypoints in source.images:
        image = pycolmap.Image(image_name, keypoints, camera_id, image_id)
        image.frame_id = frame_id
        reconstruction.add_image(image)
    return reconstruction


def _frame(frame: pycolmap.Frame) -> _Frame:
    data = [(datum.sensor_id.type.name, datum.sensor_id.id, datum.id) for datum in frame.data_ids]
    return _Frame(frame.frame_id, frame.rig_id, data)


def _image(image: pycolmap.Image) -> _Image:
    keypoints = np.array([point.xy for point in image.points2D]).reshape(-1, 2)
    return _Image(image.image_id, image.name, image.camera_id, image.frame_id, keypoints)
