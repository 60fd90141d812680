"""A problem as a ``pycolmap.Reconstruction``: a copy of its source with every edit in it.

The problem decides about all that it has: cameras, registered images, points and observations are
its own afterwards, no more and no fewer. The source adds what a problem does not have: colours,
rigs, ids of frames, keypoints without a point, images without a pose. A problem without a source is
an edit of the empty reconstruction; its points stay black, COLMAP's "no colour".

Of an image that the problem does not have any more, keypoints go as well, and its frame if it has
no other image; of a camera, its rig and the images without a pose that it took. The rig of a camera
whose images are gone, and points without observations, stay while the problem has the camera and
the points.
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pycolmap
from numpy.typing import NDArray

from bundle.errors import InputError
from bundle.model.problem import Problem
from bundle.model.pycolmap.frames import Rigs, remove_cameras, remove_images
from bundle.model.pycolmap.observation_edits import Baseline, ObservationEdits, find_edits
from bundle.model.pycolmap.problem_source import is_source
from bundle.model.pycolmap.reconstruction import baseline_of
from bundle.model.pycolmap.rig_edits import (
    check_rigs,
    fits,
    reframed,
    rigid3d,
    taken_apart,
    without_parts_of_frames,
    write_poses,
)
from bundle.model.rig_arrays import rig_of_image

__all__ = ["check", "to_pycolmap", "write_back"]

# COLMAP keeps the largest 32-bit number for "no image", and we hold point ids as signed numbers.
MAX_ID = 2**32 - 2
MAX_POINT_ID = 2**63 - 1


def to_pycolmap(problem: Problem) -> pycolmap.Reconstruction:
    """Return a reconstruction: a copy of the source with every edit of the problem in it.

    The errors of the points are computed anew. A problem that did not come from COLMAP gives a new
    reconstruction: the same ids, the rigs of the problem and else a trivial rig a camera and a
    trivial frame an image, keypoints in the order of the problem, and names such as image_000007
    for images that have none.

    Raises:
        InputError: an id that COLMAP cannot hold, or a keypoint index that does not exist or is
            there twice; the message names the field.
    """
    return write_back(problem)[0]


def check(problem: Problem) -> None:
    """Raise now the InputError that :func:`to_pycolmap` would raise."""
    _edits(problem)


def write_back(problem: Problem) -> tuple[pycolmap.Reconstruction, ObservationEdits]:
    """As :func:`to_pycolmap`; also return how the observations differ from the source's."""
    baseline, edits = _edits(problem)
    source = _source(problem)
    reconstruction = (
        pycolmap.Reconstruction() if source is None else pycolmap.Reconstruction(source)
    )
    has_same_rigs = fits(reconstruction, problem)
    if not has_same_rigs:
        reconstruction = taken_apart(reconstruction)
    _detach(reconstruction, problem, baseline, edits)
    gone = set(baseline.image_ids.tolist()) - _set(problem.image_ids)
    reconstruction, gone = without_parts_of_frames(reconstruction, gone)
    remove_images(reconstruction, gone)
    _write_cameras(reconstruction, problem)
    framed = has_same_rigs & (rig_of_image(problem) >= 0)
    _write_images(reconstruction, problem, edits, framed, has_source=source is not None)
    remove_cameras(reconstruction, set(reconstruction.cameras) - _set(problem.camera_ids))
    _write_keypoints(reconstruction, problem, edits)
    if has_same_rigs:
        write_poses(reconstruction, problem)
    else:
        reconstruction = reframed(reconstruction, problem)
    _write_points(reconstruction, problem, edits)
    return reconstruction, edits


def _source(problem: Problem) -> pycolmap.Reconstruction | None:
    return problem.source if isinstance(problem.source, pycolmap.Reconstruction) else None


def _set(ids: NDArray[np.int64]) -> set[int]:
    return set(ids.tolist())


def _edits(problem: Problem) -> tuple[Baseline, ObservationEdits]:
    for kind, ids, largest in (
        ("camera", problem.camera_ids, MAX_ID),
        ("image", problem.image_ids, MAX_ID),
        ("point", problem.point_ids, MAX_POINT_ID),
    ):
        outside = (ids < 0) | (ids > largest)
        if outside.any():
            raise InputError(
                f"{kind}_ids: expected {kind} ids from 0 to {largest}, found {ids[outside][0]}"
            )
    problem.check_padding()
    if not is_source(problem.source):
        raise InputError(
            "source: expected a pycolmap.Reconstruction, the source of a problem from a BAL file, "
            f"or None, found {type(problem.source).__name__}"
        )
    source = _source(problem)
    source = pycolmap.Reconstruction() if source is None else source
    check_rigs(problem, source)
    baseline = baseline_of(source)
    num_keypoints = np.array(
        [
            source.image(image_id).num_points2D() if source.exists_image(image_id) else -1
            for image_id in problem.image_ids.tolist()
        ],
        dtype=np.int64,
    )
    return baseline, find_edits(problem, baseline, num_keypoints)


def _detach(
    reconstruction: pycolmap.Reconstruction,
    problem: Problem,
    baseline: Baseline,
    edits: ObservationEdits,
) -> None:
    """Remove points, and observations of points that stay."""
    for point_id in sorted(_set(baseline.point_ids) - _set(problem.point_ids)):
        reconstruction.delete_point3D(point_id)
    gone: dict[int, set[tuple[int, int]]] = defaultdict(set)
    for image_id, keypoint, point_id in zip(
        baseline.image_ids[baseline.image[edits.detached]].tolist(),
        baseline.keypoint[edits.detached].tolist(),
        baseline.point_ids[baseline.point[edits.detached]].tolist(),
        strict=True,
    ):
        reconstruction.image(image_id).reset_point3D_for_point2D(keypoint)
        gone[point_id].add((image_id, keypoint))
    for point_id, elements in gone.items():
        point = reconstruction.point3D(point_id)
        point.track = pycolmap.Track(
            [e for e in point.track.elements if (e.image_id, e.point2D_idx) not in elements]
        )


