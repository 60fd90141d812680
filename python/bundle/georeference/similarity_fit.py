"""Weighted similarity between two sets of corresponding points, each with its covariance.

The unknowns are s, R, t with y_i = s R a_i + R m_i + t near b_i. Here a_i is a point of the model
and b_i its surveyed position. m_i is an offset in metres along the axes of the model (the lever arm
of an antenna; zero without one). The cost is

    1/2 sum rho(r_i^T S_i^-1 r_i),  r_i = y_i - b_i,  S_i = B_i + s^2 R A_i R^T

with the covariances B_i of the survey and A_i of the point in the model. An unknown height removes
the third row of r_i and S_i.

The start is the closed form for equal weights (``umeyama``). Gauss-Newton steps follow, with left
increments

    dr = (y - t) dlambda - [y - t]x dw + dt,  s <- s exp(dlambda),  R <- Exp(dw) R

(without R m in the term of dlambda). Each step uses the S_i and the weights rho' of the last step,
until convergence. This is iteratively reweighted least squares; its fixed point is the minimum for
the final S_i. If heights are unknown, the closed form uses heights that the model itself predicts,
in a few iterations.
"""

from __future__ import annotations

import math
from dataclasses import field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.georeference.similarity import Similarity, umeyama
from bundle.model.losses import evaluate_loss
from bundle.model.rigid_motions import quaternion_from_vector, rotation_matrices

Array = NDArray[np.float64]

THINNEST = 1e-6  # largest ratio of width to length for which points count as lying on one line
WIDEST_ANGLE = math.radians(10)
"""Largest standard deviation of the three rotation angles of a determined model."""
LEAST_SIGMA0 = 1e-3  # fraction of the sigmas below which residuals are rounding errors
LEAST_FREEDOM = 1e-6  # degrees of freedom below which residuals are rounding errors only
MAX_STEPS = 200
SMALLEST_STEP = 1e-13
WORST_CONDITION = 1e10


@dataclass(frozen=True)
class SimilarityFit:
    """Fitted similarity and its covariance."""

    similarity: Similarity  # the map
    # (7, 7) of log scale, rotation (radians, left increment) and translation [m] at ``center``, for
    # the given covariances
    covariance: Array
    center: Array  # (3,) point of the model to which the translation of ``covariance`` belongs
    weight: Array  # (n,) rho' of each point; 1 without a loss
    # (n, 3) residuals divided by the lower Cholesky factors of their covariances; 0 for unknown
    # heights
    whitened: Array
    # (n, 3) fraction of each whitened residual that the fit does not absorb, between 0 and 1; 0 for
    # unknown heights
    redundancy: Array

    @property
    def sigma0(self) -> float:
        """Residuals in sigmas relative to their degrees of freedom; nan with zero degrees."""
        freedom = float(self.redundancy.sum())
        squared = float((self.weight[:, None] * self.whitened**2).sum())
        return math.sqrt(squared / freedom) if freedom > LEAST_FREEDOM else math.nan

    def predict(self, points: Correspondences) -> tuple[Array, Array]:
        """Return residuals (n, 3) and covariances (n, 3, 3) of points that were not used.

        The covariance is the sum of the survey's, the model point's and the similarity's.
        """
        residual = _residuals(self.similarity, points)
        jacobian = _jacobian(self.similarity, points, self.center)
        fitted = np.einsum("nij,jk,nlk->nil", jacobian, self.covariance, jacobian)
        return residual, fitted + _covariances(self.similarity, points)


def fit_similarity(
    points: Correspondences, *, loss: str = "trivial", loss_scale: float = 1.0, what: str = "points"
) -> SimilarityFit:
    """Return the weighted similarity.

    Args:
        points: at least three points that are not on one line; enough of them must have a height.
        loss: robust loss of the residuals in sigmas.
        loss_scale: sigmas beyond which the loss is robust.
    """
    try:
        return _fitted(points, loss, loss_scale, what)
    except (np.linalg.LinAlgError, OverflowError):
        raise InputError(
            f"expected {what} and a model of comparable magnitude, found coordinates up to "
            f"{np.nanmax(np.abs(points.target)):.3g}, and up to {np.abs(points.source).max():.3g} "
            "in the model"
        ) from None


