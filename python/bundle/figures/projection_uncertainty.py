"""Uncertainty of the projection of a calibrated camera: sigma in pixels, worst direction.

The covariance S of a camera's parameters alone says little about pixels. An error of the principal
point looks like a small rotation of the camera, and the solve rotates every pose to compensate it.
Users need another number: where a point appears that is fixed relative to the camera's housing. It
is mrcal's projection uncertainty (Kogan, mrcal 3.0, *Projection uncertainty: cross-reprojection*,
mrcal.secretsauce.net/docs-3.0/uncertainty-cross-reprojection.html). The images of one camera
replace mrcal's chessboard frames, and the points of the model replace the board.

An observation sees p = R X + t in the frame of the camera. One motion h = (w, s) of the housing,
the same for all images of the camera, moves it to p + w x p + s. Let J_d and J_h be the whitened
derivatives of the residuals w.r.t. the parameters and h. For parameter errors d and measurement
noise e, h is estimated again:

    M = J_h^T J_h,     h = K d + M^+ J_h^T e,     K = -M^+ J_h^T J_d.

The pixel of a ray u at the distance r moves by A d + B M^+ J_h^T e with B = [-G [u]x, G / r],
A = D + B K, G and D the derivatives of the projection w.r.t. the direction and the parameters.
Columns of J_h are sums of those of free poses. Therefore errors d of the joint least squares and
J_h^T e are not correlated, and

    Var = A S A^T + n^2 B M^+ B^T,

with n the sigma of whitened residuals. This is exact if all poses of the camera are free. If poses
are constant, or determined by priors or a rig, it is the uncertainty without that knowledge. Only
noise is included: a wrong lens model causes larger errors. A and B are linear in 1 / r, hence

    Var = V_0 + V_1 / r + V_2 / r^2,

and V_0 at infinity. The drawn number is the root of the largest eigenvalue. It does not depend on
the gauge, because camera parameters are the same in all gauges.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.figures.residual_field import image_box, principal_point
from bundle.model.cameras import camera_models, project
from bundle.model.lenses.exact_image import pixel_rays
from bundle.model.losses import evaluate_loss
from bundle.model.problem import Problem
from bundle.model.residuals import Residuals, residuals
from bundle.model.rigid_motions import cross_matrices, rotation_matrices

Array = NDArray[np.float64]

MOST_CELLS = 25
AT_ONCE = 100_000  # number of observations whose derivatives are in memory at the same time

RANK = 1e-12  # relative limit below which eigenvalues of the scaled M count as zero


@dataclass(frozen=True, eq=False, kw_only=True)
class ProjectionUncertainty:
    """Uncertainty of the projection of one camera, over the cells of its image.

    Attributes:
        camera_id: id of the camera.
        model: camera model.
        box: (4,) left, top, right, bottom of the grid [pixels].
        count: (rows, columns) observations in each cell.
        distance: median distance of its observed points [length unit].
        range: (2,) useful range of distances for a curve: a wide range around those of its points.
        terms: (rows, columns, 3, 2, 2) V_0, V_1, V_2 at the middle of each cell [pixels squared,
            distances in the length unit]; NaN if no ray is imaged there.
    """

    camera_id: int
    model: str
    box: Array
    count: NDArray[np.int64]
    distance: float
    range: tuple[float, float]
    terms: Array

    def sigma(self, distance: float = np.inf) -> Array:
        """Return (rows, columns) sigma in the worst direction [pixels] at a distance."""
        inverse = 1.0 / distance
        v0, v1, v2 = (self.terms[:, :, k] for k in range(3))
        total = v0 + inverse * (v1 + inverse * v2)
        a, b, c = total[..., 0, 0], total[..., 0, 1], total[..., 1, 1]
        worst: Array = np.sqrt(np.maximum((a + c) / 2 + np.hypot((a - c) / 2, b), 0.0))
        return worst

    @property
    def distances(self) -> Array:
        """Return distances for a curve, evenly spaced in their logarithm."""
        return np.geomspace(*self.range, 49)

    def by_distance(self) -> dict[str, Array]:
        """Return sigma in the middle of the image, its median and its maximum over the image."""
        rows, columns = self.count.shape
        every = np.stack([self.sigma(distance) for distance in self.distances.tolist()])
        flat = every.reshape(len(every), -1)
        known = flat[:, np.isfinite(flat[0])]
        return {
            "middle of the image": every[:, rows // 2, columns // 2],
            "median over the image": np.median(known, axis=1),
            "worst of the image": known.max(axis=1),
        }


def projection_uncertainty(
    problem: Problem,
    camera: int,
    covariance: Array,
    *,
    found: Residuals | None = None,
    sigma: float = 1.0,
    loss: str = "trivial",
    loss_scale: float = 1.0,
) -> ProjectionUncertainty | None:
    """Return the uncertainty of a projection; None without free parameters or rays.

    Args:
        problem: problem with the camera.
        camera: index of the camera.
        covariance: (k, k) of its parameters in COLMAP's order; NaN for constant parameters.
        found: residuals of the problem; computed if None.
        sigma: sigma of the residuals if the problem has no sigmas, otherwise a factor of its
            sigmas; sigma0 if the covariance is scaled by it.
        loss: loss of the solve.
        loss_scale: scale of the loss.
    """
    model = problem.camera_models[camera]
    if principal_point(problem, camera) is None:
        return None  # panoramas: nothing to refine, and no pixel rays in this chart
    params = problem.camera_params[camera, : len(camera_models()[model])]
    known = covariance[: len(params), : len(params)]
    free = np.flatnonzero(np.diag(known) > 0)
    found = residuals(problem) if found is None else found
    chosen = found.counted & (problem.image_camera[problem.observation_image] == camera)
    rows = np.flatnonzero(chosen)
    if len(free) == 0 or len(rows) == 0:
        return None
    weight = _weights(problem, found, rows, loss, loss_scale)
    normal, distances = _normal_equations(problem, params, model, free, rows, weight)
    inverse = _pseudo_inverse(normal[:6, :6])
    if inverse is None:
        return None
    xy = problem.observation_xy[rows]
    box = image_box(xy, problem.camera_sizes[camera])
    columns, lines = _cells(box)
    terms = _terms(
        model, params, free, _middles(box, columns, lines), known[np.ix_(free, free)],
        -inverse @ normal[:6, 6:], sigma * sigma * inverse,
    )  # fmt: skip
    if not np.isfinite(terms).any():
        return None
    counts, _, _ = np.histogram2d(xy[:, 0], xy[:, 1], (columns, lines), box.reshape(2, 2).T)
    low, middle, high = np.quantile(distances, [0.01, 0.5, 0.99]).tolist()
    return ProjectionUncertainty(
        camera_id=int(problem.camera_ids[camera]),
        model=model,
        box=box,
        count=counts.T.astype(np.int64),
        distance=middle,
        range=(min(low, middle / 10), max(high, 30 * middle)),
        terms=terms.reshape(lines, columns, 3, 2, 2),
    )


def contour_levels(values: Array) -> list[float]:
    """Return round levels between the smallest and largest value: 1, 2, 5, or even steps."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
    if not 0 < low < high:
        return []
    if high > 6 * low:
        first = int(np.floor(np.log10(low)))
        last = int(np.ceil(np.log10(high)))
        series = [float(f"{k}e{power}") for power in range(first, last + 1) for k in (1, 2, 5)]
        return [level for level in series if low < level < high][-8:]
    rough = (high - low) / 5
    power = 10.0 ** np.floor(np.log10(rough))
    step = min(power * k for k in (1, 2, 5, 10) if power * k >= rough * (1 - 1e-9))
    places = np.arange(np.floor(low / step) + 1, np.ceil(high / step))
    return [float(f"{place * step:.6g}") for place in places.tolist()]


