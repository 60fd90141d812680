"""The result of a solve."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bundle.base.display import Display
from bundle.base.words import change, contents, pixels, plural, seconds
from bundle.interface.solve_record import SolveRecord
from bundle.interface.summary import held_facts
from bundle.model.clipped_errors import HeldOut
from bundle.model.problem import Problem
from bundle.model.reprojection import (
    ReprojectionError,
    reprojection_error,
    reprojection_errors,
    resolve_cheirality,
    summarize_errors,
)
from bundle.model.worst_images import ImageError, worst_images, worst_of_errors
from bundle.solving.constraints.camera_bounds import ActiveBound
from bundle.solving.constraints.constraint_record import RuleEnd
from bundle.solving.gauge_freedom import GaugeFreedom, gauge_freedom
from bundle.solving.round_record import PartRecord, Round

if TYPE_CHECKING:
    from bundle.georeference.alignment_result import ControlPointError
    from bundle.georeference.similarity import Similarity

__all__ = ["Result"]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Result(SolveRecord):
    """A refined problem, and the record of its solve.

    Attributes:
        problem: the refined problem.
        initial_problem: the input, unchanged.
        options: every option as used.
        summary: summary of the solver.
        iterations: one array per field of Ceres' IterationSummary, with one entry per iteration.
        build_time_in_seconds: time to build the solver's problem from the arrays and to copy the
            values back, outside the solver.
        solve_time_in_seconds: time inside the solver.
        factor_costs_before: (num_factors,) cost 1/2 rho(||r||^2) of each additional factor at the
            input, in the order given; nan if the factor has no value there.
        factor_costs_after: the same costs at the output.
        active_bounds: the bounds that camera parameters reach at the end: key of the camera, name
            of the parameter, "lower" or "upper".
        constraints: outcome of each rule: pulls of priors in sigmas, active bounds, ties.
        similarity: similarity that moved the input to its priors before the solve; None if nothing
            moved. ``initial_problem`` is the input before this motion.
        control_points: ground control and check points, in the order given. Each residual is the
            position triangulated by the refined cameras, minus the surveyed position.
        rounds: rounds of :func:`bundle.solve_rounds`. Options, summary, iterations and times belong
            to the last adjustment.
        part: the images and points that took part, if only some images were refined. Costs belong
            to this part, reprojection errors to the entire problem.
        held_out: errors of the observations that ``hold_out`` held out, in a second fit without
            them, beside the errors of the observations that this fit saw. All other attributes
            describe the fit to all observations. None: not requested, or the solve was interrupted
            or has no usable solution.
    """

    problem: Problem
    initial_problem: Problem
    factor_costs_before: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    factor_costs_after: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    active_bounds: tuple[ActiveBound, ...] = ()
    constraints: tuple[RuleEnd, ...] = ()
    similarity: Similarity | None = None
    control_points: tuple[ControlPointError, ...] = ()
    rounds: tuple[Round, ...] = ()
    part: PartRecord | None = None
    held_out: HeldOut | None = None

    @cached_property
    def reprojection_error_before(self) -> ReprojectionError:
        """Statistics in pixels at the input, computed at the first access."""
        return self._measure(self.initial_problem)

    @cached_property
    def reprojection_error_after(self) -> ReprojectionError:
        """Statistics in pixels at the output, computed at the first access."""
        return self._measure(self.problem)

    @cached_property
    def worst_images(self) -> tuple[ImageError, ...]:
        """Images with the largest errors at the output, computed at the first access."""
        options = self.options
        return worst_images(self.problem, options.cheirality, num_threads=options.num_threads)

    @cached_property
    def gauge_freedom(self) -> GaugeFreedom:
        """Degrees of freedom that the observations leave undetermined at the input."""
        return gauge_freedom(self.initial_problem, self.options)

    def measure(self) -> None:
        """Measure the statistics now; later access takes no time."""
        _ = self.reprojection_error_before
        if {"reprojection_error_after", "worst_images"} <= vars(self).keys():
            return
        # Both statistics use the same errors, which are computed once and not stored.
        problem, options = self.problem, self.options
        cheirality = resolve_cheirality(problem, options.cheirality)
        errors, behind = reprojection_errors(
            problem, cheirality=cheirality, num_threads=options.num_threads
        )
        values = vars(self)  # storage of cached_property; the dataclass itself is frozen
        values["worst_images"] = worst_of_errors(problem, errors, behind, cheirality)
        values["reprojection_error_after"] = summarize_errors(errors, behind, cheirality)

    def _held_out_facts(self) -> tuple[tuple[str, str], ...]:
        if self.held_out is None:
            return ()
        held, fitted = self.held_out, self.held_out.fitted
        return (
            (
                "held out",
                f"{plural(held.num_observations, 'observation')}, RMSE clipped at {held.clip:g} px "
                f"{pixels(held.clipped_rmse)} px, of the fitted {pixels(fitted.clipped_rmse)} px",
            ),
        )

    def _factor_facts(self) -> tuple[tuple[str, str], ...]:
        count = self.summary.num_factors
        if count == 0:
            return ()
        before, after = float(self.factor_costs_before.sum()), float(self.factor_costs_after.sum())
        return (("factors", f"{count}, cost {change(before, after)}"),)

    def _place_facts(self) -> tuple[tuple[str, str], ...]:
        if self.similarity is None:
            return ()
        return (("moved", f"to its priors, {self.similarity.scale:.6g} times as large"),)

    def _bound_facts(self) -> tuple[tuple[str, str], ...]:
        bounds = [f"{name} of camera {key[1]} ({side})" for key, name, side in self.active_bounds]
        if not bounds:
            return ()
        more = f" and {len(bounds) - 3} more" if len(bounds) > 3 else ""
        return (("at bounds", ", ".join(bounds[:3]) + more),)

    def _rule_facts(self) -> tuple[tuple[str, str], ...]:
        if not self.constraints:
            return ()
        pulls = [prior for rule in self.constraints for prior in rule.priors]
        words = plural(len(self.constraints), "rule")
        if pulls:
            most = max(pulls, key=lambda prior: abs(prior.pull))
            words += (
                f", {plural(len(pulls), 'prior')}; the largest pull is {most.pull:+.3g} sigmas, "
                f"{most.parameter} of {most.subject} {most.id}"
            )
        return (("constraints", words),)

    def _round_facts(self) -> tuple[tuple[str, str], ...]:
        if not self.rounds:
            return ()
        observations = sum(done.num_observations_removed for done in self.rounds)
        points = sum(done.num_points_removed for done in self.rounds)
        return (
            (
                "rounds",
                f"{len(self.rounds)}; {plural(observations, 'observation')} and "
                f"{plural(points, 'point')} removed",
            ),
        )

    def _measure(self, problem: Problem) -> ReprojectionError:
        options = self.options
        return reprojection_error(problem, options.cheirality, num_threads=options.num_threads)

    def _display(self) -> Display:
        summary = self.summary
        before, after = self.reprojection_error_before, self.reprojection_error_after
        solver = f"{summary.backend_used} {summary.linear_solver_type_used}"
        facts = [
            (
                "last adjustment's cost" if self.rounds else "cost",
                change(summary.initial_cost, summary.final_cost),
            ),
            *held_facts(summary),
            ("RMSE", f"{pixels(before.rmse)} -> {pixels(after.rmse)} px"),
            *self._held_out_facts(),
            ("time", f"{seconds(self.build_time_in_seconds + self.solve_time_in_seconds)} s"),
            ("solver", f"{solver} on {plural(summary.num_threads_used, 'thread')}"),
            ("problem", contents(self.problem)),
            *self._round_facts(),
            *self._factor_facts(),
            *self._place_facts(),
            *self._bound_facts(),
            *self._rule_facts(),
            *(("warning", warning) for warning in summary.warnings),
        ]
        return Display(title=f"Result: {self.outcome}", facts=tuple(facts))
