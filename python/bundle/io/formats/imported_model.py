"""A reconstruction in the arrays of its file, its problem, and their check; fitted lenses.

Converters between formats are often wrong by a flipped axis, another origin or another meaning of
distortion. Each reader therefore states the projection of its format a second time, as a few lines
of NumPy on the numbers of the file (``Imported.project``). The reprojection errors by this formula
and by the problem must agree to 1e-6 pixels, in the mean square and in the median, or the file is
refused with both numbers. A lens that was fitted may differ by the error of its fit.

If the program used other axes than the format, both formulas have the same error. Therefore most
points must also be in front of their cameras.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arrays import at, freeze, refuse_row
from bundle.base.records import dataclass
from bundle.errors import InputError, shown
from bundle.model.cameras import project
from bundle.model.lenses.lens_fit import fit_lens
from bundle.model.problem import Problem
from bundle.model.pycolmap.problem_source import ImportedSource
from bundle.model.rigid_motions import quaternion_from_matrix

Array = NDArray[np.float64]

AGREEMENT = 1e-6
"""Largest difference of reprojection errors: pixels, or relative for errors above a pixel."""

LEAST_ORTHONORMAL = 1e-3  # largest entry of R R^T - I in a file; the nearest rotation is used

_CHUNK = 1 << 16


@dataclass(frozen=True, kw_only=True)
class Imported:
    """A reconstruction in the arrays of its file."""

    path: Path  # file, for messages
    fields: Mapping[str, Any]  # fields of the problem by name
    colors: NDArray[np.uint8]  # (num_points, 3) red, green, blue
    # function of the images (n,) and the world points (n, 3) of observations that returns their
    # projections (n, 2) by the formula and in the unit of the format
    project: Callable[[NDArray[np.int32], Array], Array]
    measured: Array  # (num_observations, 2) measured positions in the unit of the format
    unit: Array  # (num_images,) pixels per unit of the format
    fit_error: float = 0.0  # largest error of fitted lenses in pixels
    notes: Sequence[str] = ()  # sentences about data that the problem lacks or approximates
    # values by name that the writer of the same format uses again
    data: Mapping[str, Any] = field(default_factory=dict)
    axes: str = ""  # advice for a file whose points are behind its cameras

    def problem(self) -> Problem:
        """Return the problem of the file."""
        with at(shown(self.path)):
            problem = Problem(**_frozen(self.fields))
        ours, behind = _core.reprojection_errors(problem, 0, "auto")
        theirs = self._errors(problem)
        defined = np.isfinite(theirs) & np.isfinite(ours)
        if not defined.all():
            theirs, ours = theirs[defined], ours[defined]
        del defined
        source_rmse, rmse = _rmse(theirs), _rmse(ours)
        for name, one, other in (
            ("RMSE", source_rmse, rmse),
            ("median", _median(theirs), _median(ours)),
        ):
            if not abs(one - other) <= AGREEMENT * max(1.0, one) + self.fit_error:
                raise InputError(
                    f"{shown(self.path)}: expected the same reprojection error ({name}) by the "
                    f"formula of the format and by COLMAP's, found {one:.9g} px and {other:.9g} px"
                )
        count = int(np.count_nonzero(behind))
        if 2 * count > len(behind):
            raise InputError(
                f"{shown(self.path)}: expected points in front of their cameras, found "
                f"{count} of {len(behind)} observed points behind{self.axes}"
            )
        source = ImportedSource(
            point_ids=problem.point_ids,
            point_colors=self.colors,
            source_rmse=source_rmse,
            rmse=rmse,
            notes=tuple(self.notes),
            data=self.data,
        )
        return problem._moved(source=source)

    def _errors(self, problem: Problem) -> Array:
        """Return the error of each observation in pixels by the formula of the format."""
        errors = np.empty(problem.num_observations)
        with np.errstate(all="ignore"):  # points in the plane of the camera
            for begin in range(0, len(errors), _CHUNK):
                part = slice(begin, begin + _CHUNK)
                image = problem.observation_image[part]
                points = problem.points[problem.observation_point[part]]
                residual = self.project(image, points) - self.measured[part]
                errors[part] = np.hypot(residual[:, 0], residual[:, 1]) * self.unit[image]
        return errors


def by_camera(
    projections: Sequence[Callable[[Array], Array]], camera: NDArray[Any], points: Array
) -> Array:
    """Return (n, 2) projections of points (n, 3) in their cameras, by the function of each camera.

    Args:
        projections: function of each camera, of (k, 3) points.
        camera: (n,) index of the camera of each point.
        points: (n, 3) points in the frames of their images.
    """
    if len(projections) == 1:
        return projections[0](points)
    result = np.empty((len(points), 2))
    order = np.argsort(camera, kind="stable")
    ends = np.searchsorted(camera[order], np.arange(len(projections) + 1))
    for row in np.flatnonzero(np.diff(ends)).tolist():
        mine = order[ends[row] : ends[row + 1]]
        result[mine] = projections[row](points[mine])
    return result


def _rmse(errors: Array) -> float:
    with np.errstate(over="ignore"):
        return float(np.sqrt(errors @ errors / len(errors))) if len(errors) else 0.0


def _median(errors: Array) -> float:
    """Return the median; reorder the errors."""
    return float(np.median(errors, overwrite_input=True)) if len(errors) else 0.0


def _frozen(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields with immutable arrays; arrays that own their data are not copied."""
    return {
        name: freeze(value) if isinstance(value, np.ndarray) and value.flags.owndata else value
        for name, value in fields.items()
    }


