"""Conversion of a ``pycolmap.Reconstruction`` to the fields of a problem.

``write_back`` converts in the other direction. A rig with one camera has
``rig_from_world = cam_from_world``, so the pose is read from the image. For other rigs see
``bundle.model.rig_arrays``. pycolmap preserves every bit of poses, parameters and points.
"""

from __future__ import annotations

import functools
import os
import struct
import threading
import time
from collections.abc import Callable
from itertools import chain, compress
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arrays import check_type, refuse_row
from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.model import rig_arrays
from bundle.model.cameras import camera_models
from bundle.model.colmap.model_records import MAX_POINT_ID, ModelRecords, model_records
from bundle.model.problem_arrays import ProblemArrays
from bundle.model.pycolmap.problem_source import (
    Packed,
    is_reconstruction,
    packed,
    unpacked,
    written,
)


def fields_of(reconstruction: pycolmap.Reconstruction) -> dict[str, Any]:
    """Return the fields of a problem from a reconstruction.

    The source of the problem is a copy of the reconstruction.
    """
    check_type("reconstruction", reconstruction, pycolmap.Reconstruction)
    reconstruction = pycolmap.Reconstruction(reconstruction)
    cameras = [camera for _, camera in sorted(reconstruction.cameras.items())]
    images = [reconstruction.image(image_id) for image_id in sorted(reconstruction.reg_image_ids())]
    ids = sorted(reconstruction.point3D_ids())
    points = list(map(reconstruction.point3D, ids))
    point_ids = ids_of_points(ids)
    observations = Observations.of(images)
    fields = fields_of_images(reconstruction, images, cameras) | dict(
        points=positions_of(points),
        point_ids=point_ids,
        **observations.fields(point_ids),
        source=reconstruction,
    )
    _check_tracks(reconstruction, points, fields)
    return fields


def fields_of_images(
    reconstruction: pycolmap.Reconstruction,
    images: list[pycolmap.Image],
    cameras: list[pycolmap.Camera],
) -> dict[str, Any]:
    """Return the fields of images, of their rigs and of cameras, each in the order of ids."""
    camera_index = {camera.camera_id: index for index, camera in enumerate(cameras)}
    rigs = rigs_of(reconstruction, images)
    poses = np.zeros((len(images), 7))
    alone = ~np.array(rigs.framed, bool)
    poses[alone] = _rows([image.cam_from_world() for image in compress(images, alone.tolist())])
    return dict(
        cam_from_world=rig_arrays.placed(rigs.fields | {"cam_from_world": poses}),
        **rigs.fields,
        image_ids=np.array([image.image_id for image in images], np.int64),
        image_names=tuple(_name(image) for image in images),
        image_camera=np.array([camera_index[image.camera_id] for image in images], np.int32),
        camera_ids=np.array([camera.camera_id for camera in cameras], np.int64),
        camera_models=tuple(camera.model.name for camera in cameras),
        camera_params=_padded([_params(camera) for camera in cameras]),
        camera_sizes=np.array([_size(camera) for camera in cameras], np.int64).reshape(-1, 2),
        format="colmap",
    )


def ids_of_points(ids: list[int]) -> NDArray[np.int64]:
    """Return ascending ids of points as an array."""
    if ids and ids[-1] > MAX_POINT_ID:
        raise InputError(f"expected point ids below 2^63, found {ids[-1]}")
    return np.array(ids, np.int64)


def _name(image: pycolmap.Image) -> str:
    try:
        return str(image.name)
    except UnicodeDecodeError:
        raise InputError(f"image {image.image_id}: expected a name in UTF-8") from None


def _size(camera: pycolmap.Camera) -> tuple[int, int]:
    if max(camera.width, camera.height) >= 2**63:
        raise InputError(
            f"camera {camera.camera_id}: expected an image size below 2^63, "
            f"found {camera.width} x {camera.height}"
        )
    return camera.width, camera.height


def _params(camera: pycolmap.Camera) -> NDArray[np.float64]:
    # Problem raises the error for unknown models.
    expected = len(camera_models().get(camera.model.name, camera.params))
    if len(camera.params) != expected:
        raise InputError(
            f"camera {camera.camera_id}: expected {expected} parameters of {camera.model.name}, "
            f"found {len(camera.params)}"
        )
    return camera.params


