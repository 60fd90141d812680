"""Alignment of a problem to priors of its images' positions, or to two positions if it is level.

A reconstruction has an arbitrary frame. A solve with priors that started there would have to
rotate, scale and move the entire model by thousands of sigmas. A trust region does this in small
steps, if it succeeds. Therefore the problem is first moved by the similarity that the positions
determine robustly. The minimum does not depend on this motion.
"""

from __future__ import annotations

import cmath
import dataclasses
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.errors import InputError, brief
from bundle.georeference.measurements import FoundPriors
from bundle.georeference.point_check import PositionOffset
from bundle.georeference.similarity import Similarity, agreeing, moved
from bundle.georeference.similarity_fit import WIDEST_ANGLE, Correspondences, fit_similarity
from bundle.georeference.target_priors import TargetPriors
from bundle.georeference.text_lines import rows_of_images
from bundle.georeference.vector_priors import PositionPrior
from bundle.graphs.factors.factors import Factor, PositionFactor
from bundle.graphs.factors.variables import as_list
from bundle.interface.georeference_options import ROBUST_SCALE
from bundle.model.problem import Problem
from bundle.model.rigid_motions import rotation_matrices

Array = NDArray[np.float64]

FEWEST = 3
NOT_COUNTING = 1e50  # standard deviation beyond which a coordinate counts as unknown


@dataclass(frozen=True)
class ProblemPriors(FoundPriors):
    """Priors of image positions, and their images in a problem."""

    priors: tuple[PositionPrior, ...]  # priors in the order given
    rows: NDArray[np.int64]  # (n,) index of each prior's image
    image_ids: tuple[int, ...]  # n ids of these images
    offset: PositionOffset | None = None  # offset that some have in common; None without

    @staticmethod
    def make(problem: Problem, priors: Iterable[PositionPrior]) -> ProblemPriors:
        """Find the image of each prior."""
        given = _listed(priors)
        found_rows = rows_of_images(problem, given)
        ids = tuple(problem.image_ids[found_rows].tolist())
        asked = {prior.offset for prior in given} - {"none"}
        axes = "all" if "all" in asked else "up"
        offset = PositionOffset.beside(problem, axes) if asked else None
        return ProblemPriors(given, found_rows, ids, offset)

    def factors(self, problem: Problem) -> list[PositionFactor]:  # noqa: ARG002
        """Return a factor for each prior, in order."""
        factors = []
        for prior, image_id in zip(self.priors, self.image_ids, strict=True):
            factor = prior.factor(image_id)
            if self.offset is not None and prior.offset != "none":
                factor = self.offset.of(factor, prior.offset)
            factors.append(factor)
        return factors

    def last_factors(self) -> list[Factor]:
        """Return priors that fix the unused coordinates of the offset's pose."""
        return [] if self.offset is None else self.offset.factors()

    def added_to(self, problem: Problem, moved: Similarity | None) -> Problem:  # noqa: ARG002
        """Return the problem with the pose of the offset, if there is one."""
        if self.offset is None:
            return problem
        return self.offset.added_to(problem, self.typical_offset(problem))

    def taken_from(self, problem: Problem) -> Problem:
        """Remove the pose of the offset from a problem after a solve or filter."""
        return problem if self.offset is None else self.offset.taken_from(problem)

    def check(self, problem: Problem, groups: Sequence[FoundPriors]) -> None:  # noqa: ARG002
        """Raise an InputError if nothing determines the offset of positions."""
        if self.offset is None or any(prior.offset == "none" for prior in self.priors):
            return  # other positions determine it
        used = [one for group in groups if isinstance(group, TargetPriors) for one in group.used]
        if not used:
            raise InputError(
                "gps_offset: expected control points in the model, which determine the offset of "
                "the positions, found 0"
            )
        if all(np.isnan(entry.point.position[2]) for entry in used):
            raise InputError(
                "gps_offset: expected a control point with a height, which determines the offset "
                f"of the positions, found {len(used)} points without a height"
            )

    def typical_offset(self, problem: Problem) -> Array:
        """Return the median (3,) of positions with an offset minus the model; 0 if unknown."""
        chosen = [prior.offset != "none" for prior in self.priors]
        away = -self.residuals(problem)[chosen]
        known = np.isfinite(away).any(axis=0)
        found = np.zeros(3)
        found[known] = np.nanmedian(away[:, known], axis=0)
        return found

    def residuals(self, problem: Problem, offset: Array | None = None) -> Array:
        """Return (n, 3) positions in the problem minus measured positions; nan if unknown.

        ``offset``: (3,) offset of the positions from the problem; None: 0.
        """
        if not self.priors:
            return np.zeros((0, 3))
        antennas = problem.projection_centers[self.rows] + self._levers(problem)
        residuals: Array = antennas - self._positions()
        return residuals if offset is None else residuals + offset

    def sigmas(self, problem: Problem, offset: Array | None = None) -> Array:
        """Return (n,) lengths of the residuals in standard deviations."""
        pairs = zip(self.priors, self.residuals(problem, offset), strict=True)
        return np.array([np.linalg.norm(prior.whiten(row)) for prior, row in pairs])

    def align(self, problem: Problem) -> Similarity:
        """Return the similarity from the frame of the problem to the frame of the priors.

        See :func:`robust_similarity`.
        """
        if len(self.priors) < FEWEST:
            raise InputError(
                f"expected positions of at least {FEWEST} images to place the model, found "
                f"{len(self.priors)}"
            )
        return robust_similarity(self.correspondences(problem), "positions of images")

    def correspondences(self, problem: Problem) -> Correspondences:
        """Return positions of images in the problem and in the priors; up is nan if unknown."""
        if not self.priors:
            return Correspondences(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3)))
        target = self._positions()
        covariance = np.array([prior.full_covariance for prior in self.priors])
        unknown = np.isnan(target[:, 2]) | (covariance[:, 2, 2] >= NOT_COUNTING**2)
        target[unknown, 2] = np.nan
        source = problem.projection_centers[self.rows]
        return Correspondences(source, target, covariance, offset=self._levers(problem))

    def aligned(self, problem: Problem) -> tuple[Problem, Similarity]:
        """Return the problem in the frame of the priors, and the similarity of :meth:`align`."""
        similarity = self.align(problem)
        return moved(problem, similarity), similarity

    def _positions(self) -> Array:
        return np.array([prior.position for prior in self.priors], dtype=np.float64)

    def _levers(self, problem: Problem) -> Array:
        """Return the (n, 3) vectors from camera to antenna along the axes of the world."""
        rotations = rotation_matrices(problem.cam_from_world[self.rows, :4])
        levers = np.array([prior.lever_arm for prior in self.priors], dtype=np.float64)
        along: Array = np.einsum("nji,nj->ni", rotations, levers)
        return along


