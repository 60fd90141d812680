"""Conversion of a problem to the COLMAP model to be written: its source with every edit applied.

Cameras, registered images, points and observations of the model are exactly those of the problem.
The source adds records that a problem does not have: colours, rigs, ids of frames, keypoints
without a point. A problem without a source is treated as an edit of the empty model; its points are
black, COLMAP's "no colour".
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import rows_among
from bundle.base.records import dataclass
from bundle.model.colmap.rig_records import MAX_ID, check_ids, check_rigs, edited_rigs
from bundle.model.colmap.source_records import (
    Contents,
    Frame,
    KeypointNumbers,
    Sensor,
    SourceRecords,
    number_keypoints,
)
from bundle.model.problem_arrays import ProblemArrays
from bundle.model.pycolmap.problem_source import is_colmap, source_records
from bundle.model.rigid_motions import multiply_as_colmap

MAX_POINT_ID = 2**63 - 1  # the largest point id: ids are stored as signed numbers here

NO_POINT = np.uint64(2**64 - 1)  # point id of a keypoint without a point


@dataclass(frozen=True, kw_only=True)
class ModelRecords:
    """A COLMAP model to be written, in the order of COLMAP's files.

    Records are ordered by id, images by frame.
    """

    # (num_cameras,) ids; models, sizes and parameters are as in a problem
    camera_ids: NDArray[np.int64]
    camera_models: tuple[str, ...]
    camera_sizes: NDArray[np.int64]
    camera_params: NDArray[np.float64]
    rigs: list[tuple[int, list[Sensor]]]  # id and sensors of each rig
    frames: list[tuple[int, *tuple[object, ...]]]  # id, rig, rig_from_world and data of each frame
    image_ids: NDArray[np.int64]  # (num_images,) ids of the images
    image_names: tuple[str, ...]
    image_camera_ids: NDArray[np.int64]  # (num_images,) camera id of each image
    # (num_images, 7) poses, computed from frames and rigs as COLMAP does
    cam_from_world: NDArray[np.float64]
    num_keypoints: NDArray[np.int64]  # (num_images,) number of keypoints of each image
    keypoint_xy: NDArray[np.float64]  # (num_keypoints, 2) coordinates, image by image
    # (num_keypoints,) point id of each keypoint; 2^64-1 without a point
    keypoint_points: NDArray[np.uint64]
    point_ids: NDArray[np.int64]  # (num_points,) ids of the points
    points: NDArray[np.float64]  # (num_points, 3) world coordinates
    point_colors: NDArray[np.uint8]  # (num_points, 3) red, green, blue
    track_lengths: NDArray[np.int64]  # (num_points,) number of observations of each point
    track_images: NDArray[np.int64]  # (num_observations,) position in ``image_ids``, point by point
    track_keypoints: NDArray[np.int64]  # (num_observations,) index among the keypoints of the image
    num_renumbered: int  # number of observations with another keypoint index than in the problem
    num_new_points: int  # number of points that the source does not have; 0 without a source
    num_without_pose: int  # number of source images without a pose, which files cannot hold
    frames_without_pose: dict[int, Frame]  # frames without a pose by id, which files cannot hold


def check(problem: ProblemArrays, source: Any) -> None:
    """Raise the error that :func:`model_records` would raise."""
    _checked(problem, source)


def _checked(problem: ProblemArrays, source: Any) -> tuple[SourceRecords | None, KeypointNumbers]:
    """Check that COLMAP can hold a problem; return its source and its keypoint numbers."""
    for kind, ids, largest in (
        ("camera", problem.camera_ids, MAX_ID),
        ("image", problem.image_ids, MAX_ID),
        ("point", problem.point_ids, MAX_POINT_ID),
    ):
        check_ids(f"{kind}_ids", f"{kind} ids", ids, largest)
    problem.check_padding()
    records = source_records(source)
    known = records or SourceRecords()
    check_rigs(problem, known)
    rows = rows_among(problem.image_ids, known.image_ids)
    num_keypoints = np.where(rows >= 0, np.append(known.num_keypoints, 0)[rows], -1)
    return records, number_keypoints(problem, num_keypoints)


def model_records(problem: ProblemArrays, source: Any) -> ModelRecords:
    """Return the COLMAP model to be written for a problem.

    ``source``: source in the form kept by the problem. If it is not a COLMAP model, images without
    a name get names such as image_000007.
    """
    records, numbers = _checked(problem, source)
    known = records or SourceRecords()
    contents = known.contents()
    rigs, frames = edited_rigs(problem, known)
    by_camera, by_point = (np.argsort(ids) for ids in (problem.camera_ids, problem.point_ids))
    posed = {frame_id: frame for frame_id, frame in frames.items() if frame.pose is not None}
    ids = [image_id for frame in posed.values() for image_id in frame.image_ids]
    by_image = rows_among(np.array(ids, np.int64), problem.image_ids)
    rank = np.empty_like(by_image)
    rank[by_image] = np.arange(problem.num_images)
    num_keypoints = numbers.num_keypoints[by_image]
    first = np.cumsum(num_keypoints) - num_keypoints
    image = rank[problem.observation_image]
    place = first[image] + numbers.keypoint
    image_ids = problem.image_ids[by_image]
    xy = _keypoints(known, contents, image_ids, first, int(num_keypoints.sum()))
    xy[place] = problem.observation_xy
    keypoint_points = np.full(len(xy), NO_POINT)
    keypoint_points[place] = problem.point_ids[problem.observation_point]
    tracks = _tracks(problem, known, contents, numbers.keypoint, by_point)
    point_ids = problem.point_ids[by_point]
    rows = rows_among(point_ids, contents.point_ids)
    colors = np.vstack([contents.point_colors, np.zeros((1, 3), np.uint8)])[rows]
    names = _names(problem, is_named=is_colmap(source))
    return ModelRecords(
        camera_ids=problem.camera_ids[by_camera],
        camera_models=tuple(problem.camera_models[camera] for camera in by_camera),
        camera_sizes=problem.camera_sizes[by_camera],
        camera_params=problem.camera_params[by_camera],
        rigs=list(rigs.items()),
        frames=[
            (frame_id, frame.rig_id, frame.pose, frame.data)
            for frame_id, frame in sorted(posed.items())
        ],
        image_ids=image_ids,
        image_names=tuple(names[image] for image in by_image),
        image_camera_ids=problem.camera_ids[problem.image_camera[by_image]],
        cam_from_world=_poses(problem)[by_image],
        num_keypoints=num_keypoints,
        keypoint_xy=xy,
        keypoint_points=keypoint_points,
        point_ids=point_ids,
        points=problem.points[by_point],
        point_colors=colors,
        track_lengths=np.bincount(problem.observation_point, minlength=problem.num_points)[
            by_point
        ],
        track_images=image[tracks],
        track_keypoints=numbers.keypoint[tracks],
        num_renumbered=numbers.num_renumbered,
        num_new_points=0 if records is None else int((rows < 0).sum()),
        num_without_pose=_num_without_pose(problem, known),
        frames_without_pose={f: frame for f, frame in frames.items() if f not in posed},
    )


def _num_without_pose(problem: ProblemArrays, source: SourceRecords) -> int:
    """Count the source images that have a pose neither in the source nor in the problem."""
    ids = [i for frame in source.frames.values() if frame.pose is None for i in frame.image_ids]
    return len(set(ids) - set(problem.image_ids.tolist())) if ids else 0


def _poses(problem: ProblemArrays) -> NDArray[np.float64]:
    """Return (num_images, 7) cam_from_world; with a frame, poses are computed as in COLMAP."""
    if not problem.num_frames:
        return problem.cam_from_world
    poses = problem.cam_from_world.copy()
    images = np.flatnonzero(problem.image_frame >= 0)
    poses[images] = problem.rig_from_world[problem.image_frame[images]]
    on_arm = images[problem.image_sensor[images] >= 0]
    arms = problem.sensor_from_rig[problem.image_sensor[on_arm]]
    poses[on_arm] = multiply_as_colmap(arms, poses[on_arm])
    return poses


def _keypoints(
    source: SourceRecords,
    contents: Contents,
    image_ids: NDArray[np.int64],
    first: NDArray[np.int64],
    total: int,
) -> NDArray[np.float64]:
    """Return (total, 2) keypoint coordinates of the model; only keypoints of the source are set.

    The coordinates of new keypoints are zero.

    Args:
        image_ids: (num_images,) image ids of the model.
        first: (num_images,) row of the first keypoint of each image.
        total: number of keypoints of the model.
    """
    rows = rows_among(source.image_ids, image_ids)
    kept = np.repeat(rows >= 0, source.num_keypoints)
    begins = np.cumsum(source.num_keypoints) - source.num_keypoints
    shift = np.repeat(np.append(first, 0)[rows] - begins, source.num_keypoints)
    xy = np.zeros((total, 2))
    xy[(np.arange(len(shift)) + shift)[kept]] = contents.keypoint_xy[kept]
    return xy


def _tracks(
    problem: ProblemArrays,
    source: SourceRecords,
    contents: Contents,
    keypoint: NDArray[np.int64],
    by_point: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Return the observations sorted by point, then in the order of the point's track.

    A track keeps the order of the source. New observations follow in the order of the problem.
    """
    num_elements = len(contents.track_keypoints)
    # Number of each track element by its keypoint; keypoints of all images are concatenated.
    begins = np.cumsum(source.num_keypoints) - source.num_keypoints
    element = np.full(len(contents.keypoint_xy) + 1, -1)
    image_rows = rows_among(contents.track_image_ids, source.image_ids)
    element[begins[image_rows] + contents.track_keypoints] = np.arange(num_elements)
    point_of_element = np.append(np.repeat(contents.point_ids, contents.track_lengths), -1)

    rows = rows_among(problem.image_ids, source.image_ids)[problem.observation_image]
    inside = (rows >= 0) & (keypoint < np.append(source.num_keypoints, 0)[rows])
    place = np.where(inside, np.append(begins, 0)[rows] + keypoint, -1)
    found = element[place]
    stays = (found >= 0) & (point_of_element[found] == problem.point_ids[problem.observation_point])
    place_in_track = np.where(stays, found, num_elements + np.arange(problem.num_observations))
    point_rank = np.empty_like(by_point)
    point_rank[by_point] = np.arange(problem.num_points)
    return np.lexsort((place_in_track, point_rank[problem.observation_point]))


def _names(problem: ProblemArrays, *, is_named: bool) -> list[str]:
    """Return the names of the images; if ``is_named``, empty names are replaced."""
    names = list(problem.image_names)
    if is_named:
        return names
    taken = set(names)
    for index, image_id in enumerate(problem.image_ids.tolist()):
        if names[index]:
            continue
        name = f"image_{image_id:06d}"
        while name in taken:
            name += "_"
        taken.add(name)
        names[index] = name
    return names
