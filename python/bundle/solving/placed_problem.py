"""Start of a solve with priors: the problem in their frame, with its control points."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from bundle.base.arrays import as_flag
from bundle.errors import InputError, brief
from bundle.model.problem import Problem

if TYPE_CHECKING:
    from bundle.georeference.alignment_result import ControlPointError
    from bundle.georeference.attitude_priors import AttitudePrior
    from bundle.georeference.control_point import GroundControlPoint
    from bundle.georeference.position_offset import PositionOffset
    from bundle.georeference.prior_alignment import ProblemPriors
    from bundle.georeference.problem_attitudes import ProblemAttitudes
    from bundle.georeference.similarity import Similarity
    from bundle.georeference.target_priors import TargetPriors
    from bundle.georeference.vector_priors import PositionPrior, VelocityPrior
    from bundle.graphs.factors.factors import Factor

    Prior: TypeAlias = PositionPrior | GroundControlPoint | AttitudePrior | VelocityPrior

FEWEST = 3


class PlacedProblem(NamedTuple):
    """Problem at its priors.

    Attributes:
        problem: problem in the frame of the priors; control points are its last points.
        factors: all factors; those of the priors come last: positions, attitudes, control points,
            velocities.
        similarity: similarity by which the problem was moved, if it was moved.
        targets: control and check points, if there are any.
        offset: offset of measured positions, whose pose is the last image of `problem`.
    """

    problem: Problem
    factors: tuple[Factor, ...] = ()
    similarity: Similarity | None = None
    targets: TargetPriors | None = None
    offset: PositionOffset | None = None

    @property
    def control_point_ids(self) -> tuple[int, ...]:
        """Ids of the control points in the problem."""
        return () if self.targets is None else self.targets.point_ids

    def taken_from(self, problem: Problem) -> Problem:
        """Return a refined or filtered problem without the offset and the control points."""
        if self.offset is not None:
            problem = self.offset.taken_from(problem)
        return problem if self.targets is None else self.targets.taken_from(problem)

    def control_points(self, problem: Problem) -> tuple[ControlPointError, ...]:
        """Return the residuals of control and check points in the result."""
        return () if self.targets is None else self.targets.errors(problem)


def place_at_priors(
    problem: Problem,
    factors: tuple[Factor, ...],
    priors: tuple[Prior, ...],
    align: bool | None,
) -> PlacedProblem:
    """Move a problem to its priors, and add their factors and control points.

    Args:
        problem: problem to move; not modified.
        factors: factors in addition to the priors.
        priors: positions of images, and control points.
        align: move the problem to the priors; None: move it if `factors` is empty and the priors
            determine the similarity.

    Raises:
        InputError: see :func:`bundle.solve`.
    """
    if align is not None:
        align = as_flag("align", align)
    if not priors:
        if align:
            raise InputError("align: expected priors to align the problem to, found 0")
        return PlacedProblem(problem, factors)
    from bundle.georeference.prior_alignment import ProblemPriors
    from bundle.georeference.similarity import moved
    from bundle.georeference.target_priors import TargetPriors

    positions, attitudes, points, velocities = sorted_priors(priors)
    known = ProblemPriors.make(problem, positions)
    turned = _attitudes(problem, attitudes)
    targets = TargetPriors.make(problem, points) if points else None
    similarity = None
    if align or (align is None and not factors):
        try:
            similarity = _placement(problem, known, targets, turned)
        except InputError as error:
            if align:
                raise InputError(f"priors: {error}") from None
    start = problem if similarity is None else moved(problem, similarity)
    offset = known.offset_beside(problem)
    of_priors: list[Factor] = [*known.factors(offset)]
    if turned is not None:
        turned.check(start)
        of_priors += turned.factors()
    if targets is not None:
        start = targets.added_to(start, similarity)
        of_priors += targets.factors()
    if velocities:
        from bundle.georeference.velocities import ProblemVelocities  # few solves have any

        of_priors += ProblemVelocities.make(start, velocities).factors(start)
    if offset is not None:
        _check_offset(known, targets)
        start = offset.added_to(start, known.typical_offset(start))
        of_priors += offset.factors()
    return PlacedProblem(start, (*factors, *of_priors), similarity, targets, offset)


def _check_offset(known: ProblemPriors, targets: TargetPriors | None) -> None:
    """Raise an InputError if nothing determines the offset of positions."""
    used = () if targets is None else targets.used
    if any(prior.offset == "none" for prior in known.priors):
        return  # other positions determine it
    if not used:
        raise InputError(
            "gps_offset: expected control points in the model, which determine the offset of the "
            "positions, found 0"
        )
    if all(np.isnan(entry.point.position[2]) for entry in used):
        raise InputError(
            "gps_offset: expected a control point with a height, which determines the offset of "
            f"the positions, found {len(used)} without"
        )


def _attitudes(problem: Problem, priors: list[AttitudePrior]) -> ProblemAttitudes | None:
    if not priors:
        return None
    from bundle.georeference.problem_attitudes import ProblemAttitudes  # for these priors only

    return ProblemAttitudes.make(problem, priors)


def _placement(
    problem: Problem,
    known: ProblemPriors,
    targets: TargetPriors | None,
    turned: ProblemAttitudes | None,
) -> Similarity | None:
    """Return the similarity to the priors; without positions, the turn to the attitudes.

    Positions on a line leave the turn about it to the attitudes.

    Raises:
        InputError: the priors do not determine the similarity.
    """
    if turned is not None and not known.priors and targets is None:
        return turned.placement(problem)
    try:
        return _similarity(problem, known, targets)
    except InputError as error:
        if turned is None or not turned.has_vertical:
            raise
        try:
            return _levelled(problem, known, targets, turned)
        except InputError:
            raise error from None


def _levelled(
    problem: Problem,
    known: ProblemPriors,
    targets: TargetPriors | None,
    turned: ProblemAttitudes,
) -> Similarity:
    """Return the similarity to the priors with the vertical of the attitudes.

    Raises:
        InputError: positions do not determine scale and heading.
    """
    from bundle.georeference.prior_alignment import level_similarity
    from bundle.georeference.similarity_fit import Correspondences

    points = known.correspondences(problem)
    if targets is not None:
        points = Correspondences.joined(targets.correspondences(), points)
    upright = turned.placement(problem)
    return level_similarity(points, np.eye(3) if upright is None else upright.rotation)


def sorted_priors(priors: tuple[Any, ...]) -> tuple[list[Any], list[Any], list[Any], list[Any]]:
    """Return the positions, the attitudes, the control points, and the velocities."""
    from bundle.georeference.attitude_priors import AttitudePrior
    from bundle.georeference.control_point import GroundControlPoint
    from bundle.georeference.vector_priors import PositionPrior, VelocityPrior

    kinds = (PositionPrior, AttitudePrior, GroundControlPoint, VelocityPrior)
    groups: tuple[list[Any], list[Any], list[Any], list[Any]] = ([], [], [], [])
    for place, prior in enumerate(priors):
        for kind, group in zip(kinds, groups, strict=True):
            if isinstance(prior, kind):
                group.append(prior)
                break
        else:
            raise InputError(
                "priors: expected PositionPriors, GroundControlPoints and priors of attitudes and "
                f"velocities, found {brief(prior)} at [{place}]"
            )
    return groups


def _similarity(problem: Problem, known: ProblemPriors, targets: TargetPriors | None) -> Similarity:
    """Return the similarity to the priors.

    Raises:
        InputError: the priors do not determine the similarity.
    """
    if targets is None or not targets.used:
        return known.align(problem)
    if any(prior.offset != "none" for prior in known.priors):
        return _similarity_beside_offset(problem, known, targets)
    from bundle.georeference.prior_alignment import robust_similarity
    from bundle.georeference.similarity_fit import Correspondences, fit_similarity

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

    Raises:
        InputError: neither control points nor positions determine scale and rotation.
    """
    from bundle.georeference.similarity import Similarity
    from bundle.georeference.similarity_fit import fit_similarity

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
