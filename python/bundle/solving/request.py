"""A solve as data: the problem with all that is known of it, and the plan of the run."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from bundle.base.paths import as_path
from bundle.errors import InputError
from bundle.interface.option_fields import choice, number
from bundle.interface.options import SolveOptions
from bundle.interface.round_options import CHECKPOINT_INTERVAL, RESTS, RoundOptions
from bundle.model.image_selection import ImageSelection
from bundle.model.problem import Problem

if TYPE_CHECKING:
    from typing import TypeAlias

    from bundle.graphs.factors.factors import Factor
    from bundle.solving.constraints.applied import Applied
    from bundle.solving.constraints.rule_list import Constraints
    from bundle.solving.constraints.rules import Rule
    from bundle.solving.placed_problem import Prior

    Rules: TypeAlias = Constraints | Iterable[str | Rule] | Applied

__all__ = ["Bounds", "PartRequest", "RunPlan", "SolveRequest"]

Bounds = Mapping[tuple[str, int], tuple[ArrayLike, ArrayLike]]
"""Lower and upper bounds of a camera's parameters, by ``("camera", camera_id)``."""


@dataclass(frozen=True)
class PartRequest:
    """The images that a solve refines, where these are not all.

    Attributes:
        images: ids and names, as ``find_images`` takes them.
        rest: "fixed" or "marginal": the role of all else.
    """

    images: ImageSelection
    rest: str = RESTS[0]

    @staticmethod
    def of(images: ImageSelection | None, rest: str) -> PartRequest | None:
        """Return the part that arguments name; None: the whole problem.

        Raises:
            InputError: there is no such rest, or it needs images.
        """
        rest = choice("rest", rest, RESTS)
        if images is None and rest == "marginal":
            raise InputError("rest: expected with only_images only, found marginal without")
        return None if images is None else PartRequest(images, rest)


@dataclass(frozen=True, eq=False, kw_only=True)
class SolveRequest:
    """All that decides the minimum that a solve looks for; :func:`bundle.solve` has the details.

    Attributes:
        problem: opened; never changed.
        options: as given, "auto" included.
        factors: beside the observations.
        priors: measured positions of images, and control points.
        align: whether the problem is first moved to its priors; None: where they determine that.
        bounds: of camera parameters.
        constraints: rules, or rules that were resolved for this problem.
        part: the images to refine; None: all.

    Raises:
        InputError: factors or priors are no list.
    """

    problem: Problem
    options: SolveOptions = field(default_factory=SolveOptions)
    factors: tuple[Factor, ...] = ()
    priors: tuple[Prior, ...] = ()
    align: bool | None = None
    bounds: Bounds | None = None
    constraints: Rules = ()
    part: PartRequest | None = None

    def __post_init__(self) -> None:
        for name, things in (("priors", "PositionPriors"), ("factors", "factors")):
            object.__setattr__(self, name, _listed(name, things, getattr(self, name)))


def _listed(name: str, things: str, given: Any) -> tuple[Any, ...]:
    if isinstance(given, tuple | list):
        return tuple(given)
    from bundle.graphs.factors.variables import as_list  # rare, and slow to import

    return as_list(name, things, given)


@dataclass(frozen=True, kw_only=True)
class RunPlan:
    """The length of a run: its rounds, and where it can go on after a kill.

    Attributes:
        rounds: how often to adjust and filter, and the limits of the filter.
        checkpoint: file that is written after each round and each ``checkpoint_interval``
            iterations; None: that of ``resume``, if any.
        resume: checkpoint to go on from, if it exists.
        checkpoint_interval: iterations from one checkpoint to the next.

    Raises:
        InputError: an interval below 1, or what cannot be a path.
    """

    rounds: RoundOptions = field(default_factory=RoundOptions)
    checkpoint: Path | None = None
    resume: Path | None = None
    checkpoint_interval: int = CHECKPOINT_INTERVAL

    def __post_init__(self) -> None:
        interval = number("checkpoint_interval", self.checkpoint_interval, whole=True, minimum=1)
        object.__setattr__(self, "checkpoint_interval", interval)
        for name in ("checkpoint", "resume"):
            path: str | os.PathLike[str] | None = getattr(self, name)
            if path is not None:
                object.__setattr__(self, name, as_path(path, name))

    @property
    def file(self) -> Path | None:
        """The checkpoint that is written; None: none is."""
        return self.resume if self.checkpoint is None else self.checkpoint
