"""Request of a solve as data: problem, factors, priors and rules."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, TypeVar

from numpy.typing import ArrayLike

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
    from bundle.solving.constraints.applied import Applied
    from bundle.solving.constraints.rule_list import Constraints
    from bundle.solving.constraints.rules import Rule

    Rules: TypeAlias = Constraints | Iterable[str | Rule] | Applied

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
