"""Motion of points with the images that observe them, after each image got a similarity.

A point moves to the mean of the positions to which its observing images carry it. Only images whose
observation fits the model count. If no observation fits, the one with the smallest error counts.
Points without observations, and points of images that do not move, stay in place.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.graphs.loops.similarity_graph import Nodes
from bundle.model.problem import Problem
from bundle.model.reprojection import reprojection_errors
from bundle.model.rig_arrays import placed
from bundle.model.rigid_motions import inverse_poses, unit_poses
from bundle.model.rotations import quaternion_rotate
from bundle.model.shutter_changes import scaled

Array = NDArray[np.float64]


def carry(
    problem: Problem,
    node_of: NDArray[np.int64],
    mounts: Array,
    nodes: tuple[Nodes, Nodes],
    fitting: NDArray[np.bool_],
) -> tuple[Problem, int]:
    """Return the problem with images and points moved by their nodes.

    Args:
        problem: problem to move; not modified.
        node_of: (num_images,) node of each image.
        mounts: (num_images, 7) node_from_camera.
        nodes: nodes before and after.
        fitting: (num_observations,) mask of observations that fit the model.

    Returns:
        Moved problem, and the number of moved points.
    """
    before, after = nodes
    cameras = after.of(node_of, mounts)
    node_moved = (after.poses != before.poses).any(axis=1) | (after.scales != before.scales)
    moved = node_moved[node_of]
    poses = np.where(moved[:, None], inverse_poses(cameras.poses), problem.cam_from_world)
    changes: dict[str, Any] = {"cam_from_world": poses}
    if problem.num_frames:
        changes |= _frames(problem, node_of, node_moved, after, poses)
    points, is_carried = _points(problem, cameras, moved, fitting)
    shutter = scaled(problem.rolling_shutter, (after.scales / before.scales)[node_of])
    moved_problem = problem.replace(points=points, rolling_shutter=shutter, **changes)
    return moved_problem, int(is_carried.sum())


def _frames(
    problem: Problem,
    node_of: NDArray[np.int64],
    node_moved: NDArray[np.bool_],
    after: Nodes,
    poses: Array,
) -> dict[str, Any]:
    images = np.flatnonzero(problem.image_frame >= 0)
    found, first = np.unique(problem.image_frame[images], return_index=True)
    of_frame = node_of[images[first]]
    frames = problem.rig_from_world.copy()
    goes = node_moved[of_frame]
    frames[found[goes]] = inverse_poses(after.poses[of_frame[goes]])
    names = ("image_frame", "image_sensor", "sensor_from_rig")
    fields = {name: getattr(problem, name) for name in names}
    changes = {"rig_from_world": frames}
    return changes | {"cam_from_world": placed(fields | changes | {"cam_from_world": poses})}


def _points(
    problem: Problem, cameras: Nodes, moved: NDArray[np.bool_], fitting: NDArray[np.bool_]
) -> tuple[Array, NDArray[np.bool_]]:
    carriers = _carriers(problem, fitting)
    image, point = problem.observation_image[carriers], problem.observation_point[carriers]
    pose = unit_poses(problem.cam_from_world[image])
    local = quaternion_rotate(pose[:, :4], problem.points[point]) + pose[:, 4:]
    world = quaternion_rotate(cameras.poses[image, :4], local) * cameras.scales[image, None]
    world += cameras.poses[image, 4:]
    total = np.zeros_like(problem.points)
    np.add.at(total, point, world)
    count = np.bincount(point, minlength=problem.num_points)
    goes = np.zeros(problem.num_points, bool)
    goes[point[moved[image]]] = True
    points = problem.points.copy()
    points[goes] = total[goes] / count[goes, None]
    return points, goes


def _carriers(problem: Problem, fitting: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the observations whose images carry the points."""
    point = problem.observation_point
    has = np.zeros(problem.num_points, bool)
    has[point[fitting]] = True
    errors, _ = reprojection_errors(problem)
    order = np.lexsort((np.nan_to_num(errors, nan=np.inf), point))
    best = order[np.diff(point[order], prepend=-1) != 0]
    chosen = fitting.copy()
    chosen[best[~has[point[best]]]] = True
    return np.flatnonzero(chosen)
