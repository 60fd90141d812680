"""Movement between two models in sigmas of the covariance of the first.

The movement of a single pose means nothing: a similarity of the world is free. Relative poses do
not depend on it, except for their length. So the pose of image i is compared relative to other
images, the anchors r. With T = cam_i_from_cam_r in A and B, the change

    d = (w, t_B - t_A),  R_B = Exp(w) R_A,

has the covariance C of the relative pose in A, which holds with all other parameters estimated, and
for any gauge. If the scale is free, t_B is scaled to the length of t_A, and the direction of t_A is
left out of d and C. If rigs determine the scale, all six coordinates count, and a difference of
scale is a movement like any other. Then

    m_ir^2 = d^T C^+ d / rank(C),

is 1 for a movement by one sigma, and m_i is the median of m_ir over the anchors: one anchor that
moved itself has no influence. C is that of the weights of the loss, scaled by sigma0^2: without a
loss, the residuals of A per degree of freedom; under a loss, the median ratio of the variances of
poses in the sandwich covariance (``cpp/core/covariance/sandwich.h``) to those of the weights.
Residuals alone do not determine this scale: the loss downweights large ones, and few rays per point
make residuals small. If B is the truth, the mean of m_i^2 is about 1 if the covariance is right.
Points, and images that B lacks, have no influence.

The covariance depends on what the solve of A refined, which no file records. At a minimum over a
parameter, a step along it does not lower the cost; for a constant parameter the expected decrease
is half of sigma0^2. So if the movement exceeds the default uncertainty, a solve from A also refines
principal points and sensors. If it lowers the cost by less than 0.025 sigma0^2, they were refined;
one of twenty models with a constant principal point is mistaken for such a one.

Images of one frame of a rig have a constant relative pose, with C = 0; such pairs are ignored.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.uncertainty.covariance_by_input import Recipe, covariance
from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.georeference.pose_alignment import align_centers
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.model.rigid_motions import (
    inverse_poses,
    multiply_poses,
    quaternion_inverse,
    quaternion_multiply,
    unit_poses,
    vector_from_quaternion,
)
from bundle.solving.executors import solve_prepared
from bundle.solving.gauge_freedom import gauge_freedom
from bundle.solving.prepare import prepare
from bundle.solving.request import SolveRequest

ANCHORS = 5
RANK = 1e-12  # eigenvalues of a scaled covariance below this are rounding errors

NOT_CONVERGED = "Not converged"
"""Beginning of the note of a covariance away from the minimum (``base.words.not_converged``)."""

REFINED, FEW_STEPS = 0.025, 5
"""Decrease of the cost in sigma0^2 below which a parameter is at its minimum, and steps to it."""
SAME_SCALE = 1.2  # largest ratio of lengths of models with the same metric scale

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class SigmaMovement:
    """Movement of each shared image in sigmas of the covariance of A."""

    sigmas: Array  # (n,) m_i; NaN for an image without a covariance
    sigma0: float  # scale of the covariance in pixels
    is_minimum: bool  # False if a step would lower the cost of A under the loss
    notes: tuple[str, ...]  # remarks on the covariance
    # parameters that were assumed to be constant, such as "the principal point"; "": nothing
    # depends on it
    assumed: str = ""
    loss: str = "trivial"  # loss of the solve of A

    @property
    def median(self) -> float:
        """Median over the images; NaN without a covariance."""
        known = self.sigmas[np.isfinite(self.sigmas)]
        return float(np.median(known)) if len(known) else np.nan

    @property
    def largest(self) -> float:
        """Largest movement; NaN without a covariance."""
        known = self.sigmas[np.isfinite(self.sigmas)]
        return float(known.max()) if len(known) else np.nan


def movement_in_sigmas(
    a: Problem, b: Problem, rows_a: Indices, rows_b: Indices, solved: SolveOptions
) -> SigmaMovement:
    """Return the movement of the shared images, whose rows are (n,).

    `solved` has the loss of the solve of A; what it refined is found here.
    """
    held = _movement(a, b, rows_a, rows_b, solved)
    if not held.is_minimum or not held.median > 1:
        return held
    assumed = "the principal point"
    changes: dict[str, Any] = {"refine": (*solved.refine, "principal_point")}
    choices = [(assumed, changes)]
    if a.num_sensors:
        sensors = {"refine_sensor_from_rig": True}
        assumed = "principal point and sensors on rigs"
        choices = [("sensors on rigs", sensors), *choices, (assumed, changes | sensors)]
    for what, more in choices:
        options = solved.replace(**more)
        try:
            if _decrease(a, options) > REFINED * held.sigma0**2:
                continue
            found = _movement(a, b, rows_a, rows_b, options)
        except InputError:  # not determined by the images
            continue
        note = f"A is at a minimum over {what}, too: it counts as refined."
        return replace(found, notes=(*found.notes, note))
    return replace(held, assumed=assumed)


def _decrease(problem: Problem, options: SolveOptions) -> float:
    """Return the decrease of the cost by the first steps of a solve."""
    few = options.replace(max_num_iterations=FEW_STEPS, check_solution=False)
    summary = solve_prepared(prepare(SolveRequest(problem=problem, options=few)), None).summary
    return summary.initial_cost - summary.final_cost


def _movement(
    a: Problem, b: Problem, rows_a: Indices, rows_b: Indices, options: SolveOptions
) -> SigmaMovement:
    """Return the movement if the solve of A refined the parameters of the options."""
    is_metric = bool(a.num_frames) and gauge_freedom(a, options).degrees < 7
    if is_metric:
        _check_scale(a, b, rows_a, rows_b)
    count = len(rows_a)
    anchors = np.unique(np.linspace(0, count - 1, min(count, ANCHORS)).round().astype(np.int64))
    first, second = (grid.ravel() for grid in np.meshgrid(anchors, np.arange(count)))
    first, second = first[first != second], second[first != second]
    ids = a.image_ids[rows_a]
    pairs = list(zip(ids[first].tolist(), ids[second].tolist(), strict=True))
    found = covariance(a, options, of=("poses",), relative=pairs, gauge="inner")
    sigma0 = found.sigma0 if options.loss == "trivial" else _scale_under_loss(a, options)
    change, length = _changes(
        unit_poses(a.cam_from_world[rows_a]), unit_poses(b.cam_from_world[rows_b]),
        first, second, is_metric=is_metric,
    )  # fmt: skip
    blocks = sigma0**2 * np.asarray(found.relative_covariance)
    if not is_metric:
        change, blocks = _across(change, blocks, length)
    table = np.full((count, len(anchors)), np.nan)
    table[second, np.searchsorted(anchors, first)] = _mahalanobis(change, blocks)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # images without a covariance have NaN only
        sigmas = np.nanmedian(table, axis=1)
    is_minimum = not any(note.startswith(NOT_CONVERGED) for note in found.notes)
    notes = [
        f"Covariance of A: {note[0].lower()}{note[1:]}"
        for note in found.notes
        if not note.startswith(NOT_CONVERGED)  # its advice names flags of other commands
    ]
    return SigmaMovement(sigmas, sigma0, is_minimum, tuple(notes), loss=options.loss)


def _scale_under_loss(problem: Problem, options: SolveOptions) -> float:
    """Return sigma0 under a loss in pixels, from the poses of the sandwich."""
    request = SolveRequest(problem=problem, options=options.replace(gauge="two_cameras"))
    sandwich, weights = (
        np.diagonal(recipe.compute([]).pose_covariance, axis1=1, axis2=2)
        for recipe in (
            Recipe(request, ("poses",), "two_cameras", "unit", robust, long_sums=False)
            for robust in ("sandwich", "weights")
        )
    )
    known = np.isfinite(sandwich) & (weights > 0)
    return float(np.sqrt(np.median(sandwich[known] / weights[known])))


def _check_scale(a: Problem, b: Problem, rows_a: Indices, rows_b: Indices) -> None:
    scale = align_centers(a.projection_centers[rows_a], b.projection_centers[rows_b]).scale
    if not 1 / SAME_SCALE < scale < SAME_SCALE:
        raise InputError(
            "the rigs of A determine its scale, but lengths of A and B differ by a factor of "
            f"{scale:.4g}"
        )


def _changes(
    poses_a: Array, poses_b: Array, first: Indices, second: Indices, *, is_metric: bool
) -> tuple[Array, Array]:
    """Return the changes d (m, 6) of cam_second_from_cam_first, and t_A (m, 3)."""
    one, other = (
        multiply_poses(poses[second], inverse_poses(poses[first])) for poses in (poses_a, poses_b)
    )
    turn = quaternion_multiply(other[:, :4], quaternion_inverse(one[:, :4]))
    there = other[:, 4:]
    if not is_metric:
        lengths = np.linalg.norm(there, axis=1), np.linalg.norm(one[:, 4:], axis=1)
        there = there * (lengths[1] / np.where(lengths[0] > 0, lengths[0], 1.0))[:, None]
    return np.hstack([vector_from_quaternion(turn), there - one[:, 4:]]), one[:, 4:]


def _across(change: Array, blocks: Array, along: Array) -> tuple[Array, Array]:
    """Return changes (m, 5) and covariances without the direction of the translation."""
    length = np.linalg.norm(along, axis=1)
    axis = np.where(
        (length > 0)[:, None], along / np.where(length > 0, length, 1)[:, None], [1.0, 0, 0]
    )
    # The rows of a basis across the axis: the two right singular vectors that are not the axis.
    across = np.linalg.svd(axis[:, None, :])[2][:, 1:]
    basis = np.zeros((len(axis), 5, 6))
    basis[:, :3, :3], basis[:, 3:, 3:] = np.eye(3), across
    reduced = basis @ blocks @ np.swapaxes(basis, 1, 2)
    return np.einsum("nij,nj->ni", basis, change), reduced


def _mahalanobis(change: Array, blocks: Array) -> Array:
    """Return (m,) roots of d^T C^+ d / rank(C); NaN without a covariance."""
    result = np.full(len(change), np.nan)
    diagonal = np.sqrt(np.einsum("nii->ni", np.maximum(blocks, 0)))
    known = np.isfinite(blocks).all(axis=(1, 2)) & (diagonal > 0).all(axis=1)
    if not known.any():
        return result
    unit = diagonal[known]
    values, vectors = np.linalg.eigh(blocks[known] / (unit[:, :, None] * unit[:, None, :]))
    along = np.einsum("nij,ni->nj", vectors, change[known] / unit)
    counted = values > RANK * values.max(axis=1, keepdims=True)
    squared = np.where(counted, along**2 / np.where(counted, values, 1.0), 0.0)
    result[known] = np.sqrt(squared.sum(axis=1) / counted.sum(axis=1))
    return result