def _padded(rows: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Stack rows of different lengths, filled up with zeros."""
    padded = np.zeros((len(rows), max(map(len, rows), default=0)))
    for target, row in zip(padded, rows, strict=True):
        target[: len(row)] = row
    return padded


@dataclass(frozen=True)
class Observations:
    """Keypoints that observe points, sorted by image and keypoint."""

    images: list[pycolmap.Image]  # the images
    image: NDArray[np.int32]  # positions in `images`
    point_id: NDArray[np.uint64]  # ids of points, unsigned
    xy: NDArray[np.float64]  # (n, 2) in pixels

    @staticmethod
    def of(images: list[pycolmap.Image]) -> Observations:
        """Return the observations of images."""
        return observations_and_tracks(images, [])[0]

    def joined(self, others: Observations) -> Observations:
        """Return these observations and those of other images."""
        if not len(others.image):
            return self
        both = [*self.images, *others.images]
        by_id = np.argsort([image.image_id for image in both])
        image = np.concatenate([self.image, len(self.images) + others.image])
        image = np.argsort(by_id).astype(np.int32)[image]
        order = np.argsort(image, kind="stable")
        return Observations(
            [both[row] for row in by_id.tolist()],
            image[order],
            np.concatenate([self.point_id, others.point_id])[order],
            np.concatenate([self.xy, others.xy])[order],
        )

    def taken(self, rows: NDArray[np.integer]) -> Observations:
        """Return some of these observations in another order, and their images."""
        image = self.image[rows]
        used = np.bincount(image, minlength=len(self.images)) > 0
        return Observations(
            list(compress(self.images, used.tolist())),
            (np.cumsum(used, dtype=np.int32) - np.int32(1))[image],
            self.point_id[rows],
            self.xy[rows],
        )

    def by_point(self) -> tuple[NDArray[np.intp], NDArray[np.uint64], NDArray[np.int64]]:
        """Return the order by point, image and keypoint, and ids and counts of the points."""
        order = np.argsort(self.point_id, kind="stable")  # images and keypoints ascend already
        sorted_ids = self.point_id[order]
        starts = np.flatnonzero(np.append(True, sorted_ids[1:] != sorted_ids[:-1])[: len(order)])
        return order, sorted_ids[starts], np.diff(np.append(starts, len(order)))

    def points(self, point_ids: NDArray[np.int64]) -> NDArray[np.int32]:
        """Return the position of each observed point in `point_ids`, which ascend."""
        rows = np.searchsorted(point_ids, self.point_id).astype(np.int32)
        found = np.append(point_ids.astype(np.uint64), MAX_POINT_ID + 1)[rows] == self.point_id
        refuse_row(
            ~found,
            lambda bad: (
                f"image {self.images[self.image[bad]].image_id}, keypoint {self.keypoints()[bad]}: "
                f"expected a point of the reconstruction, found point {self.point_id[bad]}"
            ),
        )
        return rows

    def keypoints(self) -> NDArray[np.int32]:
        """Return the indices of all observations of the images among their keypoints."""
        found = map(pycolmap.Image.get_observation_point2D_idxs, self.images)
        return np.fromiter(chain.from_iterable(found), np.int32, len(self.image))

    def fields(self, point_ids: NDArray[np.int64]) -> dict[str, Any]:
        """Return the fields of a problem with these points, sorted by point, image, keypoint."""
        points = self.points(point_ids)
        order = np.argsort(points, kind="stable")  # images and keypoints ascend already
        return {
            "observation_image": self.image[order],
            "observation_point": points[order],
            "observation_xy": self.xy[order],
            "observation_keypoint": self.keypoints()[order],
        }


_FILES = ("images.bin", "points3D.bin")
_KEYPOINT = np.dtype([("xy", "<f8", 2), ("point_id", "<u8")])  # in COLMAP's images.bin
_IMAGE_HEAD = 64  # bytes of id, pose and camera, before name and number of keypoints
_POINT = struct.Struct("<Q35xQ")  # id; position, colour and error; length of the track
_IMAGES_PER_FILE = 64
_MOST_KEYPOINTS = 100_000


def observations_and_tracks(
    images: list[pycolmap.Image], points: list[pycolmap.Point3D]
) -> tuple[Observations, NDArray[np.int64]]:
    """Return the observations of images, and the elements of points' tracks.

    The (n, 3) columns of elements are image id, keypoint, and position in ``points``.
    pycolmap has no arrays of them, and takes 0.5 us for the object of a keypoint or element.
    Writing a model with only these keypoints and points to a file takes 50 ns for each.
    """
    counts = np.array([image.num_points3D for image in images], np.int64)
    xy, point_id = np.empty((counts.sum(), 2)), np.empty(counts.sum(), np.uint64)
    end = 0
    for first in range(0, max(len(images), 1), _IMAGES_PER_FILE):
        some = images[first : first + _IMAGES_PER_FILE]
        keypoints = [image.get_observation_points2D() for image in some]
        # A model in which image ids count from 1, point ids from 0.
        model = pycolmap.Reconstruction()
        model.add_camera_with_trivial_rig(_identity_camera())
        for row, of_image in enumerate(keypoints):
            made = pycolmap.Image("", of_image, _identity_camera().camera_id, row + 1)
            model.add_image_with_trivial_frame(made, pycolmap.Rigid3d())
        for row, point in enumerate([] if first else points):
            model.points3D[row] = point
        contents = _written(model, lambda folder: [Path(folder, n).read_bytes() for n in _FILES])
        of_images, of_points = contents or (b"", b"")
        records = _keypoints_in(of_images, [*map(len, keypoints)])
        for found in records or map(records_from_objects, keypoints):
            start, end = end, end + len(found)
            xy[start:end], point_id[start:end] = found["xy"], found["point_id"]
        if not first:
            elements = _elements_in(of_points, points)
    image = np.repeat(np.arange(len(images), dtype=np.int32), counts)
    return Observations(images, image, point_id, xy), elements


def small_model(
    reconstruction: pycolmap.Reconstruction, named: frozenset[int], most: int
) -> tuple[list[pycolmap.Image], dict[str, Any]] | None:
    """Return the images of all observations, and the fields of a problem.

    None if the model has errors, or more than ``most`` times the keypoints that are needed. Files
    take 0.2 us for an observation; objects of points and of other observations take 1 us each.
    """
    if reconstruction.num_reg_images() > most * len(named):
        return None
    images = [reconstruction.image(key) for key in sorted(reconstruction.reg_image_ids())]
    needed = sum(image.num_points3D for image in images if image.image_id in named)
    if sum(image.num_points2D() for image in images) > min(most * needed, _MOST_KEYPOINTS):
        return None
    _, fields = _written(reconstruction, _core.read_colmap_model) or (None, None)
    if not fields or fields["image_ids"].tolist() != [image.image_id for image in images]:
        return None
    return images, fields


def fields_of_some(found: dict[str, Any], images: Any, cameras: Any) -> dict[str, Any]:
    """Return the fields of images and cameras, by ids, among those of a problem without rigs."""
    images = np.searchsorted(found["image_ids"], images)
    cameras = np.searchsorted(found["camera_ids"], cameras)
    image_camera = np.searchsorted(cameras, found["image_camera"][images])
    return {
        **{name: found[name] for name in rig_arrays.ARRAYS},
        **{name: found[name][images] for name in ("cam_from_world", "image_ids")},
        **{name: found[name][cameras] for name in ("camera_ids", "camera_params", "camera_sizes")},
        "image_names": tuple(map(found["image_names"].__getitem__, images.tolist())),
        "image_camera": image_camera.astype(np.int32),
        "camera_models": tuple(map(found["camera_models"].__getitem__, cameras.tolist())),
        "format": "colmap",
    }


def _written(model: pycolmap.Reconstruction, read: Callable[[str], Any]) -> Any:
    """Return what is read from the files of a model; None if there is no folder in memory."""
    name = f"bundle-{os.getpid()}-{threading.get_ident()}-{time.monotonic_ns()}"
    folder = Path("/dev/shm", name)
    try:
        folder.mkdir(0o700)
        try:
            model.write_binary(folder)
            return read(str(folder))
        finally:
            for path in folder.iterdir():
                path.unlink()
            folder.rmdir()
    except (OSError, ValueError):  # no such folder, or files that cannot be written or read
        return None


def _keypoints_in(content: bytes, counts: list[int]) -> list[NDArray[Any]]:
    """Return the records of the keypoints of each image; an empty list if the file has others."""
    records, end = [], 8
    for image_id, count in enumerate(counts, 1):
        start = content.find(b"\0", end + _IMAGE_HEAD) + 9
        head, end = content[end : end + 4] + content[start - 8 : start], start + 24 * count
        if head != struct.pack("<IQ", image_id, count) or end > len(content):
            return []
        records.append(np.frombuffer(content, _KEYPOINT, count, start))
    return records if end == len(content) else []


def _elements_in(content: bytes, points: list[pycolmap.Point3D]) -> NDArray[np.int64]:
    """Return the elements of points' tracks, from objects if the file has other points."""
    rows, tracks, end = list[int](), list[bytes](), 8
    while end + _POINT.size <= len(content):  # in any order
        row, length = _POINT.unpack_from(content, end)
        start, end = end + _POINT.size, end + _POINT.size + 8 * length
        rows.append(row)
        tracks.append(content[start:end])
    if end != len(content) or sorted(rows) != list(range(len(points))):
        found = [(row, one) for row, point in enumerate(points) for one in point.track.elements]
        columns = [(one.image_id, one.point2D_idx, row) for row, one in found]
        return np.array(columns, np.int64).reshape(-1, 3)
    elements = np.frombuffer(b"".join(tracks), "<u4").reshape(-1, 2)
    lengths = np.array([len(track) // 8 for track in tracks], np.int64)
    return np.column_stack([elements, np.repeat(np.array(rows, np.int64), lengths)])


def records_from_objects(keypoints: Any) -> NDArray[Any]:
    """Return the "xy" and "point_id" of a list of keypoints, one object at a time."""
    records = np.empty(len(keypoints), _KEYPOINT)
    records["xy"] = pixels_of(pycolmap.Point2DList(keypoints))
    ids = map(attrgetter("point3D_id"), keypoints)
    records["point_id"] = np.fromiter(ids, np.uint64, len(keypoints))
    return records


def pixels_of(keypoints: pycolmap.Point2DList) -> NDArray[np.float64]:
    """Return the pixels of keypoints, bit for bit.

    pycolmap has no array of keypoints. The camera with f = 1 and its principal point at 0 returns
    their pixels unchanged.
    """
    return _identity_camera().cam_from_img(keypoints)


@functools.cache
def _identity_camera() -> pycolmap.Camera:
    return pycolmap.Camera(camera_id=1, model="SIMPLE_PINHOLE", width=1, height=1, params=[1, 0, 0])


def _check_tracks(
    reconstruction: pycolmap.Reconstruction,
    points: list[pycolmap.Point3D],
    fields: dict[str, Any],
) -> None:
    """Check that tracks and the keypoints of registered images refer to each other.

    Otherwise pycolmap could not compute the errors of points and would write files that do not
    load.
    """
    length, point_ids = lengths_of_tracks(points), fields["point_ids"]
    observed = np.bincount(fields["observation_point"], minlength=len(points))
    check_lengths(point_ids, length, observed, length != observed)
    if is_valid(reconstruction):
        return
    elements = observations_and_tracks([], points)[1]
    elements = elements[np.argsort(elements[:, 2], kind="stable")]
    elements[:, 2] = point_ids[elements[:, 2]]
    columns = (
        fields["image_ids"][fields["observation_image"]],
        fields["observation_keypoint"],
        point_ids[fields["observation_point"]],
    )
    referring = set(zip(*(column.tolist() for column in columns), strict=True))
    are_right = [tuple(row) in referring for row in elements.tolist()]
    check_elements(elements, np.array(are_right, bool))


def check_elements(elements: NDArray[np.int64], are_right: NDArray[np.bool_]) -> None:
    """Raise an InputError about the first wrong element (image, keypoint, point) of a track."""
    refuse_row(
        ~are_right,
        lambda bad: (
            "point {2}: expected keypoints that refer to it in its track, found keypoint {1} of "
            "image {0}".format(*elements[bad])
        ),
    )


def positions_of(points: list[pycolmap.Point3D]) -> NDArray[np.float64]:
    """Return the (n, 3) positions of points."""
    return np.frombuffer(b"".join(map(attrgetter("xyz"), points))).reshape(-1, 3)


def lengths_of_tracks(points: list[pycolmap.Point3D]) -> NDArray[np.int64]:
    """Return the number of elements of each point's track."""
    tracks = map(attrgetter("track"), points)
    return np.fromiter(map(pycolmap.Track.length, tracks), np.int64, len(points))


def check_lengths(
    point_ids: NDArray[np.int64],
    length: NDArray[np.int64],
    observed: NDArray[np.int64],
    are_wrong: NDArray[np.bool_],
) -> None:
    """Raise an InputError about the first point with a wrong length of its track."""
    refuse_row(
        are_wrong,
        lambda bad: (
            f"point {point_ids[bad]}: expected one track element for each keypoint that refers to "
            f"it, found {length[bad]} elements and {observed[bad]} keypoints"
        ),
    )


def is_valid(reconstruction: pycolmap.Reconstruction) -> bool:
    """Run pycolmap's check, which is fast, without its log messages."""
    level = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = 3  # fatal errors only
    try:
        return bool(reconstruction.is_valid())
    finally:
        pycolmap.logging.minloglevel = level


# Rigs of a ``pycolmap.Reconstruction`` as the arrays of a problem.
#
# COLMAP puts every image into a frame of a rig. A problem ignores rigs whose only camera is their
# reference sensor, with or without IMUs: their images have their own poses. A problem contains
# every other rig that took one of its images. Of such a rig it contains the frames with an image,
# and all cameras with a known sensor_from_rig, even without images. All other records stay in the
# source.


@dataclass(frozen=True)
class RigFields:
    """Fields of a problem for the rigs of a reconstruction."""

    fields: dict[str, Any]  # fields of the problem by name
    framed: list[bool]  # for each image, True if it is in a frame of a rig with several cameras


def rigs_of(reconstruction: pycolmap.Reconstruction, images: list[pycolmap.Image]) -> RigFields:
    """Return the fields for the rigs of these images."""
    frame_of = [reconstruction.frame(image.frame_id) for image in images]
    _check_frames(frame_of, {image.image_id for image in images})
    rigs = {rig_id: reconstruction.rig(rig_id) for rig_id in {frame.rig_id for frame in frame_of}}
    trivial = {rig_id: is_trivial(rig) for rig_id, rig in rigs.items()}
    framed = [not trivial[frame.rig_id] for frame in frame_of]
    frames = {f.frame_id: f for f, inside in zip(frame_of, framed, strict=True) if inside}
    frame_row = {frame_id: row for row, frame_id in enumerate(sorted(frames))}
    used = sorted({frame.rig_id for frame in frames.values()})
    sensors = [
        (rig_id, sensor)
        for rig_id in used
        for sensor in sorted(cameras_of(rigs[rig_id]), key=lambda sensor: int(sensor.id))
        if not rigs[rig_id].is_ref_sensor(sensor) and rigs[rig_id].has_sensor_from_rig(sensor)
    ]
    sensor_row = {(rig_id, sensor.id): row for row, (rig_id, sensor) in enumerate(sensors)}

    def row_of(image: pycolmap.Image, frame: pycolmap.Frame) -> int:
        rig, sensor = rigs[frame.rig_id], image.data_id.sensor_id
        if rig.is_ref_sensor(sensor):
            return -1
        row = sensor_row.get((frame.rig_id, sensor.id))
        if row is None:
            raise InputError(
                f"rig {frame.rig_id}: expected the pose of camera {sensor.id} on the rig, because "
                f"it took image {image.image_id} of frame {frame.frame_id}"
            )
        return row

    ordered = [frames[frame_id] for frame_id in sorted(frames)]
    image_frame = [
        frame_row[frame.frame_id] if inside else -1
        for frame, inside in zip(frame_of, framed, strict=True)
    ]
    image_sensor = [
        row_of(image, frame) if inside else -1
        for image, frame, inside in zip(images, frame_of, framed, strict=True)
    ]
    fields = {
        "rig_from_world": _rows([frame.rig_from_world for frame in ordered]),
        "frame_ids": np.array([frame.frame_id for frame in ordered], np.int64),
        "frame_rig_ids": np.array([frame.rig_id for frame in ordered], np.int64),
        "image_frame": np.array(image_frame if frames else [], np.int32),
        "image_sensor": np.array(image_sensor if frames else [], np.int32),
        "sensor_from_rig": _rows([rigs[rig].sensor_from_rig(sensor) for rig, sensor in sensors]),
        "sensor_rig_ids": np.array([rig_id for rig_id, _ in sensors], np.int64),
        "sensor_camera_ids": np.array([sensor.id for _, sensor in sensors], np.int64),
    }
    return RigFields(fields, framed)


def is_trivial(rig: pycolmap.Rig) -> bool:
    """Return True if the only camera of a rig is its reference sensor."""
    return all(rig.is_ref_sensor(sensor) for sensor in cameras_of(rig))


def cameras_of(rig: pycolmap.Rig) -> list[pycolmap.sensor_t]:
    """Return the sensors of a rig that are cameras."""
    return [sensor for sensor in rig.sensor_ids() if sensor.type == pycolmap.SensorType.CAMERA]


def _rows(poses: list[pycolmap.Rigid3d | None]) -> NDArray[np.float64]:
    """Return poses as rows of qx qy qz qw tx ty tz."""
    found = [pose for pose in poses if pose is not None]
    rows = np.empty((len(found), 7))
    rows[:, :4] = np.reshape([pose.rotation.quat for pose in found], (-1, 4))
    rows[:, 4:] = np.reshape([pose.translation for pose in found], (-1, 3))
    return rows


def _check_frames(frames: list[pycolmap.Frame], image_ids: set[int]) -> None:
    by_id = {frame.frame_id: frame for frame in frames}
    if len(by_id) == len(frames):
        return
    for frame_id, frame in sorted(by_id.items()):
        cameras = [datum.sensor_id.id for datum in frame.image_ids if datum.id in image_ids]
        for camera in cameras:
            if cameras.count(camera) > 1:
                raise InputError(
                    f"frame {frame_id}: expected at most one image of camera {camera}, "
                    f"found {cameras.count(camera)}"
                )


# Conversion of a problem to a ``pycolmap.Reconstruction``.
#
# The problem's COLMAP files are written and then read by pycolmap. Source information that files
# lose is added afterwards, if the problem still has the records: images and frames without a pose,
# and the flags of prior focal lengths.


def to_pycolmap(problem: ProblemArrays) -> pycolmap.Reconstruction:
    """Return a reconstruction: a copy of the source with every edit of the problem applied.

    The errors of the points are recomputed. A problem that does not come from COLMAP gives a new
    reconstruction with the same ids and rigs. Each image without a rig gets a trivial rig and
    frame. Keypoints are in the order of the problem. Images without a name get names such as
    image_000007.
    """
    source = vars(problem)["source"]
    records = model_records(problem, source)
    with written({}) as folder:
        _core.write_colmap_records(folder, True, records)
        files = {path.name: path.read_bytes() for path in Path(folder).iterdir()}
    reconstruction: pycolmap.Reconstruction = unpacked(_pack(files, records, source))
    reconstruction.update_point_3d_errors()
    for point_id in records.point_ids[records.track_lengths == 0].tolist():
        reconstruction.point3D(point_id).error = -1.0  # COLMAP's value for "unknown"
    return reconstruction


def _pack(files: dict[str, bytes], records: ModelRecords, source: Any) -> Packed:
    """Return the files of a model, with the source information that files lose."""
    if not is_reconstruction(source):
        return Packed(files, [], [], [])
    before = packed(source)
    cameras = set(records.camera_ids.tolist())
    frames = set(records.frames_without_pose)
    return Packed(
        files,
        [frame for frame in before.frames if frame.frame_id in frames],
        [image for image in before.images if image.frame_id in frames],
        [i for i in before.cameras_with_prior_focal_length if i in cameras],
    )
