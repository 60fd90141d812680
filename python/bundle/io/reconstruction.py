"""Between :class:`bundle.Problem` and ``pycolmap.Reconstruction``, in memory.

A rig of one camera has ``rig_from_world = cam_from_world``, so a pose is read from the image and
written to its frame. Setting a pose, parameters or a point in pycolmap keeps every bit; what a
problem did not change comes out as it went in.
"""

from __future__ import annotations

from dataclasses import dataclass
from operator import attrgetter

import numpy as np
import pycolmap
from numpy.typing import NDArray

from bundle.arguments import check_type
from bundle.errors import InputError
from bundle.problem import Problem

__all__ = ["Observations", "from_pycolmap", "problem_of", "to_pycolmap"]

# COLMAP keeps the largest 32-bit number for "no image", and we hold point ids as signed numbers.
MAX_ID = 2**32 - 2
MAX_POINT_ID = 2**63 - 1


def from_pycolmap(reconstruction: pycolmap.Reconstruction) -> Problem:
    """Take over the registered images of a reconstruction, which is copied and kept as source.

    Raises:
        InputError: a rig has several sensors or a frame several images; keypoints and tracks do not
            match; a value that :class:`bundle.Problem` refuses.
    """
    check_type("reconstruction", reconstruction, pycolmap.Reconstruction)
    return problem_of(pycolmap.Reconstruction(reconstruction))


def problem_of(
    reconstruction: pycolmap.Reconstruction, observations: Observations | None = None
) -> Problem:
    """As :func:`from_pycolmap`, without the copy: the caller gives the reconstruction away.

    Who knows the observations already, and has checked them, saves most of the time.
    """
    _check_rigs(reconstruction)
    cameras = [camera for _, camera in sorted(reconstruction.cameras.items())]
    images = [reconstruction.image(image_id) for image_id in sorted(reconstruction.reg_image_ids())]
    points = sorted(reconstruction.points3D.items())
    camera_index = {camera.camera_id: index for index, camera in enumerate(cameras)}
    point_ids = _ids_of_points([point_id for point_id, _ in points])
    if observations is None:
        observations = _observations(images, point_ids)
        _check_tracks(points, observations)
    return Problem(
        cam_from_world=np.array([_pose(image) for image in images]).reshape(-1, 7),
        image_ids=np.array([image.image_id for image in images], np.int64),
        image_names=tuple(_name(image) for image in images),
        image_camera=np.array([camera_index[image.camera_id] for image in images], np.int32),
        camera_ids=np.array([camera.camera_id for camera in cameras], np.int64),
        camera_models=tuple(camera.model.name for camera in cameras),
        camera_params=_padded([camera.params for camera in cameras]),
        camera_sizes=np.array([_size(camera) for camera in cameras], np.int64).reshape(-1, 2),
        points=np.array([point.xyz for _, point in points]).reshape(-1, 3),
        point_ids=point_ids,
        observation_image=observations.image,
        observation_point=observations.point,
        observation_xy=observations.xy,
        observation_keypoint=observations.keypoint,
        format="colmap",
        source=reconstruction,
    )


def _check_rigs(reconstruction: pycolmap.Reconstruction) -> None:
    for rig_id, rig in sorted(reconstruction.rigs.items()):
        if rig.num_sensors() > 1:
            raise InputError(
                f"rig {rig_id} has {rig.num_sensors()} sensors (reference: {_sensor(rig)}): "
                "only single-sensor rigs are supported"
            )
    for frame_id, frame in sorted(reconstruction.frames.items()):
        num_images = len(list(frame.image_ids))
        if num_images > 1:
            raise InputError(f"frame {frame_id}: expected at most one image, found {num_images}")


def _sensor(rig: pycolmap.Rig) -> str:
    sensor = rig.ref_sensor_id
    return f"{sensor.type.name.lower()} {sensor.id}"


def _ids_of_points(ids: list[int]) -> NDArray[np.int64]:
    if ids and ids[-1] > MAX_POINT_ID:
        raise InputError(f"expected point ids below 2^63, found {ids[-1]}")
    return np.array(ids, np.int64)


def _pose(image: pycolmap.Image) -> NDArray[np.float64]:
    cam_from_world = image.cam_from_world()
    return np.concatenate((cam_from_world.rotation.quat, cam_from_world.translation))


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


