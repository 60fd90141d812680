"""Certainty of a reconstruction, as the report shows it.

A pose is R, t with x = R X + t; its covariance counts in w and s of R' = Exp(w) R, t' = t + s. The
centre of the camera is c = -R^T t, hence to first order dc = R^T (w x t) - R^T s, and its
covariance is J C J^T with J = [-R^T [t]x, -R^T].
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.figures.marks import Figure, Matrix
from bundle.model.cameras import camera_models
from bundle.model.problem import Problem
from bundle.model.rigid_motions import cross_matrices, rotation_matrices

if TYPE_CHECKING:
    from bundle.analysis.uncertainty.covariance_result import Covariance

Array = NDArray[np.float64]
Ids = NDArray[np.int64]


@dataclass(frozen=True, eq=False, kw_only=True)
class Certainty:
    """Covariances by index in the problem.

    Attributes:
        sigma0: sigma of an observation of unit weight [pixels].
        dof: degrees of freedom.
        gauge: gauge of the covariances of poses and points.
        scale: "sigma0" if covariances are multiplied by sigma0^2, otherwise "unit".
        notes: sentences with remarks on the covariances.
        num_null_points: points without parallax, left out along their undetermined direction.
        images: (n,) indices.
        centers: (n, 3, 3) covariances of camera centres [length unit squared].
        angles: (n,) standard deviation of the rotation about its least certain axis [degrees].
        points: (m,) indices.
        point_covariance: (m, 3, 3) [length unit squared].
        cameras: (k, k) covariance of the parameters by camera index, NaN for constant parameters.
    """

    sigma0: float
    dof: int
    gauge: str
    scale: str
    notes: tuple[str, ...]
    num_null_points: int
    images: Ids
    centers: Array
    angles: Array
    points: Ids
    point_covariance: Array
    cameras: dict[int, Array]

    @property
    def position_sigmas(self) -> Array:
        """(n,) standard deviation of each camera centre in its worst direction [length unit]."""
        sigmas: Array = np.sqrt(largest_eigenvalues(self.centers))
        return sigmas

    def correlations(self, camera: int) -> tuple[Ids, Array]:
        """Return the indices of a camera's refined parameters, and their correlation matrix."""
        covariance = self.cameras[camera]
        free = np.flatnonzero(np.diag(covariance) > 0)
        sigma = np.sqrt(np.diag(covariance)[free])
        return free, covariance[np.ix_(free, free)] / np.outer(sigma, sigma)

    def sigmas(self, camera: int) -> Array:
        """Return standard deviations of the parameters of a camera, NaN for constant ones."""
        variance = np.diag(self.cameras[camera]).copy()
        variance[~(variance > 0)] = np.nan
        sigma: Array = np.sqrt(variance)
        return sigma


def certainty(problem: Problem, given: Covariance) -> Certainty:
    """Return covariances as the report shows them."""
    images = _indices(problem.image_ids, given.pose_ids)
    poses = problem.cam_from_world[images]
    rotation = rotation_matrices(poses[:, :4])
    back = np.swapaxes(rotation, 1, 2)
    jacobian = -np.concatenate([back @ cross_matrices(poses[:, 4:]), back], axis=2)
    covariance = np.asarray(given.pose_covariance, float).reshape(-1, 6, 6)
    return Certainty(
        sigma0=float(given.sigma0),
        dof=int(given.dof),
        gauge=given.gauge,
        scale=given.scale,
        notes=given.notes,
        num_null_points=len(given.null_point_ids),
        images=images,
        centers=jacobian @ covariance @ np.swapaxes(jacobian, 1, 2),
        angles=np.rad2deg(np.sqrt(largest_eigenvalues(covariance[:, :3, :3]))),
        points=_indices(problem.point_ids, given.point_ids),
        point_covariance=np.asarray(given.point_covariance, float).reshape(-1, 3, 3),
        cameras=dict(
            zip(
                _indices(problem.camera_ids, given.camera_ids).tolist(),
                np.asarray(given.camera_covariance, float),
                strict=True,
            )
        ),
    )


def correlation_figure(problem: Problem, known: Certainty, camera: int) -> Figure | None:
    """Return the correlations of a camera's refined parameters; None for fewer than two."""
    free, values = known.correlations(camera)
    if len(free) < 2:
        return None
    names = camera_models()[problem.camera_models[camera]]
    matrix = Matrix(tuple(names[index] for index in free), values)
    title = f"Camera {problem.camera_ids[camera]}, {problem.camera_models[camera]}"
    return Figure(name="correlations", title=title, marks=(matrix,))


def largest_eigenvalues(covariance: Array) -> Array:
    """Return the largest eigenvalue of each matrix; NaN for matrices that are not finite."""
    known = np.isfinite(covariance).all(axis=(1, 2))
    values = np.full(len(covariance), np.nan)
    if known.any():
        values[known] = np.linalg.eigvalsh(covariance[known])[:, -1]
    result: Array = np.maximum(values, 0.0)
    return result


def _indices(ids: Ids, wanted: Ids) -> Ids:
    order = np.argsort(ids, kind="stable")
    wanted = np.asarray(wanted, np.int64)
    return order[np.searchsorted(ids, wanted, sorter=order)] if len(wanted) else wanted