def _fitted(points: Correspondences, loss: str, loss_scale: float, what: str) -> SimilarityFit:
    _check_points(points, what)
    similarity = _start(points)
    center = points.source.mean(axis=0)
    size = float(np.sqrt(((points.source - center) ** 2).sum(axis=1).mean()))
    with np.errstate(all="ignore"):  # undetermined cases are refused below
        for _ in range(MAX_STEPS):
            root, whitened, jacobian = _whitened(similarity, points, center)
            weight = _weights(whitened, loss, loss_scale)
            normal, gradient = _normal(jacobian, whitened, weight)
            _check_normal(normal, points, weight, what)
            step = np.asarray(-np.linalg.solve(normal, gradient), np.float64)
            similarity, share = _stepped(similarity, points, center, step, root, weight)
            length = float(np.abs(step[:4]).max())
            length += float(np.abs(step[4:]).max()) / (similarity.scale * size)
            if share * length <= SMALLEST_STEP:
                break
        _, whitened, jacobian = _whitened(similarity, points, center)
        weight = _weights(whitened, loss, loss_scale)
        normal, _ = _normal(jacobian, whitened, weight)
        _check_normal(normal, points, weight, what)
        covariance = np.asarray(np.linalg.inv(normal), np.float64)
    taken = weight[:, None] * np.einsum("nij,jk,nik->ni", jacobian, covariance, jacobian)
    redundancy = np.where(np.abs(jacobian).sum(axis=2) > 0, 1 - taken, 0.0)
    fit = SimilarityFit(similarity, covariance, center, weight, whitened, redundancy)
    _check_angles(fit, points, what)
    return fit


def _check_points(points: Correspondences, what: str) -> None:
    count = len(points)
    if count < 3:
        raise InputError(f"expected at least 3 {what} to place the model, found {count}")
    known = ~np.isnan(points.target[:, 2])
    if not known.any():
        raise InputError(
            f"expected {what} with a height, found 0: the height of the model is undetermined"
        )
    level = np.where(known, points.target[:, 2], points.target[known, 2].mean())
    for cloud in (points.source, np.column_stack([points.target[:, :2], level])):
        spread = np.linalg.svd(cloud - cloud.mean(axis=0), compute_uv=False)
        if spread[1] <= THINNEST * spread[0]:
            raise InputError(_on_a_line(what, count))


def _on_a_line(what: str, count: int) -> str:
    return (
        f"the {count} {what} lie on one line: expected one beside it, because the "
        "model could rotate about the line"
    )


def _check_normal(normal: Array, points: Correspondences, weight: Array, what: str) -> None:
    """Refuse points that leave a degree of freedom undetermined to first order."""
    diagonal = np.sqrt(np.diag(normal))
    scaled = normal / np.outer(diagonal, diagonal)
    if np.isfinite(scaled).all() and np.linalg.cond(scaled) < WORST_CONDITION:
        return
    if (weight == 0).any():
        raise InputError(
            f"the loss leaves {int((weight > 0).sum())} of {len(points)} {what}, which do "
            "not determine the model: expected a larger scale of the loss, or another loss"
        )
    known = int((~np.isnan(points.target[:, 2])).sum())
    if known < len(points):
        raise InputError(
            f"only {known} of {len(points)} {what} have a known height, so the tilt or the "
            "height of the model is undetermined; expected 3 with a height, not on one line"
        )
    raise InputError(_on_a_line(what, len(points)))


def _check_angles(fit: SimilarityFit, points: Correspondences, what: str) -> None:
    """Refuse points that lie on one line within their sigmas and residuals."""
    # Use the sigmas estimated from the residuals if they are smaller.
    sigma0 = 1.0 if math.isnan(fit.sigma0) else min(max(fit.sigma0, LEAST_SIGMA0), 1.0)
    # information of the rotation with the other parameters free
    known = np.linalg.inv(fit.covariance[1:4, 1:4])
    information = min(
        np.linalg.eigvalsh(rotation)[0]
        for rotation in (known, known + _bending(fit, points), _known_of_target(fit, points))
    )
    angle = sigma0 / math.sqrt(information) if information > 0 else math.inf
    if angle > WIDEST_ANGLE:
        raise InputError(
            f"the {len(points)} {what} determine a rotation of the model only to "
            f"{math.degrees(min(angle, math.pi)):.3g} degrees (one sigma), expected at most "
            f"{math.degrees(WIDEST_ANGLE):.0f}: within their sigmas they lie on one line"
        )