def placement(problem: Problem, groups: Sequence[FoundPriors]) -> Similarity | None:
    """Return the similarity to priors; without positions, the motion that the others require.

    If positions are on a line, priors with a vertical determine the rotation about it.

    Raises:
        InputError: the priors do not determine the similarity.
    """
    moving = [one for one in groups if one.moves]
    if moving and not any(isinstance(one, ProblemPriors | TargetPriors) for one in groups):
        return _motion(problem, moving)
    known, targets = _survey(problem, groups)
    try:
        return _similarity(problem, known, targets)
    except InputError:
        upright = next((one for one in groups if one.has_vertical), None)
        if upright is None:
            raise
    turned = upright.placement(problem)
    rotation = np.eye(3) if turned is None else turned.rotation
    return level_similarity(survey_points(problem, groups), rotation)


def survey_points(problem: Problem, groups: Sequence[FoundPriors]) -> Correspondences:
    """Return control points, then positions of images, in the problem and in the priors."""
    known, targets = _survey(problem, groups)
    points = known.correspondences(problem)
    return points if targets is None else Correspondences.joined(targets.correspondences(), points)


def _survey(
    problem: Problem, groups: Sequence[FoundPriors]
) -> tuple[ProblemPriors, TargetPriors | None]:
    known = next((one for one in groups if isinstance(one, ProblemPriors)), None)
    targets = next((one for one in groups if isinstance(one, TargetPriors)), None)
    return ProblemPriors.make(problem, ()) if known is None else known, targets


def _motion(problem: Problem, groups: Sequence[FoundPriors]) -> Similarity | None:
    """Return the composition of the motions that the groups require."""
    total: Similarity | None = None
    for group in groups:
        found = group.placement(problem if total is None else moved(problem, total))
        if found is not None:
            total = found if total is None else found.after(total)
    return total


def _similarity(problem: Problem, known: ProblemPriors, targets: TargetPriors | None) -> Similarity:
    if targets is None or not targets.used:
        return known.align(problem)
    if any(prior.offset != "none" for prior in known.priors):
        return _similarity_beside_offset(problem, known, targets)
    count = len(targets.used) + len(known.priors)
    if count < FEWEST:
        raise InputError(
            f"expected at least {FEWEST} control points and positions of images to place the "
            f"model, found {count}"
        )
    joined = Correspondences.joined(targets.correspondences(), known.correspondences(problem))
    what = "control points and positions of images"
    losses = {entry.point.loss for entry in targets.used} | {prior.loss for prior in known.priors}
    if losses == {"trivial"}:
        # A few priors against thousands of pixels move the model slowly. A solve that starts at
        # the least-squares fit to the priors avoids this motion.
        try:
            return fit_similarity(joined, what=what).similarity
        except InputError:
            pass
    return robust_similarity(joined, what)


