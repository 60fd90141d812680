"""Start of a solve with priors: the problem in their frame, with all that they add to it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, cast

from bundle.base.arrays import as_flag
from bundle.errors import InputError
from bundle.model.problem import Problem

if TYPE_CHECKING:
    from bundle.georeference.alignment_result import ControlPointError
    from bundle.georeference.measurements import FoundPriors, Prior
    from bundle.georeference.position_offset import PositionOffset
    from bundle.georeference.similarity import Similarity
    from bundle.georeference.target_priors import TargetPriors
    from bundle.graphs.factors.factors import Factor


class PlacedProblem(NamedTuple):
    """Problem at its priors."""

    problem: Problem  # problem in the frame of the priors, with the images and points that they add
    factors: tuple[Factor, ...] = ()  # all factors; those of the priors come last, by kind
    # similarity by which the problem was moved, if it was moved
    similarity: Similarity | None = None
    groups: tuple[FoundPriors, ...] = ()  # the priors by kind, in the order of their factors

    @property
    def targets(self) -> TargetPriors | None:
        """Control and check points, if there are any; they are the last points."""
        found = next((one for one in self.groups if one.adds_points), None)
        return cast("TargetPriors | None", found)

    @property
    def offset(self) -> PositionOffset | None:
        """Common offset of the measured positions, if it is estimated.

        It is stored as the pose of the last image.
        """
        return next((one.offset for one in self.groups if one.offset is not None), None)

    @property
    def control_point_ids(self) -> tuple[int, ...]:
        """Ids of the added points."""
        return () if self.targets is None else self.targets.point_ids

    def taken_from(self, problem: Problem) -> Problem:
        """Return a refined or filtered problem without what the priors added."""
        for group in self.groups:
            problem = group.taken_from(problem)
        return problem

    def control_points(self, problem: Problem) -> tuple[ControlPointError, ...]:
        """Return the residuals of control and check points in the result."""
        return () if self.targets is None else self.targets.point_errors(problem)


def place_at_priors(
    problem: Problem,
    factors: tuple[Factor, ...],
    priors: tuple[Prior, ...],
    align: bool | None,
) -> PlacedProblem:
    """Move a problem to its priors, and add their factors, images and points.

    Args:
        problem: problem to move; not modified.
        align: move the problem to the priors; None: move it if `factors` is empty and the priors
            determine the similarity.
    """
    if align is not None:
        align = as_flag("align", align)
    if not priors:
        if align:
            raise InputError("align: expected priors to align the problem to, found 0")
        return PlacedProblem(problem, factors)
    from bundle.georeference.measurements import find_priors  # most solves have no priors
    from bundle.georeference.prior_alignment import placement
    from bundle.georeference.similarity import moved

    found = find_priors(problem, priors)
    groups = tuple(group.beside(problem, found) for group in found)
    similarity = None
    if align or (align is None and not factors):
        try:
            similarity = placement(problem, groups)
        except InputError as error:
            if align:
                raise InputError(f"priors: {error}") from None
    start = problem if similarity is None else moved(problem, similarity)
    of_priors: list[Factor] = []
    for group in groups:
        group.check(start, groups)
        start = group.added_to(start, similarity)
        of_priors += group.factors(start)
    of_priors += (factor for group in groups for factor in group.last_factors())
    return PlacedProblem(start, (*factors, *of_priors), similarity, groups)
