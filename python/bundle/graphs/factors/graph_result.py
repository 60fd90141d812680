"""What the solve of a factor graph gives back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from bundle.base.display import Display
from bundle.base.words import change, plural, seconds
from bundle.graphs.factors.variables import Array, Key
from bundle.interface.solve_record import SolveRecord

__all__ = ["GraphResult"]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class GraphResult(SolveRecord):
    """The values that a solve found and how it came about.

    Attributes:
        values: one array a variable, by key, as its manifold stores it.
        options: every option as used.
        summary: what the solver says; costs are 1/2 sum rho(||r||^2) over the factors.
        iterations: one array a field of Ceres' IterationSummary, one entry an iteration.
        build_time_in_seconds: outside the solver.
        solve_time_in_seconds: inside the solver.
    """

    values: Mapping[Key, Array]

    def _display(self) -> Display:
        summary = self.summary
        facts = [
            ("cost", change(summary.initial_cost, summary.final_cost)),
            ("time", f"{seconds(self.build_time_in_seconds + self.solve_time_in_seconds)} s"),
            ("solver", f"{summary.backend_used} {summary.linear_solver_type_used}"),
            ("graph", f"{plural(len(self.values), 'variable')}"),
            *(("warning", warning) for warning in summary.warnings),
        ]
        return Display(title=f"GraphResult: {self.outcome}", facts=tuple(facts))
