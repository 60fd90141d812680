"""Sources of problems: the file or reconstruction that a problem comes from.

A ``pycolmap.Reconstruction`` cannot be pickled. It is pickled as the bytes of its binary files,
with the information that these files lose.
"""

from __future__ import annotations

import copy
import dataclasses
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.optional_packages import require_pycolmap
from bundle.base.own_process import PYCOLMAP, interrupts_deferred, require_memory
from bundle.base.records import dataclass
from bundle.errors import InputError, first_line
from bundle.model import rig_arrays
from bundle.model.colmap.source_records import (
    CAMERA,
    Contents,
    Datum,
    Frame,
    SourceRecords,
    records_of_model,
)

if TYPE_CHECKING:
    import pycolmap


# A COLMAP model in memory that is converted to a ``pycolmap.Reconstruction`` on first use.
#
# Importing pycolmap and building a reconstruction takes longer than solving a small problem. No
# command needs them. This package's reader returns arrays. Its writer takes the records that a
# problem lacks from the files: those that are small are kept in memory, the others stay open.


class DeferredSource:
    """Source of a problem that was read from a COLMAP model; edited copies share it.

    Attributes:
        model: the files, of which changed large ones raise an InputError; None once converted.
        fields: fields of the problem of this model, by name.
        folder: folder of the files, for messages.
    """

    def __init__(self, model: _core.ColmapModel, fields: Mapping[str, Any], folder: Path) -> None:
        self.model: _core.ColmapModel | None = model
        self.fields = fields
        self.folder = folder
        self._reconstruction: pycolmap.Reconstruction | None = None
        self._lock = threading.Lock()

    def __deepcopy__(self, memo: dict[int, Any]) -> Any:
        """Return an independent copy of the source, because callers may edit its reconstruction."""
        with self._lock:
            if self.model is None:
                return copy.deepcopy(self._reconstruction, memo)
            return DeferredSource(self.model, self.fields, self.folder)

    @property
    def has_changed(self) -> bool:
        """True if a file that is open, not in memory, was written to since it was read."""
        return self.model is not None and self.model.has_changed

    def reconstruction(self) -> pycolmap.Reconstruction:
        """Return the model as a reconstruction; every call returns the same object."""
        with self._lock:
            if self._reconstruction is None:
                assert self.model is not None
                self._reconstruction = _read_by_pycolmap(self.model, self.folder)
                self.model = None
            return self._reconstruction


def _read_by_pycolmap(model: _core.ColmapModel, folder: Path) -> pycolmap.Reconstruction:
    """Return the reconstruction that pycolmap builds from the bytes of the files in memory."""
    require_pycolmap("the source of a problem as a pycolmap.Reconstruction")
    require_memory("pycolmap", PYCOLMAP)
    with interrupts_deferred():  # the import of pycolmap cannot be interrupted
        import pycolmap
    reconstruction = pycolmap.Reconstruction()
    # Use the files that were read: others may have their names now.
    with written(model.files()) as temporary:
        try:
            if model.is_binary:
                reconstruction.read_binary(temporary)
            else:
                reconstruction.read_text(temporary)
        except (ValueError, LookupError, RuntimeError, MemoryError) as error:
            # Older versions of pycolmap lack the newest camera models.
            raise InputError(
                f"{folder}: expected a model that pycolmap {pycolmap.__version__} reads, "
                f"found: {first_line(error)}"
            ) from None
    for image_id, name in model.names_with_spaces.items():
        reconstruction.image(image_id).name = name
    return reconstruction


LOST_SIGMAS = "Sigmas of observations are left out."
"""Sentence about information that every file format loses."""


@dataclass(frozen=True, eq=False)
class BalSource:
    """Rotation vectors of a BAL file, kept because quaternions would lose their last bits."""

    rotations: NDArray[np.float64]  # (num_images, 3) angle-axis in radians, as in the file
    cam_from_world: NDArray[np.float64]  # (num_images, 7) poses computed from the file, by image id


