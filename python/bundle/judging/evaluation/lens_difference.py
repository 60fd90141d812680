"""Difference of two lenses in pixels over the image, without the rotation that explains part of it.

Calibrations of one lens differ by a rotation of the camera that the poses absorb: a shift of the
principal point by 10 px looks like a turn of 10 px / f. As mrcal-show-projection-diff does
(https://mrcal.secretsauce.net/differencing.html), the rotation R is removed that fits best. With
the ray d_k of lens A at the pixel x_k and the projection pi_B of lens B, it minimises

    sum_k |pi_B(R d_k) - x_k|^2

by Gauss-Newton, R <- Exp(w) R with the derivative -D_pi [R d_k]x w.r.t. w. The residuals are the
difference of the lenses. It holds for distant points: a translation of the camera, which would also
absorb a part for near points, is not removed.

The pixels are the centres of a grid over the image of A, up to the distance of its farthest
observation from the image centre, because no observation has determined a lens farther out. If the
images of A and B have different sizes, pixels of B are scaled to those of A.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.model.cameras import camera_models, project
from bundle.model.lenses.exact_image import pixel_rays
from bundle.model.pose_table import ErrorStatistics
from bundle.model.problem import Problem
from bundle.model.rigid_motions import (
    cross_matrices,
    quaternion_from_vector,
    quaternion_multiply,
    rotation_matrices,
)

COLUMNS = 24
MOST_ITERATIONS = 30
SMALLEST_STEP = 1e-14
FEWEST_OBSERVATIONS = 30
FEWEST_RAYS = 3

WITHOUT_RAYS = ("EQUIRECTANGULAR",)
"""Camera models without an inverse projection here; equal parameters are still recognised."""

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class LensDifference:
    """Difference of the lens of a camera of A and of a camera of B."""

    camera_a: int  # id in A
    camera_b: int  # id in B
    num_images: int  # number of shared images with these cameras
    box: Array  # (4,) left, top, right, bottom of the grid in pixels of A
    # (rows, columns, 2) projection by B minus by A in pixels of A; NaN at pixels that a lens cannot
    # see or no observation of A has determined
    field: Array
    angle: float  # angle of the removed rotation in degrees
    pixels: ErrorStatistics  # statistics of |field|; NaN if the lenses share no rays


def lens_differences(
    a: Problem, b: Problem, rows_a: Indices, rows_b: Indices
) -> tuple[LensDifference, ...]:
    """Return the difference of each pair of cameras of shared images, most images first."""
    cameras = np.column_stack([a.image_camera[rows_a], b.image_camera[rows_b]])
    pairs, counts = np.unique(cameras, axis=0, return_counts=True)
    boxes = _Boxes(a)
    found = [
        _difference(a, b, int(one), int(other), int(count), boxes)
        for (one, other), count in zip(pairs, counts, strict=True)
    ]
    return tuple(sorted(found, key=lambda one: -one.num_images))


class _Boxes:
    """Image region of each camera of a problem, and the distance that observations reach."""

    def __init__(self, problem: Problem) -> None:
        self._sizes = problem.camera_sizes
        camera = problem.image_camera[problem.observation_image]
        order = np.argsort(camera, kind="stable")
        self._xy = problem.observation_xy[order]
        self._starts = np.searchsorted(camera[order], np.arange(problem.num_cameras + 1))

    def box_and_radius(self, camera: int) -> tuple[Array, float]:
        """Return left, top, right, bottom, and the distance from the middle that is determined."""
        observed = self._xy[self._starts[camera] : self._starts[camera + 1]]
        size = self._sizes[camera].astype(float)
        inside = ((observed >= 0) & (observed <= size)).all(axis=1)
        if (size > 0).all() and 2 * inside.sum() >= len(observed):
            box, observed = np.array([0.0, 0.0, *size]), observed[inside]
        elif len(observed):
            box = np.concatenate([observed.min(axis=0), observed.max(axis=0)])
        else:
            return np.array([0.0, 0.0, 1.0, 1.0]), 0.0
        middle = (box[:2] + box[2:]) / 2
        reach = np.inf
        if len(observed) >= FEWEST_OBSERVATIONS:
            reach = float(np.linalg.norm(observed - middle, axis=1).max())
        return box, reach


def _difference(
    a: Problem, b: Problem, one: int, other: int, num_images: int, boxes: _Boxes
) -> LensDifference:
    lens_a, lens_b = _lens(a, one), _lens(b, other)
    box, reach = boxes.box_and_radius(one)
    size_a, size_b = (p.camera_sizes[k].astype(float) for p, k in ((a, one), (b, other)))
    scale = size_b / size_a if (size_a > 0).all() and (size_b > 0).all() else np.ones(2)
    xy, shape = _grid(box, reach)
    field = np.full((len(xy), 2), np.nan)
    known = np.asarray(np.isfinite(xy).all(axis=1))
    angle = 0.0
    is_same = lens_a[0] == lens_b[0] and np.array_equal(lens_a[1], lens_b[1])
    if is_same and (scale == 1).all():
        field[known] = 0.0
    elif not {lens_a[0], lens_b[0]} & set(WITHOUT_RAYS):
        rays = np.zeros((len(xy), 3))
        rays[known], seen = pixel_rays(*lens_a, xy[known])
        known[known] = seen
        if known.sum() >= FEWEST_RAYS:
            field[known], angle = _fitted(lens_b, rays[known], xy[known], scale)
    lengths = np.linalg.norm(field, axis=1)
    return LensDifference(
        camera_a=int(a.camera_ids[one]),
        camera_b=int(b.camera_ids[other]),
        num_images=num_images,
        box=box,
        field=field.reshape(*shape, 2),
        angle=angle,
        pixels=ErrorStatistics.of(lengths[np.isfinite(lengths)]),
    )


def _lens(problem: Problem, camera: int) -> tuple[str, Array]:
    model = problem.camera_models[camera]
    return model, problem.camera_params[camera, : len(camera_models()[model])]


def _grid(box: Array, reach: float) -> tuple[Array, tuple[int, int]]:
    """Return centres of cells (rows * columns, 2), NaN beyond ``reach``, and rows and columns."""
    width, height = box[2:] - box[:2]
    rows = int(np.clip(round(COLUMNS * height / width), 1, 4 * COLUMNS)) if width > 0 else 1
    x = box[0] + width * (np.arange(COLUMNS) + 0.5) / COLUMNS
    y = box[1] + height * (np.arange(rows) + 0.5) / rows
    xy = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    middle = (box[:2] + box[2:]) / 2
    xy[np.linalg.norm(xy - middle, axis=1) > reach] = np.nan
    return xy, (rows, COLUMNS)


def _fitted(lens: tuple[str, Array], rays: Array, xy: Array, scale: Array) -> tuple[Array, float]:
    """Return the differences (n, 2) after the best rotation, and its angle in degrees."""
    turn = np.array([[0.0, 0.0, 0.0, 1.0]])
    used = np.ones(len(rays), dtype=bool)
    for _ in range(MOST_ITERATIONS):
        turned = rays @ rotation_matrices(turn)[0].T
        projected = project(*lens, turned, jacobians=True)
        residual = projected.xy / scale - xy
        jacobian = -(projected.d_point / scale[:, None]) @ cross_matrices(turned)
        used = projected.valid & np.isfinite(residual).all(axis=1)
        used &= np.isfinite(jacobian).all(axis=(1, 2))
        if used.sum() < FEWEST_RAYS:
            break
        step = np.linalg.lstsq(jacobian[used].reshape(-1, 3), -residual[used].ravel())[0]
        turn = quaternion_multiply(quaternion_from_vector(np.asarray(step, np.float64)[None]), turn)
        if float(np.abs(step).max()) < SMALLEST_STEP:
            break
    turned = rays @ rotation_matrices(turn)[0].T
    xy_b, valid = project(*lens, turned)
    difference = np.where(valid[:, None], xy_b / scale - xy, np.nan)
    angle = float(np.degrees(2 * np.arctan2(np.linalg.norm(turn[0, :3]), abs(turn[0, 3]))))
    return difference, angle