def _known_of_target(fit: SimilarityFit, points: Correspondences) -> Array:
    """Return the rotation information if the surveyed points rotate instead of the model.

    If the model is wide and the surveyed points lie on a line, they do not fit each other. If the
    coordinate with the largest sigma is perpendicular to the line, the fit puts the model's width
    along this coordinate. The rotation about the line then seems to be determined, although the
    line leaves it free.
    """
    moved = fit.similarity.apply(points.source) + points.offset @ fit.similarity.rotation.T
    target = np.where(np.isnan(points.target), moved, points.target)
    middle = np.average(target, axis=0, weights=np.maximum(fit.weight, np.finfo(float).tiny))
    unmoved = Similarity(1.0, np.eye(3), np.zeros(3))
    root, _, _ = _whitened(fit.similarity, points, fit.center)
    turned = root @ _jacobian(unmoved, Correspondences(target, target, root), middle)[:, :, 1:]
    normal, _ = _normal(turned, np.zeros(target.shape), fit.weight)
    rotation, both, translation = normal[:3, :3], normal[:3, 3:], normal[3:, 3:]
    known: Array = rotation - both @ np.linalg.solve(translation, both.T)
    return known


def _bending(fit: SimilarityFit, points: Correspondences) -> Array:
    """Return the contribution of residuals to the (3, 3) second derivatives w.r.t. the rotation.

    A rotation w moves y to y + w x y + w x (w x y) / 2, so that the weighted residuals add

        (g y^T + y g^T) / 2 - (g . y) I,    g = S^-1 r,

    to J^T S^-1 J, which contains only the width of the model's points. If their targets have no
    width, g . y cancels it.
    """
    root, whitened, _ = _whitened(fit.similarity, points, fit.center)
    pull = np.einsum("nij,ni->nj", root, fit.weight[:, None] * whitened)
    scaled = fit.similarity.scale * (points.source - fit.center) + points.offset
    product = pull.T @ (scaled @ fit.similarity.rotation.T)
    bending: Array = (product + product.T) / 2 - np.trace(product) * np.eye(3)
    return bending


def _start(points: Correspondences) -> Similarity:
    known = ~np.isnan(points.target[:, 2])
    target = points.target.copy()
    if known.all():
        return umeyama(points.source, target)
    target[~known, 2] = target[known, 2].mean()
    similarity = umeyama(points.source, target)
    for _ in range(MAX_STEPS):
        target[~known, 2] = similarity.apply(points.source)[~known, 2]
        similarity = umeyama(points.source, target)
    return similarity


def _residuals(similarity: Similarity, points: Correspondences) -> Array:
    moved = similarity.apply(points.source) + points.offset @ similarity.rotation.T
    residual: Array = moved - points.target
    return residual


def _covariances(similarity: Similarity, points: Correspondences) -> Array:
    turned = similarity.rotation @ points.source_covariance @ similarity.rotation.T
    covariances: Array = points.target_covariance + similarity.scale**2 * turned
    return covariances


def _jacobian(similarity: Similarity, points: Correspondences, center: Array) -> Array:
    """Return (n, 3, 7) by log scale, rotation and translation at the center."""
    scaled = similarity.scale * (points.source - center) @ similarity.rotation.T
    x, y, z = (scaled + points.offset @ similarity.rotation.T).T
    jacobian = np.zeros((len(points), 3, 7))
    jacobian[:, :, 0] = scaled
    jacobian[:, 0, 2], jacobian[:, 0, 3] = z, -y
    jacobian[:, 1, 1], jacobian[:, 1, 3] = -z, x
    jacobian[:, 2, 1], jacobian[:, 2, 2] = y, -x
    jacobian[:, :, 4:] = np.eye(3)
    return jacobian