def is_source(source: object) -> bool:
    """Return True if an object can be the source of a problem."""
    return (
        source is None
        or isinstance(source, BalSource | ImportedSource)
        or is_reconstruction(source)
    )


def is_colmap(source: object) -> bool:
    """Return True if a source, in the form kept by the problem, is a COLMAP model."""
    return isinstance(source, DeferredSource) or is_reconstruction(source)


def is_reconstruction(source: object) -> bool:
    """Return True if a source is a pycolmap.Reconstruction; does not import pycolmap."""
    pycolmap = sys.modules.get("pycolmap")  # None: no reconstruction can exist
    return pycolmap is not None and isinstance(source, pycolmap.Reconstruction)


def beside_the_problem(source: Any) -> list[str]:
    """Return the kinds of information that a source has and its problem lacks."""
    if source is None or isinstance(source, BalSource):
        return []
    if isinstance(source, ImportedSource):
        return ["point colours"] if source.point_colors.any() else []
    if isinstance(source, DeferredSource):
        if source.model is not None:  # files have no images without a pose
            colours = _core.colmap_contents(source.model)["point_colors"].any()
            return [*(["point colours"] if colours else []), "rigs", "frames"]
        source = source.reconstruction()
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
    data: list[tuple[str, int, int]]  # type and id of the sensor, id of its measurement


class _Image(NamedTuple):
    """An image without a pose and without observations of points."""

    image_id: int
    name: str
    camera_id: int
    frame_id: int
    keypoints: NDArray[np.float64]


class Packed(NamedTuple):
    """A picklable reconstruction: its binary files, and the information that they lose."""

    files: dict[str, bytes]
    frames: list[_Frame]
    images: list[_Image]
    cameras_with_prior_focal_length: list[int]


class PackedModel(NamedTuple):
    """The files of a COLMAP model that was not converted to a reconstruction."""

    files: dict[str, bytes]
    folder: str