def _weights(
    problem: Problem, found: Residuals, rows: NDArray[np.int64], loss: str, loss_scale: float
) -> Array:
    """Return the weight of each residual: 1 / sigma^2, times rho' of the loss."""
    given = problem.observation_sigma
    inverse = np.ones(len(rows)) if given is None else given[rows] ** -2.0
    squared = (found.xy[rows] ** 2).sum(axis=1) * inverse
    result: Array = inverse * evaluate_loss(loss, loss_scale, squared)[:, 1]
    return result


def _normal_equations(
    problem: Problem,
    params: Array,
    model: str,
    free: NDArray[np.int64],
    rows: NDArray[np.int64],
    weight: Array,
) -> tuple[Array, Array]:
    """Return [J_h J_d]^T [J_h J_d] (6 + free, 6 + free), and the distance of each observation."""
    rotation = rotation_matrices(problem.cam_from_world[:, :4])
    translation = problem.cam_from_world[:, 4:]
    size = 6 + len(free)
    normal = np.zeros((size, size))
    distances = np.empty(len(rows))
    for begin in range(0, len(rows), AT_ONCE):
        part = slice(begin, begin + AT_ONCE)
        image = problem.observation_image[rows[part]]
        points = problem.points[problem.observation_point[rows[part]]]
        points = np.einsum("nij,nj->ni", rotation[image], points) + translation[image]
        distances[part] = np.linalg.norm(points, axis=1)
        made = project(model, params, points, jacobians=True)
        turned = -made.d_point @ cross_matrices(points)
        jacobian = np.concatenate([turned, made.d_point, made.d_params[:, :, free]], axis=2)
        jacobian = (np.sqrt(weight[part])[:, None, None] * jacobian).reshape(-1, size)
        normal += jacobian.T @ jacobian
    return normal, distances


