"""Targets triangulated from their pixels, with constant cameras.

The point X minimizes sum |project(X) - xy|^2 / sigma^2 over its images, by Levenberg-Marquardt on
the camera models' own Jacobians J. It starts at the point nearest to all rays: with directions d
and centres c, (sum I - d d^T) X = sum (I - d d^T) c. Its covariance (sum J^T J)^-1 assumes pixels
of the stated sigma and cameras without error.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.georeference.control_point import GroundControlPoint, Measurement
from bundle.georeference.text_lines import ImageIndex
from bundle.model.cameras import camera_models, project
from bundle.model.lenses.exact_image import pixel_rays
from bundle.model.problem import Problem
from bundle.model.rigid_motions import rotation_matrices

Array = NDArray[np.float64]

FEWEST_IMAGES = 2
MAX_STEPS = 100
WORST_CONDITION = 1e12
"""Condition number of a point's normal matrix above which its rays count as parallel."""


@dataclass(frozen=True)
class Triangulated:
    """Target in the model, or the reason why it is missing."""

    point: GroundControlPoint  # the target
    measurements: tuple[Measurement, ...]  # measurements in images of the model
    images: NDArray[np.int64]  # (m,) indices of these images in the problem
    position: Array  # (3,) in the model; nan if it could not be triangulated
    covariance: Array  # (3, 3) of the position, in squared units of the model
    residual: Array  # (m, 2) projection minus measurement, pixels
    reason: str = ""  # reason why the position is missing; "" if it is known


def triangulate(
    problem: Problem,
    points: Iterable[GroundControlPoint],
    images: ImageIndex,
    *,
    pixel_sigma: float,
) -> tuple[Triangulated, ...]:
    """Triangulate every target; ``reason`` is the reason of a failure.

    ``pixel_sigma``: standard deviation in pixels of measurements without their own.
    """
    return tuple(_triangulated(problem, point, images, pixel_sigma) for point in points)


def _triangulated(
    problem: Problem, point: GroundControlPoint, index: ImageIndex, pixel_sigma: float
) -> Triangulated:
    place = f"control point {point.name}: "
    found = [(index.find(entry.image, place), entry) for entry in point.measurements]
    seen = [(image, entry) for image, entry in found if image is not None]
    measurements = tuple(entry for _, entry in seen)
    images = np.array([image for image, _ in seen], dtype=np.int64)

    def lost(reason: str) -> Triangulated:
        nothing = np.full((len(seen), 2), np.nan)
        nowhere = np.full(3, np.nan), np.full((3, 3), np.nan)
        return Triangulated(point, measurements, images, *nowhere, nothing, reason)

    if len(np.unique(images)) < FEWEST_IMAGES:
        return lost(f"measured in {len(seen)} of the model's images, expected at least 2")
    xy = np.array([(entry.x, entry.y) for entry in measurements])
    sigma = np.array([entry.sigma or pixel_sigma for entry in measurements])
    rotations, translations = _poses(problem, images)
    rays = np.empty((len(images), 3))
    for row, image in enumerate(images):
        direction, is_seen = pixel_rays(*_camera(problem, image), xy[row, None])
        if not is_seen[0]:
            return lost(f"its pixel in {measurements[row].image} has no ray in the camera model")
        rays[row] = direction[0] @ rotations[row]
    start = _intersection(rays, -np.einsum("nji,nj->ni", rotations, translations))
    if start is None:
        return lost("its rays are parallel")
    position, normal = _refined(problem, images, rotations, translations, xy, sigma, start)
    if not _is_regular(normal):
        return lost("its rays are parallel")
    residual, _, valid = _reprojected(problem, images, rotations, translations, xy, position)
    if not valid.all():
        return lost(f"its rays intersect behind {measurements[int(np.argmin(valid))].image}")
    covariance = np.asarray(np.linalg.inv(normal), np.float64)
    return Triangulated(point, measurements, images, position, covariance, residual)


def _poses(problem: Problem, images: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return rotations (m, 3, 3) and translations (m, 3)."""
    poses = problem.cam_from_world[images]
    return rotation_matrices(poses[:, :4]), poses[:, 4:]


def _camera(problem: Problem, image: int) -> tuple[str, Array]:
    camera = problem.image_camera[image]
    model = problem.camera_models[camera]
    return model, problem.camera_params[camera, : len(camera_models()[model])]


def _intersection(rays: Array, centers: Array) -> Array | None:
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    normal = across.sum(axis=0)
    if not _is_regular(normal):
        return None
    nearest: Array = np.linalg.solve(normal, np.einsum("nij,nj->i", across, centers))
    return nearest


def _is_regular(normal: Array) -> bool:
    return bool(np.isfinite(normal).all() and np.linalg.cond(normal) < WORST_CONDITION)


def _reprojected(
    problem: Problem,
    images: NDArray[np.int64],
    rotations: Array,
    translations: Array,
    xy: Array,
    position: Array,
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return residuals (m, 2), derivatives (m, 2, 3), and the mask of images with the point."""
    residual, jacobian = np.empty((len(images), 2)), np.empty((len(images), 2, 3))
    valid = np.empty(len(images), dtype=bool)
    for row, image in enumerate(images):
        in_camera = rotations[row] @ position + translations[row]
        pixels = project(*_camera(problem, image), in_camera[None], jacobians=True)
        residual[row] = pixels.xy[0] - xy[row]
        jacobian[row] = pixels.d_point[0] @ rotations[row]
        valid[row] = pixels.valid[0]
    return residual, jacobian, valid


def _refined(
    problem: Problem,
    images: NDArray[np.int64],
    rotations: Array,
    translations: Array,
    xy: Array,
    sigma: Array,
    position: Array,
) -> tuple[Array, Array]:
    """Return the point with the least weighted residuals, and its normal matrix."""

    def at(point: Array) -> tuple[Array, Array, float]:
        residual, jacobian, _ = _reprojected(problem, images, rotations, translations, xy, point)
        whitened = (residual / sigma[:, None]).ravel()
        slope = (jacobian / sigma[:, None, None]).reshape(-1, 3)
        return whitened, slope, float(whitened @ whitened)

    damping = 1e-6
    residual, jacobian, cost = at(position)
    for _ in range(MAX_STEPS):
        normal = jacobian.T @ jacobian
        damped = normal + damping * np.diag(np.diag(normal))
        if not _is_regular(damped):
            break
        step = np.linalg.solve(damped, -jacobian.T @ residual)
        candidate = at(position + step)
        if candidate[2] <= cost:
            position, damping = position + step, damping / 10
            residual, jacobian, cost = candidate
            if np.linalg.norm(step) <= 1e-14 * np.linalg.norm(position):
                break
        elif damping > 1e12:
            break
        else:
            damping = max(damping, 1e-12) * 10
    return position, jacobian.T @ jacobian