def pixels(measured: Array, image: NDArray[np.int32], scale: Any, center: Array) -> Array:
    """Return ``center + scale * measured`` by image.

    Args:
        measured: (num_observations, 2) positions in the unit and axes of the format.
        image: (num_observations,) image of each observation.
        scale: (num_images, 2) or (2,) pixels per unit, negative for an axis that points back.
        center: (num_images, 2) pixel of the origin.
    """
    scales = np.broadcast_to(np.asarray(scale, float), center.shape)
    result = np.empty_like(measured)
    for begin in range(0, len(image), _CHUNK):
        part = slice(begin, begin + _CHUNK)
        np.multiply(measured[part], scales[image[part]], out=result[part])
        result[part] += center[image[part]]
    return result


def checked_rotations(matrices: Array, place: Callable[[int], str]) -> Array:
    """Return the rotations nearest to matrices (n, 3, 3) of a file, whose digits are rounded."""
    with np.errstate(all="ignore"):
        product = matrices @ matrices.transpose(0, 2, 1)
        off = np.abs(product - np.eye(3)).max(axis=(1, 2), initial=0.0)
        wrong = ~((off <= LEAST_ORTHONORMAL) & (np.linalg.det(matrices) > 0))
    refuse_row(
        wrong,
        lambda index: (
            f"{place(index)}: expected a rotation matrix, found one with R R^T - I up to "
            f"{off[index]:.2g} and determinant {np.linalg.det(matrices[index]):.2g}"
        ),
    )
    u, _, vt = np.linalg.svd(matrices)
    nearest: Array = u @ vt
    return nearest


def poses_of(rotations: Array, translations: Array) -> Array:
    """Return poses (n, 7) of rotations (n, 3, 3) and translations (n, 3)."""
    return np.column_stack([quaternion_from_matrix(rotations), translations])


def all_differ(values: NDArray[Any]) -> bool:
    """Return True if no value occurs twice."""
    ordered = np.sort(values)
    return not (ordered[1:] == ordered[:-1]).any()


def unique_keys(image: NDArray[np.int32], key: NDArray[np.int32]) -> NDArray[np.int32] | None:
    """Return the keypoint indices, or None if the file does not number its keypoints.

    Some programs write the same index, such as 0, for several keypoints of an image.
    """
    if not len(key) or key.min() < 0:
        return None
    return key if all_differ(image.astype(np.int64) << 32 | key) else None


# Lenses of other programs without an equal camera model: a model is fitted to their rays.
#
# The fit minimises the distance in pixels over a polar grid of rays
# (``bundle.model.lenses.lens_fit``). Its reported error is the largest distance on that grid. A
# lens that is symmetric about its axis has the image radius rho(theta) at the angle theta to the
# axis.

NUM_RADII = 48
NUM_DIRECTIONS = 8


class FittedLens(NamedTuple):
    """Parameters of the fitted model, and the largest distance to the given lens in pixels."""

    params: NDArray[np.float64]
    error: float


def fitted_lens(
    model: str,
    focal: float,
    center: NDArray[np.float64],
    angles: NDArray[np.float64],
    radii: NDArray[np.float64],
) -> FittedLens | None:
    """Fit a symmetric lens; return None if the model cannot project all its rays.

    Args:
        focal: focal length in pixels for the start.
        angles: (n,) angles to the axis in radians, ascending.
        radii: (n,) radii in pixels at these angles.
    """
    turns = np.arange(NUM_DIRECTIONS) * (2 * np.pi / NUM_DIRECTIONS)
    directions = np.column_stack([np.cos(turns), np.sin(turns)])
    rays = np.concatenate(
        [
            np.column_stack([np.sin(angles)[:, None] * direction, np.cos(angles)])
            for direction in directions
        ]
    )
    xy = np.concatenate([center + radii[:, None] * direction for direction in directions])
    start = "SIMPLE_FISHEYE" if "FISHEYE" in model else "SIMPLE_PINHOLE"
    return fitted_to_rays(model, (start, np.array([focal, *center])), rays, xy)


def fitted_to_rays(
    model: str,
    start: tuple[str, NDArray[np.float64]],
    rays: NDArray[np.float64],
    xy: NDArray[np.float64],
) -> FittedLens | None:
    """Fit any lens; return None if the model cannot project all its rays.

    ``rays``: (n, 3) directions. ``xy``: (n, 2) pixels of these rays.
    """
    fit = fit_lens(model, start, rays, xy)
    if fit is None:
        return None
    fitted, _ = project(model, fit.params, rays)
    return FittedLens(fit.params, float(np.linalg.norm(fitted - xy, axis=1).max()))
