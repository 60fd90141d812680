"""Resolved rules, and their outcome in a solve: pulls of priors, active bounds, ties."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.model.cameras import camera_models
from bundle.model.problem import Problem
from bundle.model.rigid_motions import quaternion_inverse, quaternion_multiply

if TYPE_CHECKING:
    from bundle.graphs.factors.factors import Factor
    from bundle.solving.constraints.rules import Rule


# Resolved rules: their constants, bounds, priors and ties in one problem.
#
# Rules are resolved once. Priors and bounds relative to the start ("2 %", "as at the start") refer
# to the start of the entire run, not to the start of a round.


HELD_ROTATION, HELD_POSITION = 1, 2
"""Bits of the constant parts of a pose, as in ``problem_view.h``."""


@dataclass(frozen=True)
class Flatness:
    """Distances of points from their best plane, as the function of a factor.

    Let C be the points minus their mean, e_1, e_2 and n the axes of its singular value
    decomposition, n that of the smallest singular value, c_k = C e_k, and r = C n. Of all planes,
    the one through the mean with the normal n has the least sum of squared distances, which are r.
    So offset and normal are eliminated as exactly as by a Schur complement, with

        dr = dC n + sum_k c_k e_k^T dn,  e_k^T dn = (e_k^T dC^T r + c_k^T dC n) / (|r|^2 - |c_k|^2).

    As c_k^T r = 0, the gradient is that at a constant plane. The normal of a level plane is z.
    """

    points: tuple[int, ...]  # ids
    sigma: float
    # (3,) normal at the start, on whose side it stays; None: z, that of a level plane
    normal: tuple[float, ...] | None

    def along(self, points: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return (n, 3) c_1, c_2 and r, and the axes (3, 3) in rows."""
        from_middle, axes = points - points.mean(axis=0), np.eye(3)
        if self.normal is not None:
            axes = np.linalg.svd(from_middle, full_matrices=False)[2]
            axes[2] *= np.copysign(1.0, axes[2] @ self.normal)
        return from_middle @ axes.T, axes

    def distances(self, problem: Problem) -> list[float]:
        """Return the signed distances in a problem."""
        points = problem.points[np.isin(problem.point_ids, self.points)]
        found: list[float] = self.along(points)[0][:, 2].tolist()
        return found

    def __call__(self, values: Any) -> tuple[Any, Any]:
        """Return the whitened distances and their Jacobians; see :class:`bundle.FunctionFactor`."""
        along, axes = self.along(np.array(values))
        errors = along[:, 2]
        jacobian = (np.eye(len(errors)) - 1 / len(errors))[:, :, None] * axes[2]
        for c, axis in zip(along.T[:2], axes[:2], strict=True) if self.normal else ():
            turn = np.outer(errors, axis) + np.outer(c, axes[2])
            jacobian += c[:, None, None] * turn / (errors @ errors - c @ c)
        return errors / self.sigma, list(jacobian.swapaxes(0, 1) / self.sigma)


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
    # unit normals of a plane or line on which a point lies; `value` is its foot at the start
    normals: tuple[tuple[float, ...], ...] = ()
    # distances of points from an estimated plane; `subject` is the first of them
    flatness: Flatness | None = None


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
        ends = priors.setdefault(prior.rule, [])
        if prior.flatness is not None:
            ends.extend(_plane_ends(prior, prior.flatness, before, after))
        elif (end := _prior_end(prior, first, last)) is not None:
            ends.append(end)
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
        """Return the value of the parameter; None if its camera, image or point was removed."""
        kind, key = prior.subject
        row = self.row(kind, key)
        if row is None:
            return None
        if kind == "camera":
            return (self.param(key, prior.column),)
        value: Any
        if prior.parameter == "rotation":
            value = self._problem.cam_from_world[row, :4]
        elif prior.normals:
            errors = np.array(prior.normals) @ (self._problem.points[row] - prior.value)
            value = errors if len(errors) == 1 else np.hypot(*errors)[None]
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
        known=(0.0,) if prior.normals else prior.value[:4] if is_rotation else prior.value,
        sigma=prior.sigma,
        relative=prior.relative,
        before=before,
        after=after,
        pull=_pull(prior, after),
    )


def _plane_ends(
    prior: KnownPrior, flatness: Flatness, before: Problem, after: Problem
) -> Iterator[PriorEnd]:
    """Yield the outcome of the rule for each point on an estimated plane."""
    starts, ends = flatness.distances(before), flatness.distances(after)
    for key, start, end in zip(flatness.points, starts, ends, strict=True):
        yield PriorEnd(
            subject="point", id=key, parameter=prior.parameter, known=(0.0,), sigma=prior.sigma,
            relative=False, before=(start,), after=(end,), pull=end / flatness.sigma,
        )  # fmt: skip


def _pull(prior: KnownPrior, after: tuple[float, ...]) -> float:
    if prior.relative:
        return math.log1p((after[0] - prior.value[0]) / prior.value[0]) / prior.sigma[0]
    if prior.parameter == "rotation":
        known, end = (np.array([q[:4]]) for q in (prior.value, after))
        x, y, z, w = quaternion_multiply(quaternion_inverse(known), end)[0].tolist()
        angle = 2 * math.atan2(math.hypot(x, y, z), abs(w))
        return math.degrees(angle) / prior.sigma[0]
    if prior.normals:
        return after[0] / prior.sigma[0]
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
    parameter: str  # name of the parameter, such as "fx", "position", "rotation" or "plane"
    # prior value: a number (0, a distance from a plane or line); x, y, z of a position; or qx, qy,
    # qz, qw of a rotation
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
    kind: str  # "fixed", "prior", "on", "bounds", "share" or "ratio"
    num_parameters: int  # number of parameters, positions and rotations that the rule names
    priors: tuple[PriorEnd, ...] = ()  # outcome of each prior, for rules of kind "prior" and "on"
    # bounds that parameters reach at the end, for a rule of kind "bounds"
    active_bounds: tuple[BoundEnd, ...] = ()
    # groups of parameters that moved together, for a share or ratio; a group includes parameters
    # that other rules tie to it
    ties: tuple[TieEnd, ...] = ()
