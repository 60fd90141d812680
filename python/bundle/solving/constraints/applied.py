"""Resolved rules: their constants, bounds, priors and ties in one problem.

Rules are resolved once. Priors and bounds relative to the start ("2 %", "as at the start") refer to
the start of the entire run, not to the start of a round.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from typing import TYPE_CHECKING

from bundle.base.records import dataclass
from bundle.model.problem import Problem

if TYPE_CHECKING:
    from bundle.graphs.factors.factors import Factor
    from bundle.solving.constraints.rules import Rule

HELD_ROTATION, HELD_POSITION = 1, 2
"""Bits of the constant parts of a pose, as in ``problem_view.h``."""


@dataclass(frozen=True)
class KnownPrior:
    """A prior on one parameter of a camera, or on a position or rotation."""

    rule: int  # index of the rule in the list of rules
    subject: tuple[str, int]  # ("camera", id), ("image", id) or ("point", id)
    parameter: str  # name of the parameter, such as "fx" or "position"
    # prior value: a number; x, y, z of a position; or cam_from_world of a rotation
    value: tuple[float, ...]
    # standard deviation in the parameter's unit; degrees for a rotation; per axis for a position; a
    # fraction of the value if `relative`
    sigma: tuple[float, ...]
    relative: bool = False  # True if the prior is on the logarithm
    column: int = -1  # column of a camera's parameter


@dataclass(frozen=True)
class Tie:
    """Parameters of cameras that are multiples of one shared number."""

    members: tuple[tuple[int, int, float], ...]  # (camera id, column, multiple)
    rules: tuple[int, ...]  # indices of the rules that tie them


@dataclass(frozen=True)
class Applied:
    """Rules, resolved for one problem."""

    rules: tuple[Rule, ...]  # the rules as the caller gave them
    # columns of the constant parameters of a camera, by camera id
    held_params: Mapping[int, frozenset[int]] = field(default_factory=dict)
    # bits of the constant parts of an image's pose, by image id
    held_poses: Mapping[int, int] = field(default_factory=dict)
    fixed_point_ids: tuple[int, ...] = ()  # ids of the constant points
    # (lower, upper) by camera id and column
    bounds: Mapping[tuple[int, int], tuple[float, float]] = field(default_factory=dict)
    priors: tuple[KnownPrior, ...] = ()  # the priors, in the order of `factors`
    factors: tuple[Factor, ...] = ()  # the factor of each prior
    ties: tuple[Tie, ...] = ()  # parameters that are multiples of one shared number
    # number of parameters (or positions, rotations) that each rule names
    counts: tuple[int, ...] = ()
    # index of the rule that bounds a parameter, by camera id and column
    bounded: Mapping[tuple[int, int], int] = field(default_factory=dict)

    @property
    def locate(self) -> bool:
        """Return True if rules determine part of the gauge, so that gauge "auto" fixes nothing."""
        both = HELD_POSITION | HELD_ROTATION
        return any(prior.subject[0] != "camera" for prior in self.priors) or any(
            parts != both for parts in self.held_poses.values()
        )

    def restricted(self, part: Problem) -> Applied:
        """Return the rules on the cameras, images and points of a subproblem.

        A parameter that is tied to a camera outside the subproblem becomes constant.
        """
        cameras, images = set(part.camera_ids.tolist()), set(part.image_ids.tolist())
        points = set(part.point_ids.tolist())
        held = {camera: held for camera, held in self.held_params.items() if camera in cameras}
        ties = []
        for tie in self.ties:
            if all(camera in cameras for camera, _, _ in tie.members):
                ties.append(tie)
                continue
            for camera, column, _ in tie.members:
                if camera in cameras:
                    held[camera] = held.get(camera, frozenset()) | {column}
        within = {"camera": cameras, "image": images, "point": points}
        kept = [
            k for k, prior in enumerate(self.priors) if prior.subject[1] in within[prior.subject[0]]
        ]
        return replace(
            self,
            priors=tuple(self.priors[k] for k in kept),
            factors=tuple(self.factors[k] for k in kept),
            held_params=held,
            held_poses={key: parts for key, parts in self.held_poses.items() if key in images},
            fixed_point_ids=tuple(key for key in self.fixed_point_ids if key in points),
            bounds={key: pair for key, pair in self.bounds.items() if key[0] in cameras},
            ties=tuple(ties),
        )