def _whitened(
    similarity: Similarity, points: Correspondences, center: Array
) -> tuple[Array, Array, Array]:
    """Return the inverse Cholesky factors, whitened residuals and whitened Jacobians."""
    unknown = np.isnan(points.target[:, 2])
    root = np.linalg.inv(np.linalg.cholesky(_covariances(similarity, points)))
    # The factor is lower triangular: east and north are whitened without the height.
    root[unknown, 2] = 0.0
    residual = np.nan_to_num(_residuals(similarity, points))
    whitened = np.einsum("nij,nj->ni", root, residual)
    return root, whitened, root @ _jacobian(similarity, points, center)


def _weights(whitened: Array, loss: str, loss_scale: float) -> Array:
    squared = (whitened**2).sum(axis=1)
    if not np.isfinite(squared).all():
        raise OverflowError
    weights: Array = evaluate_loss(loss, loss_scale, squared)[:, 1]
    return weights


def _normal(jacobian: Array, whitened: Array, weight: Array) -> tuple[Array, Array]:
    weighted = weight[:, None, None] * jacobian
    return (
        np.einsum("nij,nik->jk", weighted, jacobian),
        np.einsum("nij,ni->j", weighted, whitened),
    )


def _stepped(
    similarity: Similarity,
    points: Correspondences,
    center: Array,
    step: Array,
    root: Array,
    weight: Array,
) -> tuple[Similarity, float]:
    """Return the similarity after the step, or after a fraction of it that lowers the cost."""

    def cost(at: Similarity) -> float:
        whitened = np.einsum("nij,nj->ni", root, np.nan_to_num(_residuals(at, points)))
        return float((weight[:, None] * whitened**2).sum())

    before, share = cost(similarity), 1.0
    while share > 1e-9:
        after = _moved(similarity, center, share * step)
        if cost(after) <= before * (1 + 1e-12):
            return after, share
        share /= 4
    return similarity, 0.0


def _moved(similarity: Similarity, center: Array, step: Array) -> Similarity:
    scale = similarity.scale * math.exp(min(max(step[0], -1.0), 1.0))
    turn = rotation_matrices(quaternion_from_vector(step[None, 1:4]))[0]
    rotation = turn @ similarity.rotation
    middle = similarity.apply(center[None])[0] + step[4:]
    u, _, vt = np.linalg.svd(rotation)
    rotation = u @ vt
    return Similarity(scale, rotation, middle - scale * rotation @ center)


@dataclass(frozen=True)
class Correspondences:
    """Points of a model and their surveyed positions."""

    source: Array  # (n, 3) in the model
    target: Array  # (n, 3) east, north, up [m]; up is nan if unknown
    target_covariance: Array  # (n, 3, 3) [m^2]
    # (n, 3, 3) in squared units of the model; zero by default
    source_covariance: Array = field(default_factory=lambda: np.zeros(0))
    # (n, 3) vector from the point of the model to the surveyed point, in metres along the axes of
    # the model; zero by default
    offset: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        count = len(self.source)
        for name, shape in (("source_covariance", (count, 3, 3)), ("offset", (count, 3))):
            if getattr(self, name).size == 0:
                object.__setattr__(self, name, np.zeros(shape))

    def __len__(self) -> int:
        return len(self.source)

    def rows(self, chosen: NDArray[Any]) -> Correspondences:
        """Return the chosen rows as new correspondences."""
        return Correspondences(
            self.source[chosen],
            self.target[chosen],
            self.target_covariance[chosen],
            self.source_covariance[chosen],
            self.offset[chosen],
        )

    @staticmethod
    def joined(first: Correspondences, second: Correspondences) -> Correspondences:
        """Return the concatenation of two sets of correspondences."""
        return Correspondences(
            np.concatenate([first.source, second.source]),
            np.concatenate([first.target, second.target]),
            np.concatenate([first.target_covariance, second.target_covariance]),
            np.concatenate([first.source_covariance, second.source_covariance]),
            np.concatenate([first.offset, second.offset]),
        )