def _padded(rows: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Stack rows of different lengths, filled up with zeros."""
    padded = np.zeros((len(rows), max(map(len, rows), default=0)))
    for target, row in zip(padded, rows, strict=True):
        target[: len(row)] = row
    return padded


@dataclass(frozen=True)
class Observations:
    """Images and points by position in the order of their ids; sorted by point, image, keypoint."""

    image: NDArray[np.int32]
    point: NDArray[np.int32]
    keypoint: NDArray[np.int32]
    xy: NDArray[np.float64]


def _observations(images: list[pycolmap.Image], point_ids: NDArray[np.int64]) -> Observations:
    counts = np.array([image.num_points3D for image in images], np.int64)
    total = int(counts.sum())
    keypoint = np.empty(total, np.int32)
    point_id = np.empty(total, np.uint64)
    xy = np.empty((total, 2))
    end = 0
    for image, count in zip(images, counts, strict=True):
        start, end = end, end + count
        points2d = list(image.get_observation_points2D())
        keypoint[start:end] = image.get_observation_point2D_idxs()
        xy[start:end, 0] = np.fromiter(map(pycolmap.Point2D.x, points2d), np.float64, count)
        xy[start:end, 1] = np.fromiter(map(pycolmap.Point2D.y, points2d), np.float64, count)
        ids = map(attrgetter("point3D_id"), points2d)
        point_id[start:end] = np.fromiter(ids, np.uint64, count)

    image_index = np.repeat(np.arange(len(images), dtype=np.int32), counts)
    point = np.searchsorted(point_ids, point_id).astype(np.int32)
    found = np.append(point_ids.astype(np.uint64), MAX_POINT_ID + 1)[point] == point_id
    if not found.all():
        bad = int(np.argmin(found))
        raise InputError(
            f"image {images[image_index[bad]].image_id}, keypoint {keypoint[bad]}: "
            f"expected a point of the reconstruction, found point {point_id[bad]}"
        )
    order = np.argsort(point, kind="stable")  # images and keypoints ascend already
    return Observations(image_index[order], point[order], keypoint[order], xy[order])


def _check_tracks(points: list[tuple[int, pycolmap.Point3D]], observations: Observations) -> None:
    """Check that each point has as many track elements as registered images observe it.

    Otherwise pycolmap could not compute its error: an element without a posed image.
    """
    length = np.fromiter((point.track.length() for _, point in points), np.int64, len(points))
    observed = np.bincount(observations.point, minlength=len(points))
    if (length != observed).any():
        bad = int(np.argmax(length != observed))
        raise InputError(
            f"point {points[bad][0]}: expected as many track elements as keypoints of registered "
            f"images that refer to it, found {length[bad]} and {observed[bad]}"
        )


def to_pycolmap(problem: Problem) -> pycolmap.Reconstruction:
    """Return a reconstruction: a copy of the source with the numbers of this problem in it.

    Poses, camera parameters and points are those of the problem, the errors of the points are
    computed anew, all else (names, colours, tracks, rigs, keypoints without a point, images without
    a pose) is the source's. A problem that did not come from COLMAP gives a new reconstruction:
    the same ids, a trivial rig a camera and a trivial frame an image, and as keypoints of an image
    its observations in the order of the problem.

    Raises:
        InputError: the problem has a camera, image or point that its source has not, or an id that
            COLMAP cannot hold.
    """
    if isinstance(problem.source, pycolmap.Reconstruction):
        reconstruction = pycolmap.Reconstruction(problem.source)
        _replace_numbers(reconstruction, problem)
    else:
        reconstruction = _new_reconstruction(problem)
    reconstruction.update_point_3d_errors()
    return reconstruction


def _replace_numbers(reconstruction: pycolmap.Reconstruction, problem: Problem) -> None:
    camera_ids = problem.camera_ids.tolist()
    image_ids = problem.image_ids.tolist()
    point_ids = problem.point_ids.tolist()
    _check_known("camera", camera_ids, set(reconstruction.cameras))
    _check_known("image", image_ids, set(reconstruction.reg_image_ids()))
    _check_known("point", point_ids, reconstruction.point3D_ids())
    for camera_id, params in zip(camera_ids, problem.camera_params, strict=True):
        camera = reconstruction.camera(camera_id)
        camera.params = params[: len(camera.params)].tolist()
    for image_id, pose in zip(image_ids, problem.cam_from_world, strict=True):
        frame = reconstruction.frame(reconstruction.image(image_id).frame_id)
        frame.rig_from_world = _rigid3d(pose)
    points = reconstruction.points3D
    for point_id, xyz in zip(point_ids, problem.points, strict=True):
        points[point_id].xyz = xyz


def _check_known(kind: str, ids: list[int], known: set[int]) -> None:
    unknown = set(ids) - known
    if unknown:
        raise InputError(
            f"expected {kind}s of the source of the problem, found {kind} {min(unknown)}"
        )


def _rigid3d(pose: NDArray[np.float64]) -> pycolmap.Rigid3d:
    return pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:4]), pose[4:])


def _new_reconstruction(problem: Problem) -> pycolmap.Reconstruction:
    _check_range("camera", problem.camera_ids, MAX_ID)
    _check_range("image", problem.image_ids, MAX_ID)
    _check_range("point", problem.point_ids, MAX_POINT_ID)
    reconstruction = pycolmap.Reconstruction()
    _add_cameras(reconstruction, problem)
    keypoint = _add_images(reconstruction, problem)
    _add_points(reconstruction, problem, keypoint)
    return reconstruction


def _check_range(kind: str, ids: NDArray[np.int64], largest: int) -> None:
    outside = (ids < 0) | (ids > largest)
    if outside.any():
        raise InputError(f"expected {kind} ids from 0 to {largest}, found {ids[outside][0]}")


def _add_cameras(reconstruction: pycolmap.Reconstruction, problem: Problem) -> None:
    for index, camera_id in enumerate(problem.camera_ids.tolist()):
        width, height = problem.camera_sizes[index].tolist()
        model = pycolmap.CameraModelId.__members__.get(problem.camera_models[index])
        if model is None:
            raise InputError(
                f"camera {camera_id}: expected a camera model of COLMAP, "
                f"found {problem.camera_models[index]!r}"
            )
        camera = pycolmap.Camera.create_from_model_id(camera_id, model, 1.0, width, height)
        camera.params = problem.camera_params[index, : len(camera.params)].tolist()
        reconstruction.add_camera_with_trivial_rig(camera)


def _add_images(reconstruction: pycolmap.Reconstruction, problem: Problem) -> NDArray[np.int64]:
    """Add the images with their observations as keypoints; return each observation's keypoint."""
    order = np.argsort(problem.observation_image, kind="stable")
    counts = np.bincount(problem.observation_image, minlength=problem.num_images)
    starts = np.cumsum(counts) - counts
    keypoint = np.empty(problem.num_observations, np.int64)
    keypoint[order] = np.arange(problem.num_observations) - np.repeat(starts, counts)
    for index, image_id in enumerate(problem.image_ids.tolist()):
        observations = order[starts[index] : starts[index] + counts[index]]
        image = pycolmap.Image(
            name=problem.image_names[index] or f"image_{image_id:06d}",
            keypoints=problem.observation_xy[observations],
            camera_id=int(problem.camera_ids[problem.image_camera[index]]),
            image_id=image_id,
        )
        pose = _rigid3d(problem.cam_from_world[index])
        reconstruction.add_image_with_trivial_frame(image, pose)
    return keypoint


def _add_points(
    reconstruction: pycolmap.Reconstruction, problem: Problem, keypoint: NDArray[np.int64]
) -> None:
    order = np.argsort(problem.observation_point, kind="stable")
    ends = np.cumsum(np.bincount(problem.observation_point, minlength=problem.num_points)).tolist()
    image_ids = problem.image_ids[problem.observation_image[order]].tolist()
    keypoints = keypoint[order].tolist()
    start = 0
    for point_id, xyz, end in zip(problem.point_ids.tolist(), problem.points, ends, strict=True):
        track = pycolmap.Track()
        for image_id, index in zip(image_ids[start:end], keypoints[start:end], strict=True):
            track.add_element(image_id, index)
        reconstruction.add_point3D_with_id(point_id, pycolmap.Point3D(xyz=xyz, track=track))
        start = end
