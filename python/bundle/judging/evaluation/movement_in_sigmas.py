"""SigmaMovement between two models in sigmas of the covariance of the first.

Let d_i = (w_i, t_i) be the change of the pose of image i from A to B in the coordinates of the
covariance: R_B = Exp(w) R_A and the difference of the translations of cam_from_world, with B moved
into the world of A. The length of d_i means nothing by itself, because a similarity of the world is
free. The covariance C of A under inner constraints belongs to changes d that are orthogonal to
these similarities over all poses and points, N^T d = 0 (``cpp/core/covariance/free_gauge.h``). So B
is moved by the similarity that makes its changes orthogonal to them, too. It minimises

    sum |w_i|^2 + |t_i|^2  over poses  +  sum |x_B - x_A|^2  over points,

by Gauss-Newton from the alignment of the centres. With x' = x + u + o x x + l x for a small
similarity (o, u, l) of the world, the rows of N are

    w = -R o,    t = -R u + l t,    x = -[x]x o + u + l x.

Then m_i^2 = d_i^T C_ii^+ d_i / rank(C_ii), and m_i = 1 is a movement by one sigma. C is scaled by
the residuals of A (sigma0). If B is the truth, m_i is about 1 if the covariance is right.

The gauge is exact if the models share all images and points. If B lacks some, the similarity and
the covariance refer to different sets, and m_i is an approximation. Points without parallax are
left out, as in the covariance. Models with rigs are refused: their covariance is that of frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.uncertainty.compute_covariance import covariance
from bundle.errors import InputError
from bundle.georeference.pose_alignment import moved_poses
from bundle.georeference.similarity import Similarity
from bundle.model.pose_table import PoseTable
from bundle.model.problem import Problem
from bundle.model.rigid_motions import inverse_poses, unit_poses
from bundle.model.rotations import (
    cross_matrices,
    quaternion_from_vector,
    quaternion_inverse,
    quaternion_multiply,
    rotation_matrices,
    vector_from_quaternion,
)

__all__ = ["SigmaMovement", "movement_in_sigmas"]

MAX_ITERATIONS = 50
SMALLEST_STEP = 1e-12
RANK = 1e-12
"""Eigenvalues of a scaled covariance below this are rounding errors."""

NEARLY_ALL = 0.95
"""Share of images and of points of A from which the gauge counts as the same."""

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class SigmaMovement:
    """SigmaMovement of each shared image in sigmas of the covariance of A.

    Attributes:
        sigmas: (n,) m_i; NaN for an image without a covariance.
        sigma0: root of the mean squared residual of A per degree of freedom in pixels.
        notes: remarks on the covariance.
    """

    sigmas: Array
    sigma0: float
    notes: tuple[str, ...]

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
    a: Problem, b: Problem, rows_a: Indices, rows_b: Indices, pairs: Indices, start: Similarity
) -> SigmaMovement:
    """Return the movement of the shared images.

    Args:
        a: the first model, at its minimum.
        b: the second model.
        rows_a: (n,) indices of the shared images in A.
        rows_b: (n,) their indices in B.
        pairs: (m, 2) indices of shared points of A and B.
        start: similarity from A to B.

    Raises:
        InputError: A has rigs, or no covariance.
    """
    if a.num_frames:
        raise InputError("A has rigs, of which sigmas are not computed")
    found = covariance(a, of=("poses",), gauge="inner", scale="sigma0")
    notes = [f"Covariance of A: {note[0].lower()}{note[1:]}" for note in found.notes]
    usable = ~np.isin(a.point_ids[pairs[:, 0]], found.null_point_ids)
    pairs = pairs[usable]
    if len(rows_a) < NEARLY_ALL * a.num_images or len(pairs) < NEARLY_ALL * a.num_points:
        notes.append(
            f"Sigmas are approximate: the models share {len(rows_a)} of {a.num_images} images and "
            f"{len(pairs)} of {a.num_points} points of A."
        )
    poses = unit_poses(a.cam_from_world[rows_a])
    points = a.points[pairs[:, 0]]
    other_poses = PoseTable.of_problem(b).poses[rows_b]
    change = _change(poses, points, other_poses, b.points[pairs[:, 1]], start)
    lookup = {int(image): row for row, image in enumerate(found.pose_ids.tolist())}
    blocks = np.array([found.pose_covariance[lookup[int(k)]] for k in a.image_ids[rows_a]])
    return SigmaMovement(_mahalanobis(change, blocks), found.sigma0, tuple(notes))


def _change(
    poses: Array, points: Array, other_poses: Array, other_points: Array, start: Similarity
) -> Array:
    """Return d_i of the poses (n, 6), with B moved so that N^T d = 0 over poses and points."""
    back = Similarity(
        1 / start.scale,
        start.rotation.T,
        -start.rotation.T @ start.translation / start.scale,
    )
    moved, places = moved_poses(other_poses, back), back.apply(other_points)
    for _ in range(MAX_ITERATIONS):
        change, misses = _differences(poses, moved), places - points
        normal, gradient = np.zeros((7, 7)), np.zeros(7)
        here = inverse_poses(moved)
        turns = rotation_matrices(here[:, :4])
        zero = np.zeros_like(turns)
        by_pose = np.concatenate(
            [
                np.concatenate([-turns, zero, np.zeros((len(here), 3, 1))], axis=2),
                np.concatenate([zero, -turns, here[:, 4:, None]], axis=2),
            ],
            axis=1,
        )
        normal += np.einsum("nij,nik->jk", by_pose, by_pose)
        gradient += np.einsum("nij,ni->j", by_pose, change)
        if len(places):
            by_point = np.concatenate(
                [
                    -cross_matrices(places),
                    np.broadcast_to(np.eye(3), (len(places), 3, 3)),
                    places[:, :, None],
                ],
                axis=2,
            )
            normal += np.einsum("nij,nik->jk", by_point, by_point)
            gradient += np.einsum("nij,ni->j", by_point, misses)
        unit = np.sqrt(np.diag(normal))
        step = -np.linalg.lstsq(normal / np.outer(unit, unit), gradient / unit)[0] / unit
        small = Similarity(
            float(np.exp(step[6])),
            rotation_matrices(quaternion_from_vector(step[None, :3]))[0],
            step[3:6],
        )
        moved, places = moved_poses(moved, small), small.apply(places)
        if float(np.abs(step * unit).max()) <= SMALLEST_STEP * float(unit.max()):
            break
    return _differences(poses, moved)


def _differences(poses: Array, moved: Array) -> Array:
    """Return (w, t) of cam_from_world of the moved poses against those of A."""
    other = inverse_poses(moved)
    turn = quaternion_multiply(other[:, :4], quaternion_inverse(poses[:, :4]))
    return np.hstack([vector_from_quaternion(turn), other[:, 4:] - poses[:, 4:]])


def _mahalanobis(change: Array, blocks: Array) -> Array:
    result = np.full(len(change), np.nan)
    diagonal = np.sqrt(np.einsum("nii->ni", blocks))
    known = np.isfinite(blocks).all(axis=(1, 2)) & (diagonal > 0).all(axis=1)
    unit = diagonal[known]
    values, vectors = np.linalg.eigh(blocks[known] / (unit[:, :, None] * unit[:, None, :]))
    along = np.einsum("nij,ni->nj", vectors, change[known] / unit)
    counted = values > RANK * values.max(axis=1, keepdims=True)
    squared = np.where(counted, along**2 / np.where(counted, values, 1.0), 0.0)
    result[known] = np.sqrt(squared.sum(axis=1) / counted.sum(axis=1))
    return result