def _pseudo_inverse(matrix: Array) -> Array | None:
    """Return the inverse of M; None if the observations leave a motion of the housing free."""
    scale = np.sqrt(np.diag(matrix))
    if not np.isfinite(matrix).all() or not (scale > 0).all():
        return None
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    if values[0] < RANK * values[-1]:
        return None
    inverse: Array = (vectors / values) @ vectors.T / np.outer(scale, scale)
    return inverse


def _terms(
    model: str,
    params: Array,
    free: NDArray[np.int64],
    xy: Array,
    covariance: Array,
    follow: Array,
    housing: Array,
) -> Array:
    """Return (n, 3, 2, 2) V_0, V_1, V_2 of (n, 2) pixels; NaN if no ray is imaged there.

    ``covariance`` is S of the free columns, ``follow`` K, (6, free), and ``housing`` n^2 M^+ of the
    derivation above, (6, 6).
    """
    rays, is_seen = pixel_rays(model, params, xy)
    made = project(model, params, rays, jacobians=True)
    b = np.zeros((2, len(xy), 2, 6))
    b[0, :, :, :3] = -made.d_point @ cross_matrices(rays)
    b[1, :, :, 3:] = made.d_point
    a = b @ follow
    a[0] += made.d_params[:, :, free]

    def product(i: int, j: int) -> Array:
        back_a, back_b = np.swapaxes(a[j], 1, 2), np.swapaxes(b[j], 1, 2)
        result: Array = a[i] @ covariance @ back_a + b[i] @ housing @ back_b
        return result

    terms = np.stack([product(0, 0), product(0, 1) + product(1, 0), product(1, 1)], axis=1)
    terms[~is_seen] = np.nan
    return terms


def _cells(box: Array) -> tuple[int, int]:
    """Return numbers of columns and rows of nearly square cells, odd for a cell in the middle."""
    width, height = box[2] - box[0], box[3] - box[1]
    side = max(width, height) / MOST_CELLS
    columns, rows = (2 * int(np.rint((extent / side - 1) / 2)) + 1 for extent in (width, height))
    return max(columns, 1), max(rows, 1)


def _middles(box: Array, columns: int, rows: int) -> Array:
    x = box[0] + (np.arange(columns) + 0.5) * (box[2] - box[0]) / columns
    y = box[1] + (np.arange(rows) + 0.5) * (box[3] - box[1]) / rows
    across, down = np.meshgrid(x, y)
    return np.column_stack([across.ravel(), down.ravel()])
