"""Result of a comparison: problems, runs, profiles, recommendation."""

from __future__ import annotations

import math

from bundle.base.display import Display, Displayed
from bundle.base.memory_sizes import format_size
from bundle.base.records import dataclass
from bundle.base.words import contents, plural, seconds
from bundle.errors import shown
from bundle.interface.environment import Environment
from bundle.interface.options import SolveOptions
from bundle.interface.tabular import Tabular
from bundle.planning.comparison.measured_run import Run
from bundle.planning.comparison.method import Method
from bundle.planning.comparison.profiles import PerformanceProfile

GAPS = (1e-2, 1e-3, 1e-5)
"""Relative distances to the best cost at which methods are compared by time."""

AT_MINIMUM = 1e-3
"""Relative distance of the start's cost to the best cost, below which the input is at its minimum:
the recommendation counts such costs as equally good, so that there is nothing to compare."""


@dataclass(frozen=True, kw_only=True)
class ComparedProblem:
    """One input; ``name`` is the path of its file, or "problem 1" for a problem in memory."""

    name: str
    is_file: bool
    format: str
    num_cameras: int
    num_images: int
    num_points: int
    num_observations: int


@dataclass(frozen=True, kw_only=True)
class Recommendation:
    """Recommended method and the reason.

    Attributes:
        reason: one or two sentences that begin with the method's name.
        command: `bundle refine` command line of the method.
        foreseen: for each problem the method that was predicted to be the fastest; None without a
            prediction.
        verdict: comparison of prediction and measurement in one sentence; "" without a prediction.
    """

    method: Method
    reason: str
    command: str
    foreseen: tuple[Method | None, ...] = ()
    verdict: str = ""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Comparison(Displayed, Tabular):
    """Solves of the same start by several methods.

    Attributes:
        problems: the solved problems.
        runs: one per problem and method, problem by problem, methods in the requested order.
        profiles: one per gap of ``GAPS`` and method; empty with one problem.
        recommendation: None if no run has a usable solution.
        options: options of every solve, except those that the methods vary.
        repeat: requested runs of each method; long runs are not repeated.
        timeout: seconds after which a solve was stopped.
        memory_cap_in_bytes: bytes that a solve could allocate beyond the loaded problem.
        interrupted: True if Ctrl-C ended the comparison.
        wall_time_in_seconds: total wall time.
        environment: machine, load, versions and date.
        perturb: relative size of the perturbation of the start; 0: none.
        seed: seed of the perturbation.
    """

    problems: tuple[ComparedProblem, ...]
    runs: tuple[Run, ...]
    profiles: tuple[PerformanceProfile, ...]
    recommendation: Recommendation | None
    options: SolveOptions
    repeat: int
    timeout: float
    memory_cap_in_bytes: int
    interrupted: bool
    wall_time_in_seconds: float
    environment: Environment
    perturb: float = 0.0
    seed: int = 0

    @property
    def methods(self) -> tuple[Method, ...]:
        """All methods in the requested order."""
        return tuple(dict.fromkeys(run.method for run in self.runs))

    def runs_of(self, problem: int) -> tuple[Run, ...]:
        """Return the runs on one problem."""
        return tuple(run for run in self.runs if run.problem == problem)

    def best_cost(self, problem: int) -> float:
        """Return the lowest final cost of a problem; NaN if no run has a usable solution."""
        costs = [run.final_cost for run in self.runs_of(problem) if run.is_usable]
        return min(costs, default=math.nan)

    def gap(self, run: Run) -> float:
        """Return a run's final cost / the best one - 1; NaN without a usable solution."""
        best = self.best_cost(run.problem)
        return run.final_cost / best - 1 if best > 0 else run.final_cost - best

    def time_to_gap(self, run: Run, gap: float) -> float:
        """Return the seconds to (1 + gap) times the best cost; NaN if it was not reached."""
        return run.time_to((1 + gap) * self.best_cost(run.problem))

    def start_gap(self, problem: int) -> float:
        """Return the start's cost / the best final cost - 1; NaN if no run is usable."""
        best = self.best_cost(problem)
        runs = [run for run in self.runs_of(problem) if run.is_usable]
        starts = [float(run.trace[1][0]) for run in runs if len(run.trace[1])]
        if not starts:
            return math.nan
        return starts[0] / best - 1 if best > 0 else starts[0] - best

    def is_at_minimum(self, problem: int) -> bool:
        """Return True if the start is at a minimum: no method can lower its cost notably."""
        return self.start_gap(problem) <= AT_MINIMUM

    def minima(self, problem: int) -> tuple[tuple[Run, ...], ...]:
        """Return the usable runs by the minimum at which they ended, the lowest cost first.

        Runs with an unknown minimum are left out.
        """
        groups: dict[int, list[Run]] = {}
        for run in self.runs_of(problem):
            if run.is_usable and run.minimum >= 0:
                groups.setdefault(run.minimum, []).append(run)
        return tuple(tuple(groups[number]) for number in sorted(groups))

    def _display(self) -> Display:
        facts = [(shown(problem.name), contents(problem)) for problem in self.problems]
        found = self.recommendation
        if found is None:
            facts.append(("recommended", "none: no method has a usable solution"))
        else:
            facts += [("recommended", found.reason), ("command", found.command)]
        return Display(
            title=f"Comparison of {plural(len(self.methods), 'method')}"
            f"{', interrupted' if self.interrupted else ''}",
            facts=tuple(facts),
            head=("method", "threads", "problem", "outcome", "gap", "time [s]", "peak memory"),
            rows=tuple(self._row(run) for run in self.runs),
        )

    def _row(self, run: Run) -> tuple[str, ...]:
        gap = self.gap(run)
        return (
            run.method.name,
            str(run.method.num_threads),
            str(run.problem + 1),
            run.outcome.replace("_", " "),
            f"{gap:.0e}" if math.isfinite(gap) else "-",
            seconds(run.total_time_in_seconds),
            format_size(run.peak_memory_in_bytes),
        )
