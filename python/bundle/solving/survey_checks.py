"""Tests of control points, and of an offset of positions from them, after a solve.

Control points. ``georeference/point_check.py`` has the test. With n tested points, a suspect has
p < 0.01 / n. The one with the largest T is named first; its prior is removed, the rest is adjusted
again, and
tested again: otherwise a gross error hides smaller ones and makes its neighbours look bad.

Offset of positions (``georeference/point_check.py``). At the minimum without an offset, let
g = sum w L^-T r over all positions be the gradient of the cost w.r.t. o, and C the covariance of o
in the model that has it. The offset and its test are

    o = -C g,    T = g^T C g, chi squared with 3 degrees of freedom;

for the height alone, with the other coordinates constant, T = g_up^2 / (C^-1)_up with 1. Residuals
do not show an offset that a focal length absorbs; the gradient g shows it. If T is large (p <
1e-3), the model is adjusted with the offset, along all axes only if these explain more: o, its
sigma and the focal length come from there. If residuals of pixels and positions are larger than
their sigmas by a factor s, the test uses F = T / (k s^2). The residuals are those of the model with
the offset, because a missing offset bends the other model and enlarges its residuals.

A gross error and an offset explain the same residuals; the one with the larger T is named, and the
other tested after it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle._core import evaluate_loss
from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.georeference.point_check import (
    BarCheck,
    OffsetCheck,
    PointCheck,
    PositionOffset,
    SurveyChecks,
    scaled_tail,
)
from bundle.georeference.scale_bars import MOST_TESTED, FoundBars, bars_among
from bundle.georeference.target_priors import TargetPriors, survey_sigmas
from bundle.graphs.factors.factors import Factor, PositionFactor
from bundle.interface.analysis_options import GAUGE
from bundle.interface.georeference_options import OFFSET_AXES
from bundle.model.problem import Problem
from bundle.model.rigid_motions import rotation_matrices

if TYPE_CHECKING:
    from bundle.solving.prepare import Prepared

Array = NDArray[np.float64]

LEVEL_OF_POINTS = 0.01
FEWEST_POSITIONS = 3
MOST_IMAGES = 2000
"""Number of images above which the covariance takes longer than the solve: no tests."""
TOLERANCE, MOST_STEPS = 1e-9, 100
ATTITUDES = ("direction", "rotation", "heading")  # kinds of the factors of attitudes
KNOWN = 1e-100  # information above which a coordinate counts as measured


def check_survey(prepared: Prepared, solve: Callable[[Prepared], Problem]) -> SurveyChecks | None:
    """Test the control points and scale bars of a solve, and an offset of its positions.

    Return None without points and bars.
    """
    kept = tuple(one for one in prepared.factors if not FoundBars.owns(one))
    others = prepared if len(kept) == len(prepared.factors) else replace(prepared, factors=kept)
    bars, is_large = _check_bars(others), prepared.start.num_images > MOST_IMAGES
    if prepared.placed.targets is None:
        return SurveyChecks(None, {}, bars) if bars else None
    checks = SurveyChecks(None, {}) if is_large else _Adjusted(others, solve).checks()
    return replace(checks, bars=bars)


def _check_bars(prepared: Prepared) -> tuple[BarCheck, ...]:
    """Test the bars of a solve by the covariance of their lengths without them.

    S_ij is half of the variance of l_i + l_j without those of l_i and l_j.
    """
    group, problem = bars_among(prepared.placed.groups), prepared.start
    if group is None:
        return ()
    count = len(group.priors)
    by_bar = [group.gradient(problem, row) for row in range(count)]
    cameras, s, share = np.zeros_like(problem.camera_params), np.zeros((count, count)), 0.0

    def variance(*rows: int) -> tuple[float, float]:
        images, points = (np.sum([by_bar[row][k] for row in rows], axis=0) for k in range(2))
        out = _core.influence(problem, options, limits, factors, "", images, cameras, points)
        return out["variance"], out["gauge_share"]

    if count > MOST_TESTED or problem.num_images > MOST_IMAGES:
        return group.checks(problem, None, True)
    try:
        layout = prepared.layout
        options = layout.options.replace(gauge="none").asdict()
        limits, factors = layout.limits, layout.core_factors()
        for i in range(count):
            s[i, i], share = variance(i)
        for i in range(count):
            for j in range(i):
                s[i, j] = s[j, i] = (variance(i, j)[0] - s[i, i] - s[j, j]) / 2
    except InputError:  # something is undetermined without the bars
        return group.checks(problem, None, True)
    return group.checks(problem, s, share > GAUGE)


def solve_without_attitudes(
    prepared: Prepared, solve: Callable[[Prepared], Problem]
) -> Problem | None:
    """Return the model of a solve without measured attitudes; None without attitudes or a solution.

    If sigmas of attitudes are too small, the model bends to fit the attitudes, and small residuals
    hide large errors.
    """
    if prepared.part is not None or prepared.start.num_images > MOST_IMAGES:
        return None
    count = len(prepared.request.factors)
    offset = prepared.placed.offset
    others = tuple(
        one
        for place, one in enumerate(prepared.factors)
        if place < count
        or one.kind not in ATTITUDES
        or (offset is not None and one.keys == (offset.key,))
    )
    if len(others) == len(prepared.factors):
        return None
    options = prepared.options.replace(max_num_iterations=MOST_STEPS, check_solution=False)
    try:
        free = solve(replace(prepared.at(prepared.start, options), factors=others))
    except InputError:  # nothing else determines the model
        return None
    return prepared.placed.taken_from(free)


@dataclass(frozen=True)
class _Certainty:
    """Covariances of a state, by the stated sigmas."""

    last_pose: Array  # (3, 3) of the translation of the last image
    points: Array  # (num_points, 3, 3)
    focal_length: Array  # variance of the first parameter of each camera
    scale2: float  # squared factor on all sigmas that the residuals show
    dof: float  # degrees of freedom of this factor


class _Adjusted:
    """A solve at its minimum, from which wrong control points are removed one by one."""

    def __init__(self, prepared: Prepared, solve: Callable[[Prepared], Problem]) -> None:
        placed, self.solve = prepared.placed, solve
        assert placed.targets is not None
        self.prepared, self.targets = prepared, placed.targets
        self.offset, self.is_estimated = placed.offset, placed.offset is not None
        key = None if placed.offset is None else placed.offset.key
        self.plain = placed.offset.taken_from(prepared.start) if placed.offset else prepared.start
        self.value = placed.offset.value_in(prepared.start) if placed.offset else np.zeros(3)
        count = len(prepared.request.factors)
        self.positions, self.others = [], list(prepared.factors[:count])
        for factor in prepared.factors[count:]:
            if isinstance(factor, PositionFactor) and factor.offset == key:
                if factor.key != key:
                    self.positions.append(replace(factor, offset=None))
            elif factor.keys != (key,):
                self.others.append(factor)
        self.suspects: dict[str, PointCheck] = {}

    def checks(self) -> SurveyChecks:
        """Return the outcome of all tests."""
        points: dict[str, PointCheck] = {}
        offset = None
        while True:
            try:
                points = self._points()
                offset = self._offset() or offset
            except (InputError, np.linalg.LinAlgError):  # something is undetermined
                break
            suspects = {name: one.statistic for name, one in points.items() if one.is_suspect}
            worst = max(suspects, key=lambda name: suspects[name], default="")
            largest = suspects.get(worst, 0.0)
            if self.offset is None and offset is not None and offset.may_explain(largest):
                found = self._adjusted_with(offset)
                if found is not None:
                    offset = found
                    continue
            if not worst:
                break
            self.suspects[worst] = points[worst]
            if self._leave_out(worst):
                self._adjust()
        left = {name: replace(one, is_suspect=False) for name, one in points.items()}
        return SurveyChecks(offset, {**left, **self.suspects})

    def _points(self) -> dict[str, PointCheck]:
        """Test the points that are not suspects yet."""
        check_points = TargetPriors.make(
            self.plain,
            [replace(one, role="control") for one in self.targets.points if one.role == "check"],
        )
        problem = check_points.added_to(self.plain, None)
        certainty = self._certainty(problem, self.offset, self.positions)
        row = {int(one): k for k, one in enumerate(problem.point_ids.tolist())}
        found = {}
        for targets in (self.targets, check_points):
            for point_id, entry in zip(targets.point_ids, targets.used, strict=True):
                point, at = entry.point, row[point_id]
                if point.name in self.suspects:
                    continue
                sigma = survey_sigmas(point)
                residual = problem.points[at] - np.array(point.position)
                length = float((np.nan_to_num(residual / sigma) ** 2).sum())
                weight = 0.0 if targets is check_points else _weight(point, length)
                found[point.name] = PointCheck.of(residual, sigma, certainty.points[at], weight)
        level = LEVEL_OF_POINTS / max(len(found), 1)
        for name, one in found.items():
            tail = scaled_tail(one.statistic, one.freedom, certainty.scale2, certainty.dof)
            found[name] = replace(one, is_suspect=one.is_checked and tail < level)
        return found

    def _leave_out(self, name: str) -> bool:
        """Remove the prior of a control point; return False for a check point."""
        for point_id, entry in zip(self.targets.point_ids, self.targets.used, strict=True):
            if entry.point.name == name:
                self.others = [one for one in self.others if one.keys != (("point", point_id),)]
                return True
        return False

    def _adjusted_with(self, offset: OffsetCheck) -> OffsetCheck | None:
        """Adjust with an offset; return its test there, None if it is not significant."""
        plain = self.plain
        self.offset = PositionOffset.beside(plain, offset.axes)
        self.value = np.array(offset.value)
        self._adjust()
        found = self._offset()
        if found is not None and found.is_significant:
            return found
        self.plain, self.offset, self.value = plain, None, np.zeros(3)
        return None

    def _adjust(self) -> None:
        """Solve again from the present values."""
        problem = self.plain
        if self.offset is not None:
            problem = self.offset.added_to(problem, self.value)
        options = self.prepared.options.replace(
            function_tolerance=min(TOLERANCE, self.prepared.options.function_tolerance),
            max_num_iterations=MOST_STEPS,
            check_solution=False,
        )
        factors = self._factors(self.offset, self.positions)
        ready = replace(self.prepared.at(problem, options), factors=factors)
        problem = self.solve(ready)
        if self.offset is not None:
            self.value = self.offset.value_in(problem)
            problem = self.offset.taken_from(problem)
        self.plain = problem

    def _factors(
        self, offset: PositionOffset | None, positions: Iterable[PositionFactor]
    ) -> tuple[Factor, ...]:
        if offset is None:
            return (*self.others, *positions)
        free = (offset.of(one, offset.axes) for one in positions)
        return (*self.others, *free, *offset.factors())

    def _offset(self) -> OffsetCheck | None:
        """Test the offset at the present values; None if nothing determines it."""
        if len(self.positions) < FEWEST_POSITIONS:
            return None
        axes = "all" if self.offset is None else self.offset.axes
        moves = np.array(OFFSET_AXES[axes])
        # At o = 0, the covariance of the translation of the pose is that of o.
        shifted = [
            replace(one, position=one.position - self.value * moves) for one in self.positions
        ]
        certainty = self._certainty(self.plain, PositionOffset.beside(self.plain, axes), shifted)
        gradient, of_positions, nu = _pull(self.plain, shifted)
        scale2, dof = max((certainty.scale2, certainty.dof), (of_positions, nu))
        full, value = certainty.last_pose, self.value
        if self.offset is None:
            information = np.linalg.inv(full)
            both, of_up = gradient @ full @ gradient, gradient[2] ** 2 / information[2, 2]
            value = -full @ gradient
            if scaled_tail(float(both - of_up), 2, scale2, dof) >= OffsetCheck.LEVEL:
                axes, moves = "up", np.array(OFFSET_AXES["up"])
                full = np.diag([0, 0, 1 / information[2, 2]])
                value = -full @ gradient
        rows = np.flatnonzero(moves)
        statistic = value[rows] @ np.linalg.solve(full[np.ix_(rows, rows)], value[rows])
        factor = max(scale2, 1.0)
        camera = self.plain.image_camera[0]
        return OffsetCheck(
            axes=axes,
            value=_triple(value * moves),
            sigma=_triple(np.sqrt(np.maximum(np.diag(full), 0) * factor) * moves),
            statistic=float(statistic),
            p=scaled_tail(float(statistic), len(rows), scale2, dof),
            is_estimated=self.is_estimated,
            focal_lengths=(
                float(self.prepared.start.camera_params[camera, 0]),
                float(self.plain.camera_params[camera, 0]),
                float(np.sqrt(certainty.focal_length[camera] * factor)),
            ),
        )

    def _certainty(
        self, problem: Problem, offset: PositionOffset | None, positions: Iterable[PositionFactor]
    ) -> _Certainty:
        """Return the covariances of a state."""
        if offset is not None:
            problem = offset.added_to(problem, self.value if offset is self.offset else np.zeros(3))
        ready = replace(self.prepared.at(problem), factors=self._factors(offset, positions))
        layout = ready.layout
        out = _core.covariance(
            problem, layout.options.asdict(), layout.limits, layout.core_factors(),
            False, False, True, [], False,
        )  # fmt: skip
        dof = out["num_residuals"] - out["num_parameters"] + out["gauge_degrees"]
        return _Certainty(
            last_pose=out["poses"][-1][3:, 3:],
            points=out["points"],
            focal_length=np.nan_to_num(out["cameras"][:, 0, 0]),
            scale2=out["weighted_squares"] / dof if dof > 0 else 1.0,
            dof=dof,
        )


def _pull(problem: Problem, positions: list[PositionFactor]) -> tuple[Array, float, float]:
    """Return the gradient w.r.t. the offset, the mean square and its degrees of freedom."""
    row = {int(one): k for k, one in enumerate(problem.image_ids.tolist())}
    rows = [row[one.key[1]] for one in positions]  # type: ignore[index]
    arms = np.array([one.lever_arm for one in positions])
    turns = rotation_matrices(problem.cam_from_world[rows, :4])
    antennas = problem.projection_centers[rows] + np.einsum("nji,nj->ni", turns, arms)
    gradient, squares, count = np.zeros(3), 0.0, -3
    for one, antenna in zip(positions, antennas, strict=True):
        pull = np.asarray(one.information) @ (antenna - one.position)
        length = float(pull @ (antenna - one.position))
        weight = _weight(one, length)
        gradient += weight * pull
        squares += weight * length
        count += int((np.diag(np.asarray(one.information)) > KNOWN).sum())
    return gradient, squares / count if count > 0 else 1.0, float(count)


def _weight(prior: Any, squared: float) -> float:
    """Return the weight that the loss of a prior gives to a squared length in sigmas."""
    return float(evaluate_loss(prior.loss, prior.loss_scale, np.array([squared]))[0, 1])


def _triple(values: Array) -> tuple[float, float, float]:
    east, north, up = values.tolist()
    return east, north, up
