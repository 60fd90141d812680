"""Joint covariance of some poses, parameters and points, and what more measurements change.

Covariance. The core gives that of linear functions of poses, parameters and points, such as each
unknown of interest (core/covariance/covariance.h).

Measurements. Let A be the whitened rows w.r.t. x of an additional measurement, whose own unknowns
are eliminated: with B their columns, rows U^T A, U an orthonormal basis of the null space of B^T.
With K = A C A^T, the covariance of the larger problem is C - C A^T (I + K)^-1 A C.

Gauge. If similarities N of the world are free, C is any g-inverse, and N has an infinite variance:
C + t N N^T, t to infinity. With M = (I + K)^-1, B = A N, and D = N - C A^T M B,

    C' = C - C A^T M A C + D (B^T M B)^+ D^T,    N' = N null(B).

A quantity with gradient g has N^T g = 0, variance v = g^T C g, and loses by the measurement

    q^T U (I + U^T K U)^-1 U^T q,    q = A C g,    U a basis of the null space of B^T.

Without U, a scale bar would seem to improve a ratio of lengths. As K >= q q^T / v for any rows, the
loss is at most s / (1 + s / v) with s = |U^T q|^2, which takes no K.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.analysis.uncertainty.quantity import Quantity
from bundle.base.records import dataclass
from bundle.model.cameras import camera_models, project
from bundle.model.problem import Problem
from bundle.model.rigid_motions import cross_matrices, rotation_matrices
from bundle.solving.prepare import Prepared

_Floats = NDArray[np.float64]
_Rows = NDArray[np.int64]
LEAST_COSINE = 0.5
"""A point seen from one direction is in view from directions within 60 degrees of it."""
NEAREST = 0.1  # depth below which a point is not in view, in median depths
UNSEEN = 1e-8  # relative size of A N below which a measurement does not depend on the gauge


@dataclass(frozen=True, eq=False)
class Rows:
    """Whitened rows of a measurement by some of the unknowns."""

    columns: _Rows  # (k,) places of the unknowns in the joint covariance
    jacobian: _Floats  # (m, k)


@dataclass(frozen=True, eq=False)
class Joint:
    """Covariance of the unknowns of interest, and the gradient of a quantity w.r.t. them."""

    matrix: _Floats  # (n, n)
    free: _Floats  # (n, d) orthonormal basis of their motions by the free similarities
    gradient: _Floats  # (n,)
    images: Mapping[int, int]  # first place of (w, t) of an image, by its row
    cameras: Mapping[int, int]  # likewise of the parameters of a camera
    points: Mapping[int, int]  # likewise of the coordinates of a point

    @cached_property
    def along(self) -> _Floats:
        """Covariance (n,) of the unknowns with the quantity."""
        return self.matrix @ self.gradient

    @property
    def variance(self) -> float:
        """Variance of the quantity."""
        return float(self.gradient @ self.along)

    def most(self, rows: Rows) -> float:
        """Return an upper bound of :meth:`gain`, without the covariance of the rows."""
        q = self._invariant(rows) @ self.along[rows.columns]
        return float(q @ q / (1 + q @ q / self.variance))

    def gain(self, rows: Rows) -> float:
        """Return the decrease of the variance by a measurement."""
        a, at = self._invariant(rows), rows.columns
        q = a @ self.along[at]
        k = a @ self.matrix[np.ix_(at, at)] @ a.T
        return float(q @ np.linalg.solve(np.eye(len(q)) + k, q))

    def _invariant(self, rows: Rows) -> _Floats:
        """Return combinations (r, k) of the rows that no free similarity changes."""
        b = rows.jacobian @ self.free[rows.columns]
        if np.linalg.norm(b) <= UNSEEN * np.linalg.norm(rows.jacobian):
            return rows.jacobian
        return null_basis(b).T @ rows.jacobian

    def measured(self, rows: Rows) -> Joint:
        """Return the covariance after a measurement."""
        a, at = rows.jacobian, rows.columns
        x = self.matrix[:, at] @ a.T
        m = np.linalg.inv(np.eye(len(a)) + a @ x[at])
        after, free = self.matrix - x @ m @ x.T, self.free
        b = a @ free[at]
        if np.linalg.norm(b) > UNSEEN * np.linalg.norm(a):
            _, sizes, combinations = np.linalg.svd(b)
            rank = int((sizes > UNSEEN * np.linalg.norm(a)).sum())
            seen = combinations[:rank].T
            d = (free - x @ m @ b) @ seen
            after = after + d @ np.linalg.inv(seen.T @ b.T @ m @ b @ seen) @ d.T
            free = free @ combinations[rank:].T
        return replace(self, matrix=(after + after.T) / 2, free=free)


def null_basis(b: _Floats) -> _Floats:
    """Return an orthonormal basis of the vectors u with b^T u = 0."""
    u, sizes, _ = np.linalg.svd(b)
    return u[:, int((sizes > UNSEEN * max(sizes[0], 1e-300)).sum()) :]


def joint_covariance(
    prepared: Prepared,
    quantity: Quantity,
    images: Sequence[int],
    cameras: Sequence[int],
    points: Sequence[int],
) -> Joint:
    """Return the joint covariance of poses, parameters and points, and those of the quantity.

    Args:
        images: rows of images, likewise of cameras and points.
    """
    start, layout = prepared.start, prepared.layout
    named = quantity.images, quantity.cameras, quantity.points
    wanted = [
        sorted({*map(int, rows), *np.flatnonzero(one.any(axis=1)).tolist()})
        for rows, one in zip((images, cameras, points), named, strict=True)
    ]
    params = start.camera_params.shape[1]
    sizes, places, count = (6, params, 3), list[dict[int, int]](), 0
    for rows, size in zip(wanted, sizes, strict=True):
        places.append({row: count + size * place for place, row in enumerate(rows)})
        count += size * len(rows)
    of_images, of_cameras, of_points = places
    functions = np.zeros((count, start.num_images, 6 + params))
    gradient = np.zeros(count)
    for at, one, size in zip(places, named, sizes, strict=True):
        for row, place in at.items():
            gradient[place : place + size] = one[row]
    for image, place in of_images.items():
        functions[place : place + 6, image, :6] = np.eye(6)
    first = {int(start.image_camera[i]): i for i in start.observation_image[::-1]}
    for camera, place in of_cameras.items():
        if camera in first:
            functions[place : place + params, first[camera], 6:] = np.eye(params)
    by_points = np.zeros((count, len(of_points), 3))
    for row, place in enumerate(of_points.values()):
        by_points[place : place + 3, row] = np.eye(3)
    given = layout.limits, layout.core_factors()
    options = layout.options.replace(gauge="none")
    out = _core.covariance(
        start, options.asdict(), *given, inner=True, sandwich=False, of_points=False, relative=[],
        long_sums=True, of_images=False, functions=functions, function_points=list(of_points),
        functions_of_points=by_points,
    )  # fmt: skip
    free = _free_motions(start, options, given, of_images, of_points, count)
    return Joint(np.array(out["functions"]), free, gradient, *places)


def _free_motions(
    start: Problem,
    options: Any,
    given: tuple[Any, Any],
    images: Mapping[int, int],
    points: Mapping[int, int],
    count: int,
) -> _Floats:
    """Return an orthonormal basis (count, d) of the unknowns' motions by the free similarities.

    A similarity X' = X + a + b x (X - c) + s (X - c) moves an image by w = -R b, R^T dt = s (R^T t
    + c) - a + b x c. The core gives R^T w and R^T dt of the poses of images and frames.
    """
    seen = np.unique(start.observation_image)
    frame = start.image_frame[seen] if len(start.image_frame) else np.full(len(seen), -1)
    alone, frames = seen[frame < 0].tolist(), np.unique(frame[frame >= 0]).tolist()
    found = _core.free_similarities(start, options.asdict(), *given, alone, frames, [])
    if not found.shape[1]:
        return np.zeros((count, 0))
    center = start.points[np.unique(start.observation_point)].mean(axis=0)
    poses = np.concatenate([start.cam_from_world[alone], start.rig_from_world[frames]])
    local = _by_similarity(poses, center)
    world = np.linalg.lstsq(local.reshape(-1, 7), found, rcond=None)[0]
    moved = np.zeros((count, found.shape[1]))
    rows = list(images)
    turns = rotation_matrices(start.cam_from_world[rows, :4])
    for row, turn, by in zip(
        rows, turns, _by_similarity(start.cam_from_world[rows], center), strict=True
    ):
        place = images[row]
        moved[place : place + 3] = turn @ by[:3] @ world
        moved[place + 3 : place + 6] = turn @ by[3:] @ world
    for point, place in points.items():
        x = (start.points[point] - center)[None]
        by = np.hstack([np.eye(3), -cross_matrices(x)[0], x.T])
        moved[place : place + 3] = by @ world
    basis, sizes, _ = np.linalg.svd(moved, full_matrices=False)
    return basis[:, sizes > UNSEEN * sizes.max()]


def _by_similarity(poses: _Floats, center: _Floats) -> _Floats:
    """Return the derivatives (n, 6, 7) of (R^T w, R^T dt) with respect to (a, b, s)."""
    turns = rotation_matrices(poses[:, :4])
    by = np.zeros((len(poses), 6, 7))
    by[:, :3, 3:6] = -np.eye(3)
    by[:, 3:, :3] = -np.eye(3)
    by[:, 3:, 3:6] = -cross_matrices(center[None])[0]
    by[:, 3:, 6] = np.einsum("nji,nj->ni", turns, poses[:, 4:]) + center
    return by


class View(NamedTuple):
    """Points that a camera would see, with whitened derivatives of their pixels."""

    points: _Rows  # (m,) rows of the points
    xy: _Floats  # (m, 2)
    by_pose: _Floats  # (m, 2, 6) by (w, t)
    by_params: _Floats  # (m, 2, parameters)
    by_point: _Floats  # (m, 2, 3)


def view(start: Problem, pose: _Floats, camera: int, points: _Rows, sigma: float = 1.0) -> View:
    """Return what a camera would see of some points from a pose (7,) cam_from_world."""
    turn, model = rotation_matrices(pose[None, :4])[0], start.camera_models[camera]
    at = start.points[points] @ turn.T + pose[4:]
    width = len(camera_models()[model])
    pixels = project(model, start.camera_params[camera, :width], at, jacobians=True)
    low, high = np.zeros(2), start.camera_sizes[camera].astype(float)
    if not high.all():
        own = start.observation_xy[start.image_camera[start.observation_image] == camera]
        low, high = own.min(axis=0), own.max(axis=0)
    depth = at[:, 2]  # that is negative and valid only if the lens sees behind itself
    inside = pixels.valid & ((pixels.xy > low) & (pixels.xy < high)).all(axis=1)
    if len(depth):
        inside &= (depth < 0) | (depth > NEAREST * np.median(np.abs(depth)))
    # The nearest of the directions from which a point is seen.
    place = np.full(start.num_points, -1)
    place[points] = np.arange(len(points))
    rows = np.flatnonzero(place[start.observation_point] >= 0)
    seen, image = start.observation_point[rows], start.observation_image[rows]
    present = unit_vectors(start.projection_centers[image] - start.points[seen])
    new = unit_vectors(-turn.T @ pose[4:] - start.points[points])
    cosine = np.full(len(points), -1.0)
    np.maximum.at(cosine, place[seen], (present * new[place[seen]]).sum(axis=1))
    kept = np.flatnonzero(inside & (cosine >= LEAST_COSINE))
    by_point = pixels.d_point[kept] / sigma
    by_params = np.zeros((len(kept), 2, start.camera_params.shape[1]))
    by_params[:, :, :width] = pixels.d_params[kept] / sigma
    by_turn = -by_point @ cross_matrices(start.points[points[kept]] @ turn.T)
    by_pose = np.concatenate([by_turn, by_point], axis=2)
    return View(points[kept], pixels.xy[kept], by_pose, by_params, by_point @ turn)


def unit_vectors(vectors: _Floats) -> _Floats:
    """Return vectors (n, 3) of length 1; 0 stays 0."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(lengths, 1e-300))