def packed(source: Any) -> Any:
    """Return a picklable copy of a source; see :func:`unpacked`."""
    if isinstance(source, DeferredSource):
        if source.model is not None:
            return PackedModel(source.model.files(), str(source.folder))
        source = source.reconstruction()
    if not is_reconstruction(source):
        return source
    with written({}) as folder:
        source.write_binary(folder)
        files = {path.name: path.read_bytes() for path in Path(folder).iterdir()}
    registered = set(source.reg_image_ids())
    return Packed(
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
    """Return the source that :func:`packed` made picklable."""
    if isinstance(source, PackedModel):
        with written(source.files) as folder:
            model, fields = _core.read_colmap_model(folder, may_be_empty=True)
        fields["cam_from_world"] = rig_arrays.placed(fields)
        return DeferredSource(model, fields, Path(source.folder))
    if not isinstance(source, Packed):
        return source
    require_pycolmap("a problem made from a pycolmap.Reconstruction")
    import pycolmap  # not at start-up: takes longer than solving a small problem

    reconstruction = pycolmap.Reconstruction()
    with written(source.files) as folder:
        reconstruction.read_binary(folder)
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


def source_records(source: Any) -> SourceRecords | None:
    """Return the records that a source has and its problem lacks; None for BAL and no source.

    ``source``: source in the form kept by the problem; may be a model that is not yet converted to
    a reconstruction.
    """
    if isinstance(source, DeferredSource):
        if source.model is not None:
            return records_of_model(source.model)
        source = source.reconstruction()
    if not is_source(source):
        raise InputError(
            "source: expected None, a pycolmap.Reconstruction or the source of a problem that a "
            f"BAL file gave, found {type(source).__name__}"
        )
    if isinstance(source, ImportedSource):
        return source.records()
    return _records(packed(source)) if is_reconstruction(source) else None


def _records(source: Packed) -> SourceRecords:
    """Return the records of a reconstruction, including those of images without a pose."""
    try:
        with written(source.files) as folder:
            model, _ = _core.read_colmap_model(folder, may_be_empty=True)
    except InputError as error:
        message = str(error).replace(f"{folder}/", "")
        raise InputError(f"source: {message}") from None
    records = records_of_model(model)
    frames = {
        frame_id: Frame(rig_id, None, tuple(_datum(*datum) for datum in data))
        for frame_id, rig_id, data in source.frames
    }
    images = source.images

    def contents() -> Contents:
        found = records.contents()
        keypoints = [found.keypoint_xy, *(image.keypoints for image in images)]
        return dataclasses.replace(found, keypoint_xy=np.concatenate(keypoints))

    def more(ids: NDArray[np.int64], others: list[int]) -> NDArray[np.int64]:
        return np.append(ids, np.array(others, np.int64))

    # Images are in the order in which their frames were registered. Frames are ordered by id.
    frame_of_image = {i: f for f, frame in records.frames.items() for i in frame.image_ids}
    registered = dict.fromkeys(frame_of_image[i] for i in records.image_ids.tolist())
    in_order = {frame_id: records.frames[frame_id] for frame_id in [*registered, *records.frames]}
    return SourceRecords(
        rigs=records.rigs,
        frames=in_order | frames,
        image_ids=more(records.image_ids, [image.image_id for image in images]),
        image_camera_ids=more(records.image_camera_ids, [image.camera_id for image in images]),
        num_keypoints=more(records.num_keypoints, [len(image.keypoints) for image in images]),
        contents=contents,
    )


@contextmanager
def written(files: dict[str, bytes]) -> Iterator[str]:
    """Yield a temporary folder with files."""
    import tempfile  # slow to import

    with tempfile.TemporaryDirectory(prefix="bundle-") as folder:
        for name, content in files.items():
            (Path(folder) / name).write_bytes(content)
        yield folder


def _datum(sensor_type: str, sensor_id: int, datum_id: int) -> Datum:
    return Datum(CAMERA if sensor_type == "CAMERA" else 1, sensor_id, datum_id)


def _frame(frame: pycolmap.Frame) -> _Frame:
    data = [(datum.sensor_id.type.name, datum.sensor_id.id, datum.id) for datum in frame.data_ids]
    return _Frame(frame.frame_id, frame.rig_id, data)


def _image(image: pycolmap.Image) -> _Image:
    keypoints = np.array([point.xy for point in image.points2D]).reshape(-1, 2)
    return _Image(image.image_id, image.name, image.camera_id, image.frame_id, keypoints)


# Data of a file of another program that its problem lacks.
#
# COLMAP models and BAL files have sources of their own, above.


@dataclass(frozen=True, eq=False, kw_only=True)
class ImportedSource:
    """Source of a problem that was read from a file of another program."""

    point_ids: NDArray[np.int64]  # (num_points,) ids of the points of the file
    point_colors: NDArray[np.uint8]  # (num_points, 3) red, green, blue
    # reprojection RMSE in pixels by the formula of the other program
    source_rmse: float = float("nan")
    rmse: float = float("nan")  # the same by the formula of this package
    # sentences about data of the file that the problem lacks or approximates
    notes: tuple[str, ...] = ()
    # values by name that the writer of the same format uses again
    data: Mapping[str, Any] = field(default_factory=dict)

    def records(self) -> SourceRecords:
        """Return the records of COLMAP that this source has: the colours."""
        empty = SourceRecords()

        def contents() -> Any:
            return dataclasses.replace(
                empty.contents(),
                point_ids=self.point_ids,
                point_colors=self.point_colors,
                track_lengths=np.zeros(len(self.point_ids), np.int64),
            )

        return SourceRecords(contents=contents)


def imported_source(problem: Any) -> ImportedSource | None:
    """Return the source of a problem that was read from a file of another program, or None.

    Unlike ``problem.source``, this does not convert a COLMAP model to a reconstruction.
    """
    source = vars(problem)["source"]
    return source if isinstance(source, ImportedSource) else None