def _similarity_beside_offset(
    problem: Problem, known: ProblemPriors, targets: TargetPriors
) -> Similarity:
    """Return the similarity to control points, whose positions have no offset.

    If they do not determine it, positions of images give scale and rotation.
    """
    points = targets.correspondences()
    try:
        return fit_similarity(points, what="control points").similarity
    except InputError:
        turned = known.align(problem)
    missing = points.target - turned.apply(points.source)
    known_axes = np.isfinite(missing).any(axis=0)
    shift = np.zeros(3)
    shift[known_axes] = np.nanmean(missing[:, known_axes], axis=0)
    return Similarity(turned.scale, turned.rotation, turned.translation + shift)


def robust_similarity(points: Correspondences, what: str) -> Similarity:
    """Return the similarity that most of the points agree on.

    Points that contradict the majority are ignored. With fewer than three known heights, or
    heights that do not determine the tilt, all points are assumed to have one height.

    ``points``: at least three points.
    """
    target, covariance = points.target, points.target_covariance.copy()
    unknown = np.isnan(target[:, 2])
    known_heights = target[~unknown, 2]
    level = target.copy()
    level[unknown, 2] = np.median(known_heights) if len(known_heights) else 0.0
    scales = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    chosen = agreeing(points.source, level, scales)
    if unknown.any():
        try:
            return _fit(points.rows(chosen), what)
        except InputError:
            horizontal = covariance[:, 0, 0]
            covariance[unknown] = horizontal[unknown, None, None] * np.eye(3)
            points = dataclasses.replace(points, target=level, target_covariance=covariance)
    return _fit(points.rows(chosen), what)


def _fit(points: Correspondences, what: str) -> Similarity:
    return fit_similarity(points, loss="cauchy", loss_scale=ROBUST_SCALE, what=what).similarity


def _listed(priors: Any) -> tuple[PositionPrior, ...]:
    given = as_list("priors", "PositionPriors", priors)
    for position, prior in enumerate(given):
        if not isinstance(prior, PositionPrior):
            raise InputError(
                f"priors: expected PositionPriors, found {brief(prior)} at [{position}]"
            )
    return given


# Similarity of a model whose vertical is known, from as few as two surveyed positions.
#
# Positions on a line, such as those of a straight street, leave the turn of a model about the line
# free. Measured gravity determines it. With z up in both frames, a similarity has the scale s, a
# turn a about z and a translation. For centred points, p_i and q_i their horizontal parts as
# complex numbers, u_i and v_i their heights, least squares give
#
#     a = arg sum conj(p_i) q_i,    s = (|sum conj(p_i) q_i| + sum u_i v_i) / sum (|p_i|^2 + u_i^2).
#
# Unknown heights are ignored. Lever arms, which are short beside the line, are left to the solve.


def level_similarity(points: Correspondences, upright: Array) -> Similarity:
    """Return the similarity whose rotation is a rotation about z after `upright`.

    ``upright``: (3, 3) rotation of the model to z up.
    """
    known = ~np.isnan(points.target[:, 2])
    if not known.any():
        raise InputError("expected a position with a height, found 0")
    source = points.source @ upright.T
    middle, goal = source.mean(axis=0), points.target.mean(axis=0)
    middle[2], goal[2] = source[known, 2].mean(), points.target[known, 2].mean()
    p, q = ((v - m)[:, :2] @ [1, 1j] for v, m in ((source, middle), (points.target, goal)))
    u, v = source[known, 2] - middle[2], points.target[known, 2] - goal[2]
    variance = np.trace(points.target_covariance[:, :2, :2], axis1=1, axis2=2) / 2
    information = float((np.abs(q) ** 2 / variance).sum())
    both, heights = complex(np.vdot(p, q)), float(u @ v)
    scale = (abs(both) + heights) / max(float((np.abs(p) ** 2).sum() + u @ u), 1e-300)
    if not (information * WIDEST_ANGLE**2 > 1 and scale > 0 and abs(both) > 0):
        raise InputError(
            f"expected positions that determine scale and heading, found {len(points)} within "
            f"their sigmas at one place"
        )
    turn = cmath.phase(both)
    c, s = math.cos(turn), math.sin(turn)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ upright
    return Similarity(scale, rotation, goal - scale * rotation @ (upright.T @ middle))
