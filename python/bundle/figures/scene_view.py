"""Points and cameras of the 3-D view of a reconstruction, in a normalised frame.

The origin of the frame is the median of the points. Its unit is half the width of the box around
the middle 90 % of points and cameras. Anything farther away than 50 units is not drawn, because
points near infinity would shrink the rest of the scene to a dot. If there are more than 60,000
points, every k-th is drawn, with the smallest k that leaves at most 60,000.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.figures.placement_figures import focal_lengths
from bundle.model.problem import Problem
from bundle.model.residuals import Residuals
from bundle.model.rigid_motions import rotation_matrices

MOST_POINTS = 60_000
FARTHEST = 50.0
USUAL = 0.5  # tangent of half the field of view for cameras whose own is unknown


@dataclass(frozen=True, eq=False, kw_only=True)
class SceneView:
    """Points and cameras in the frame of the view.

    Attributes:
        origin: (3,) origin of the view's frame, in the world.
        unit: unit of the frame, in the world's length unit.
        points: (n, 3) drawn points, in the frame of the view.
        point_indices: (n,) indices of these points in the problem.
        point_errors: (n,) root mean square of their residuals [pixels]; NaN without residuals.
        step: k if every k-th point is drawn.
        num_far: points and cameras that are too far away to be drawn.
        centers: (m, 3) centres of the drawn cameras, in the frame of the view.
        image_indices: (m,) indices of these images in the problem.
        image_ids: (m,) their ids.
        axes: (m, 3, 3) right, down and forward of each camera, one row each.
        half_fields: (m, 2) tangents of half the field of view, horizontal and vertical.
        middle: (3,) centre between points and cameras, in the frame of the view.
        reach: distance from the centre within which most points and cameras are.
        up: (3,) up direction of the scene, a unit vector.
        forward: (3,) mean viewing direction of the cameras, perpendicular to ``up``; a unit vector.
    """

    origin: NDArray[np.float64]
    unit: float
    points: NDArray[np.float64]
    point_indices: NDArray[np.int64]
    point_errors: NDArray[np.float64]
    step: int
    num_far: int
    centers: NDArray[np.float64]
    image_indices: NDArray[np.int64]
    image_ids: NDArray[np.int64]
    axes: NDArray[np.float64]
    half_fields: NDArray[np.float64]
    middle: NDArray[np.float64]
    reach: float
    up: NDArray[np.float64]
    forward: NDArray[np.float64]


def scene_view(problem: Problem, found: Residuals | None, *, z_is_up: bool = False) -> SceneView:
    """Return the points and cameras to draw.

    Args:
        problem: problem with the points and cameras.
        found: residuals of the problem, for the errors of the points; None: no errors.
        z_is_up: True if the world's z axis is up, as in georeferenced models; otherwise up is the
            top of the images.
    """
    centers = problem.projection_centers
    everything = np.concatenate([problem.points, centers])
    origin, unit = np.zeros(3), 1.0
    if len(everything):
        origin = np.median(problem.points if problem.num_points else centers, axis=0)
        low, high = np.quantile(everything, [0.05, 0.95], axis=0)
        unit = float((high - low).max()) / 2
        unit = unit if np.isfinite(unit) and unit > 0 else 1.0
    step = max(-(-problem.num_points // MOST_POINTS), 1)
    chosen = np.arange(0, problem.num_points, step)
    points, near = _placed(problem.points[chosen], origin, unit)
    placed, close = _placed(centers, origin, unit)
    images = np.flatnonzero(close)
    axes = rotation_matrices(problem.cam_from_world[images, :4])
    middle, reach = _extent([points[near], placed[images]])
    up, forward = _directions(axes, z_is_up=z_is_up)
    return SceneView(
        origin=origin,
        unit=unit,
        points=points[near],
        point_indices=chosen[near],
        point_errors=_errors(problem, found)[chosen[near]],
        step=step,
        num_far=int((~near).sum() + (~close).sum()),
        centers=placed[images],
        image_indices=images,
        image_ids=problem.image_ids[images],
        axes=axes,
        half_fields=_half_fields(problem)[problem.image_camera[images]],
        middle=middle,
        reach=reach,
        up=up,
        forward=forward,
    )


def scene_before(
    view: SceneView, problem: Problem, initial: Problem, found: Residuals | None
) -> SceneView:
    """Return a view of an earlier state of a problem, with the same points and cameras.

    Points and images are matched by id; those that the earlier state lacks stay where they are.
    """
    there, point = _matches(problem.point_ids[view.point_indices], initial.point_ids)
    points, errors = view.points.copy(), np.full(len(view.points), np.nan)
    points[there] = (initial.points[point] - view.origin) / view.unit
    errors[there] = _errors(initial, found)[point]
    here, image = _matches(problem.image_ids[view.image_indices], initial.image_ids)
    centers, axes = view.centers.copy(), view.axes.copy()
    centers[here] = (initial.projection_centers[image] - view.origin) / view.unit
    axes[here] = rotation_matrices(initial.cam_from_world[image, :4])
    return replace(view, points=points, point_errors=errors, centers=centers, axes=axes)


def _matches(
    wanted: NDArray[np.int64], ids: NDArray[np.int64]
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    order = np.argsort(ids, kind="stable")
    place = np.minimum(np.searchsorted(ids, wanted, sorter=order), max(len(ids) - 1, 0))
    found = order[place] if len(ids) else np.zeros(len(wanted), np.int64)
    there = ids[found] == wanted if len(ids) else np.zeros(len(wanted), bool)
    return there, found[there]


def _placed(
    positions: NDArray[np.float64], origin: NDArray[np.float64], unit: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    placed = (positions - origin) / unit
    return placed, np.linalg.norm(placed, axis=1) <= FARTHEST


def _extent(sets: list[NDArray[np.float64]]) -> tuple[NDArray[np.float64], float]:
    """Return the centre of several sets of positions, and a radius that covers most of each."""
    filled = [positions for positions in sets if len(positions)]
    if not filled:
        return np.zeros(3), 1.0
    middle = np.mean([np.median(positions, axis=0) for positions in filled], axis=0)
    distances = [np.linalg.norm(positions - middle, axis=1) for positions in filled]
    return middle, max(max(float(np.quantile(d, 0.9)) for d in distances), 1e-3)


def _errors(problem: Problem, found: Residuals | None) -> NDArray[np.float64]:
    if found is None:
        return np.full(problem.num_points, np.nan)
    point = problem.observation_point[found.counted]
    count = np.bincount(point, minlength=problem.num_points)
    squares = np.bincount(point, found.lengths[found.counted] ** 2, problem.num_points)
    return np.sqrt(squares / np.where(count, count, np.nan))


def _half_fields(problem: Problem) -> NDArray[np.float64]:
    """Return half the field of view of each camera, as for a pinhole camera."""
    fields = np.full((problem.num_cameras, 2), USUAL)
    focal, sizes = focal_lengths(problem), problem.camera_sizes
    known = np.isfinite(focal) & (sizes > 0).all(axis=1)
    fields[known] = np.minimum(sizes[known] / (2 * focal[known, None]), 1.0)
    return fields


def _directions(
    axes: NDArray[np.float64], *, z_is_up: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    mean = axes.mean(axis=0) if len(axes) else np.eye(3)
    up = np.array([0.0, 0.0, 1.0]) if z_is_up else -mean[1]
    if np.linalg.norm(up) < 0.3:  # cameras in all orientations, as in aerial images
        up = -mean[2]
    if np.linalg.norm(up) < 0.3:
        up = np.array([0.0, 0.0, 1.0])
    up /= np.linalg.norm(up)
    forward = mean[2] - up * (mean[2] @ up)
    if np.linalg.norm(forward) < 0.1:
        forward = np.eye(3)[np.argmin(np.abs(up))]
        forward -= up * (forward @ up)
    return up, forward / np.linalg.norm(forward)