def _write_cameras(reconstruction: pycolmap.Reconstruction, problem: Problem) -> None:
    for index, camera_id in enumerate(problem.camera_ids.tolist()):
        model = pycolmap.CameraModelId.__members__[problem.camera_models[index]]
        width, height = problem.camera_sizes[index].tolist()
        if reconstruction.exists_camera(camera_id):
            camera = reconstruction.camera(camera_id)
            camera.model, camera.width, camera.height = model, width, height
        else:
            camera = pycolmap.Camera.create_from_model_id(camera_id, model, 1.0, width, height)
        num_params = len(pycolmap.Camera.create_from_model_id(0, model, 1.0, 1, 1).params)
        camera.params = problem.camera_params[index, :num_params].tolist()
        if not reconstruction.exists_camera(camera_id):
            reconstruction.add_camera(camera)


def _write_images(
    reconstruction: pycolmap.Reconstruction,
    problem: Problem,
    edits: ObservationEdits,
    framed: NDArray[np.bool_],
    *,
    has_source: bool,
) -> None:
    rigs = Rigs(reconstruction)
    ids = problem.image_ids.tolist()
    is_new = np.array([not reconstruction.exists_image(image_id) for image_id in ids], bool)
    keypoints = _keypoints(problem, edits, is_new)
    taken_names = set(problem.image_names)
    for index, image_id in enumerate(ids):
        camera_id = int(problem.camera_ids[problem.image_camera[index]])
        name = problem.image_names[index]
        pose = rigid3d(problem.cam_from_world[index])
        if is_new[index]:
            if not name and not has_source:
                name = _free_name(image_id, taken_names)
            image = pycolmap.Image(name, keypoints[index], camera_id, image_id)
            rigs.add(image, rigs.free_frame_id(image_id), pose)
            continue
        image = reconstruction.image(image_id)
        image.name = name
        if framed[index]:
            continue
        if image.camera_id != camera_id:
            rigs.move(image, camera_id, pose)
            continue
        frame = reconstruction.frame(image.frame_id)
        is_registered = frame.has_pose()
        frame.rig_from_world = pose
        if not is_registered:
            reconstruction.register_frame(image.frame_id)


def _keypoints(
    problem: Problem, edits: ObservationEdits, is_new: NDArray[np.bool_]
) -> list[NDArray[np.float64]]:
    """Return the keypoints of each new image, which are its observations; none of the others."""
    observations = np.flatnonzero(is_new[problem.observation_image])
    image = problem.observation_image[observations]
    order = observations[np.lexsort((edits.keypoint[observations], image))]
    ends = np.cumsum(np.bincount(image, minlength=problem.num_images))
    return np.split(problem.observation_xy[order], ends)


def _free_name(image_id: int, taken: set[str]) -> str:
    name = f"image_{image_id:06d}"
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def _write_keypoints(
    reconstruction: pycolmap.Reconstruction, problem: Problem, edits: ObservationEdits
) -> None:
    """Move keypoints, and append new ones to images of the source."""
    image_ids = problem.image_ids[problem.observation_image]
    for observation in edits.moved.tolist():
        image = reconstruction.image(int(image_ids[observation]))
        image.point2D(int(edits.keypoint[observation])).xy = problem.observation_xy[observation]
    for observation in edits.appended.tolist():
        image = reconstruction.image(int(image_ids[observation]))
        image.points2D.append(pycolmap.Point2D(problem.observation_xy[observation]))


def _write_points(
    reconstruction: pycolmap.Reconstruction, problem: Problem, edits: ObservationEdits
) -> None:
    """Write coordinates, lengthen tracks, add points that are new, compute errors."""
    points = reconstruction.points3D
    additions = _additions(problem, edits)
    for point_id, xyz in zip(problem.point_ids.tolist(), problem.points, strict=True):
        elements = additions.get(point_id, [])
        if point_id not in points:
            point = pycolmap.Point3D(xyz=xyz, track=pycolmap.Track(elements))
            reconstruction.add_point3D_with_id(point_id, point)
            continue
        point = points[point_id]
        point.xyz = xyz
        if elements:
            point.track = pycolmap.Track([*point.track.elements, *elements])
            for element in elements:
                image = reconstruction.image(element.image_id)
                image.set_point3D_for_point2D(element.point2D_idx, point_id)
    reconstruction.update_point_3d_errors()
    observed = np.bincount(problem.observation_point, minlength=problem.num_points)
    for point_id in problem.point_ids[observed == 0].tolist():
        points[point_id].error = -1.0  # COLMAP's "not known"


def _additions(problem: Problem, edits: ObservationEdits) -> dict[int, list[pycolmap.TrackElement]]:
    """Return by point id the elements that its track gets, in the order of the problem."""
    additions: dict[int, list[pycolmap.TrackElement]] = defaultdict(list)
    attached = edits.attached
    for point_id, image_id, keypoint in zip(
        problem.point_ids[problem.observation_point[attached]].tolist(),
        problem.image_ids[problem.observation_image[attached]].tolist(),
        edits.keypoint[attached].tolist(),
        strict=True,
    ):
        additions[point_id].append(pycolmap.TrackElement(image_id, keypoint))
    return additions
