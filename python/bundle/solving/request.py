"""Request of a solve as data: problem, factors, priors and rules; its start with priors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, cast

from numpy.typing import ArrayLike

from bundle.base.arrays import as_flag
from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.interface.option_fields import choice
from bundle.interface.options import SolveOptions
from bundle.interface.round_options import RESTS
from bundle.model.problem import Problem
from bundle.model.problem_keys import ImageSelection

if TYPE_CHECKING:
    from typing import TypeAlias

    from bundle.georeference.measurements import Prior
    from bundle.graphs.factors.factors import Factor
    from bundle.solving.constraints.ends import Applied
    from bundle.solving.constraints.rule_list import Constraints
    from bundle.solving.constraints.rules import Rule

    Rules: TypeAlias = Constraints | Iterable[str | Rule] | Applied
    from bundle.georeference.alignment_result import ControlPointError
    from bundle.georeference.measurements import FoundPriors
    from bundle.georeference.point_check import PositionOffset
    from bundle.georeference.similarity import Similarity
    from bundle.georeference.target_priors import TargetPriors


T = TypeVar("T")

Bounds = Mapping[tuple[str, int], tuple[ArrayLike, ArrayLike]]
"""Lower and upper bounds of a camera's parameters, by ``("camera", camera_id)``."""


@dataclass(frozen=True)
class PartRequest:
    """Images that a local adjustment refines."""

    images: ImageSelection  # ids and names in a form that ``find_images`` accepts
    rest: str = RESTS[0]  # treatment of the remaining problem: "fixed" or "marginal"

    @staticmethod
    def of(images: ImageSelection | None, rest: str) -> PartRequest | None:
        """Return the local part that the arguments name; None: the entire problem."""
        rest = choice("rest", rest, RESTS)
        if images is None and rest == "marginal":
            raise InputError("rest: marginal is valid only with only_images")
        return None if images is None else PartRequest(images, rest)


@dataclass(frozen=True, eq=False, init=False)
class SolveRequest:
    """All inputs that define the minimum of a solve; see :func:`bundle.solve` for details."""

    problem: Problem  # opened problem; never changed
    options: SolveOptions  # options as the caller gave them, including "auto"
    factors: tuple[Factor, ...]  # factors in addition to the observations
    priors: tuple[Prior, ...]  # measured positions of images, and control points
    # True to move the problem to its priors first; None: move it if the priors determine the
    # similarity
    align: bool | None
    bounds: Bounds | None  # bounds of camera parameters
    constraints: Rules  # rules, or rules that were resolved for this problem
    part: PartRequest | None  # the images to refine; None: all

    def __init__(
        self,
        *,
        problem: Problem,
        options: SolveOptions | None = None,
        factors: Iterable[Factor] = (),
        priors: Iterable[Prior] = (),
        align: bool | None = None,
        bounds: Bounds | None = None,
        constraints: Rules = (),
        part: PartRequest | None = None,
    ) -> None:
        vars(self).update(  # frozen
            problem=problem,
            options=SolveOptions() if options is None else options,
            priors=_listed("priors", "PositionPriors", priors),
            factors=_listed("factors", "factors", factors),
            align=align,
            bounds=bounds,
            constraints=constraints,
            part=part,
        )

    def at(self, problem: Problem, **changes: Any) -> SolveRequest:
        """Return a copy for another problem, with other attributes by name."""
        return SolveRequest(**(vars(self) | {"problem": problem} | changes))


def _listed(name: str, things: str, given: Iterable[T]) -> tuple[T, ...]:
    if isinstance(given, tuple | list):
        return tuple(given)
    from bundle.graphs.factors.variables import as_list  # rare, and slow to import

    return as_list(name, things, given)


# Start of a solve with priors: the problem in their frame, with all that they add to it.


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
        """Return a refined or filtered problem without the images and points that priors added."""
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

    ``problem``: problem to move; not modified. ``align``: move the problem to the priors; None:
    move it if `factors` is empty and the priors determine the similarity.
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
