"""The result of a solve."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bundle.base.display import Display
from bundle.base.records import dataclass
from bundle.base.words import change, contents, few, plural, seconds
from bundle.interface.summary import held_facts
from bundle.solving.headline import edit_facts, headline
from bundle.solving.measured_result import MeasuredResult

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Result(MeasuredResult):
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
        edits: changes of the input before the solve, in order.
        tracks: rounds of :func:`bundle.refine_tracks`.
        observation_mask: mask of the observations of the input that the output has; None: all.
        observation_rows: their rows in the output, which may have further observations; None: the
            output has no others.
        factors: factors of the solve in addition to the observations; () after unpickling.
        priors: measured positions, attitudes and control points of the solve; () after unpickling.
    """

    def to_dataframe(self, table: str | None = None) -> pandas.DataFrame:
        """Return a table as a pandas.DataFrame; pandas is the extra ``tables``.

        Args:
            table: "iterations" (default), "constraints", "control_points", "rounds", "edits", or a
                table of the refined problem: see :meth:`bundle.Problem.to_dataframe`.

        Raises:
            InputError: the table is unknown, or pandas is not installed.
        """
        if table is None or table in self._tables():
            return super().to_dataframe(table)
        return self.problem.to_dataframe(table)

    def _factor_facts(self) -> tuple[tuple[str, str], ...]:
        count = self.summary.num_factors
        if count == 0:
            return ()
        before, after = float(self.factor_costs_before.sum()), float(self.factor_costs_after.sum())
        return (("factors", f"{count}, cost {change(before, after)}"),)

    def _place_facts(self) -> list[tuple[str, str]]:
        facts, moved = [], self.similarity
        if moved is not None:
            facts.append(("moved", f"to its priors, {moved.scale:.6g} times as large"))
        bounds = [f"{name} of camera {key[1]} ({side})" for key, name, side in self.active_bounds]
        return [*facts, ("at bounds", few(bounds))] if bounds else facts

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

    def _display(self) -> Display:
        summary = self.summary
        verdict, *others = headline(self)
        solver = f"{summary.backend_used} {summary.linear_solver_type_used}"
        facts = [
            *(("", sentence) for sentence in others),
            *edit_facts(self),
            (self.cost_name, change(summary.initial_cost, summary.final_cost)),
            *held_facts(summary),
            ("time", f"{seconds(self.build_time_in_seconds + self.solve_time_in_seconds)} s"),
            ("solver", f"{solver} on {plural(summary.num_threads_used, 'thread')}"),
            ("problem", contents(self.problem)),
            *self._round_facts(),
            *self._factor_facts(),
            *self._place_facts(),
            *self._rule_facts(),
            *(("warning", warning) for warning in summary.warnings),
        ]
        return Display(title=f"Result: {verdict}", facts=tuple(facts))
