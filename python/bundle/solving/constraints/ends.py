"""Outcome of rules in a solve: pulls of priors, active bounds, ties."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.model.cameras import camera_models
from bundle.model.problem import Problem
from bundle.model.rigid_motions import quaternion_inverse, quaternion_multiply
from bundle.solving.constraints.applied import Applied, KnownPrior, Tie


def rule_ends(applied: Applied, before: Problem, after: Problem) -> tuple[RuleEnd, ...]:
    """Return the outcome of each rule.

    Args:
        applied: the rules.
        before: the start, before shared parameters were made equal.
        after: the end, with the same images and cameras; points may have been removed.
    """
    first, last = _Values(before), _Values(after)
    priors: dict[int, list[PriorEnd]] = {}
    for prior in applied.priors:
        end = _prior_end(prior, first, last)
        if end is not None:
            priors.setdefault(prior.rule, []).append(end)
    bounds: dict[int, list[BoundEnd]] = {}
    for (camera_id, j), pair in sorted(applied.bounds.items()):
        value = last.param(camera_id, j)
        if pair[0] < pair[1] and value in pair:
            side = "upper" if value == pair[1] else "lower"
            name = last.name(camera_id, j)
            bounds.setdefault(applied.bounded[camera_id, j], []).append(
                BoundEnd(camera_id=camera_id, parameter=name, side=side, value=value)
            )
    ties: dict[int, list[TieEnd]] = {}
    for tie in applied.ties:
        for rule in tie.rules:
            ties.setdefault(rule, []).append(_tie_end(tie, first, last))
    return tuple(
        RuleEnd(
            rule=str(rule),
            place=rule.place,
            kind=rule.kind,
            num_parameters=applied.counts[number],
            priors=tuple(priors.get(number, ())),
            active_bounds=tuple(bounds.get(number, ())),
            ties=tuple(ties.get(number, ())),
        )
        for number, rule in enumerate(applied.rules)
    )


class _Values:
    """Values of a problem by ids."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._centers: NDArray[np.float64] | None = None
        self._rows: dict[str, dict[int, int]] = {}

    def row(self, kind: str, key: int) -> int | None:
        if kind not in self._rows:
            ids = getattr(self._problem, f"{kind}_ids").tolist()
            self._rows[kind] = {known: index for index, known in enumerate(ids)}
        return self._rows[kind].get(key)

    def param(self, camera_id: int, j: int) -> float:
        return float(self._problem.camera_params[self.row("camera", camera_id), j])

    def name(self, camera_id: int, j: int) -> str:
        row = self.row("camera", camera_id)
        assert row is not None
        return camera_models()[self._problem.camera_models[row]][j]

    def of(self, prior: KnownPrior) -> tuple[float, ...] | None:
        """Return the value of a prior's parameter; None if its subject has been removed."""
        kind, key = prior.subject
        row = self.row(kind, key)
        if row is None:
            return None
        if kind == "camera":
            return (self.param(key, prior.column),)
        value: Any
        if prior.parameter == "rotation":
            value = self._problem.cam_from_world[row, :4]
        elif kind == "point":
            value = self._problem.points[row]
        else:
            if self._centers is None:
                self._centers = self._problem.projection_centers
            value = self._centers[row]
        return tuple(value.tolist())


def _prior_end(prior: KnownPrior, first: _Values, last: _Values) -> PriorEnd | None:
    before, after = first.of(prior), last.of(prior)
    if before is None or after is None:
        return None
    is_rotation = prior.parameter == "rotation"
    kind, key = prior.subject
    return PriorEnd(
        subject=kind,
        id=key,
        parameter=prior.parameter,
        known=prior.value[:4] if is_rotation else prior.value,
        sigma=prior.sigma,
        relative=prior.relative,
        before=before,
        after=after,
        pull=_pull(prior, after),
    )


def _pull(prior: KnownPrior, after: tuple[float, ...]) -> float:
    if prior.relative:
        return math.log1p((after[0] - prior.value[0]) / prior.value[0]) / prior.sigma[0]
    if prior.parameter == "rotation":
        known, end = (np.array([q[:4]]) for q in (prior.value, after))
        x, y, z, w = quaternion_multiply(quaternion_inverse(known), end)[0].tolist()
        angle = 2 * math.atan2(math.hypot(x, y, z), abs(w))
        return math.degrees(angle) / prior.sigma[0]
    errors = [
        (end - known) / sigma
        for end, known, sigma in zip(after, prior.value, prior.sigma, strict=True)
    ]
    return errors[0] if len(errors) == 1 else math.hypot(*errors)


def _tie_end(tie: Tie, first: _Values, last: _Values) -> TieEnd:
    return TieEnd(
        camera_ids=tuple(camera for camera, _, _ in tie.members),
        parameters=tuple(last.name(camera, j) for camera, j, _ in tie.members),
        multiples=tuple(times for _, _, times in tie.members),
        before=tuple(first.param(camera, j) for camera, j, _ in tie.members),
        after=tuple(last.param(camera, j) for camera, j, _ in tie.members),
    )


@dataclass(frozen=True, kw_only=True)
class PriorEnd:
    """Distance of a solved parameter from its prior."""

    subject: str  # "camera", "image" or "point"
    id: int  # id of the camera, image or point
    parameter: str  # name of the parameter, such as "fx", "position" or "rotation"
    # prior value: a number; x, y, z of a position; or qx, qy, qz, qw of a rotation
    known: tuple[float, ...]
    # standard deviation in the parameter's unit; degrees for a rotation; per axis for a position; a
    # fraction of the value if `relative`
    sigma: tuple[float, ...]
    relative: bool  # True if the prior is on the logarithm
    before: tuple[float, ...]  # value at the start, in the form of `known`
    after: tuple[float, ...]  # value at the end, in the form of `known`
    # difference of the end from the prior value, in sigmas: signed for a number, the length of the
    # vector otherwise. The cost of the prior is half the square of the pull
    pull: float


@dataclass(frozen=True, kw_only=True)
class BoundEnd:
    """A bound that a parameter reaches at the end of a solve."""

    camera_id: int  # id of the camera
    parameter: str  # name of the parameter
    side: str  # "lower" or "upper"
    value: float  # the bound


@dataclass(frozen=True, kw_only=True)
class TieEnd:
    """Parameters that the solver moved as multiples of one number."""

    camera_ids: tuple[int, ...]  # id of the camera of each parameter
    parameters: tuple[str, ...]  # name of each parameter
    multiples: tuple[float, ...]  # ratio of each parameter to the shared number
    # value of each parameter in the input, before the solver made them equal
    before: tuple[float, ...]
    after: tuple[float, ...]  # value of each parameter at the end


@dataclass(frozen=True, kw_only=True)
class RuleEnd:
    """One rule and its outcome."""

    rule: str  # text of the rule
    place: str  # place of the rule in a file or list
    kind: str  # "fixed", "prior", "bounds", "share" or "ratio"
    num_parameters: int  # number of parameters, positions and rotations that the rule names
    priors: tuple[PriorEnd, ...] = ()  # outcome of each prior, for a rule of kind "prior"
    # bounds that parameters reach at the end, for a rule of kind "bounds"
    active_bounds: tuple[BoundEnd, ...] = ()
    # groups of parameters that moved together, for a share or ratio; a group includes parameters
    # that other rules tie to it
    ties: tuple[TieEnd, ...] = ()
