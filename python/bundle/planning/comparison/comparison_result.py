"""Result of a comparison: problems, runs, profiles, recommendation; read from reports, too.

Performance profiles are the shares of problems that a method solves within a factor of the fastest.
E. D. Dolan and J. J. More, Benchmarking optimization software with performance profiles,
Mathematical Programming 91 (2002). Let t(p, s) be the time of method s on problem p and r(p, s) =
t(p, s) / min over s' of t(p, s'). The profile of s is

    rho_s(tau) = share of problems with r(p, s) <= tau,

so rho_s(1) is the share of problems on which s is the fastest, and rho_s at large tau the share
that s solves at all. t is the time to a cost within a gap of the best known cost. All methods are
thus compared at the same accuracy, independent of their stopping rules.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import at
from bundle.base.display import Display, Displayed
from bundle.base.paths import as_path
from bundle.base.records import dataclass
from bundle.base.words import contents, format_size, plural, seconds
from bundle.errors import InputError, brief, shown
from bundle.interface.environment import Environment
from bundle.interface.options import SolveOptions
from bundle.interface.summary import Summary
from bundle.interface.tabular import Tabular
from bundle.planning.comparison.measured_run import Measurement, Method, Prediction, Run

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


@dataclass(frozen=True, kw_only=True)
class PerformanceProfile:
    """Share of problems that a method solves within a factor of the fastest (Dolan and More 2002).

    A problem is solved when the cost is within ``gap`` of the best; the measure is the time to it.
    """

    method: Method
    gap: float
    # time of ``method`` divided by that of the fastest method, for each problem that ``method``
    # solved; ascending
    ratios: tuple[float, ...]
    num_problems: int  # problems that at least one method solved

    def share(self, factor: float) -> float:
        """Return the share of problems solved within this factor of the fastest, 0 to 1."""
        return sum(ratio <= factor for ratio in self.ratios) / max(self.num_problems, 1)


def performance_profiles(
    times: Sequence[Mapping[Method, float]], methods: Sequence[Method], gap: float
) -> tuple[PerformanceProfile, ...]:
    """Return one profile per method.

    ``times``: for each problem the seconds of each method; NaN or missing if not solved. Problems
    that no method solved are left out.
    """
    fastest = [
        min((time for time in row.values() if math.isfinite(time)), default=math.nan)
        for row in times
    ]
    solved = [(row, best) for row, best in zip(times, fastest, strict=True) if math.isfinite(best)]
    profiles = []
    for method in methods:
        own = ((row.get(method, math.nan), best) for row, best in solved)
        ratios = sorted(_ratio(time, best) for time, best in own if math.isfinite(time))
        profiles.append(
            PerformanceProfile(
                method=method, gap=gap, ratios=tuple(ratios), num_problems=len(solved)
            )
        )
    return tuple(profiles)


def _ratio(time: float, best: float) -> float:
    if best > 0:
        return time / best
    return 1.0 if time <= 0 else math.inf  # clock resolution too coarse


Entry = Mapping[str, Any]
_Kind = TypeVar("_Kind")

_TRACE = ("iteration", "cost", "step_is_successful", "cumulative_time_in_seconds")


def read_comparison(path: str | os.PathLike[str]) -> Comparison:
    """Read a comparison from the report of ``bundle compare --json FILE``.

    It has all runs, repeats, iterations and conditions, so that ``bundle.pictures`` and
    ``bundle.html.write_comparison`` draw the same figures as at the time of the measurement.

    Raises:
        InputError: the file is not a complete report on reconstructions.
        OSError: the file cannot be read.

    Example:
        >>> comparison = bundle.read_comparison("measured.json")
        >>> bundle.pictures.draw_cost_against_time(ax, comparison)
    """
    text = Path(as_path(path)).read_text(encoding="utf-8", errors="replace")
    place = shown(os.fspath(path))
    expected = f"{place}: expected a report of bundle compare --json"
    with at(f"{expected}, found no JSON", ValueError):
        report = json.loads(text)
    if not isinstance(report, dict) or report.get("command") != "compare":
        found = report.get("command") if isinstance(report, dict) else report
        raise InputError(f"{expected}, found {brief(found)}")
    if "inputs" not in report:
        raise InputError(f"{expected} on reconstructions, found a comparison on a pose graph")
    try:
        return _comparison(report)
    except KeyError as error:
        raise InputError(f"{place}: expected an entry {error}, it is missing") from None
    except (TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{expected}, found other contents: {error}") from None


def _comparison(report: Entry) -> Comparison:
    found = report["recommendation"]
    return _record(
        Comparison,
        report,
        problems=tuple(_problem(k, entry) for k, entry in enumerate(report["inputs"])),
        runs=tuple(map(_run, report["runs"])),
        profiles=tuple(map(_profile, report["profiles"])),
        recommendation=None if found is None else _recommendation(found),
        options=_options(report["options"]),
        timeout=report["timeout_in_seconds"],
        wall_time_in_seconds=report["wall_time"]["total"],
        environment=_record(Environment, report["environment"]),
    )


def _problem(index: int, entry: Entry) -> ComparedProblem:
    path = entry["path"]
    name = f"problem {index + 1}" if path is None else path
    return _record(ComparedProblem, entry, name=name, is_file=path is not None)


def _options(entry: Entry) -> SolveOptions:
    known = {field.name: field.default for field in dataclasses.fields(SolveOptions)}
    given = {name: value for name, value in entry.items() if name in known and value is not None}
    return SolveOptions(**given)


def _method(entry: Entry) -> Method:
    return _record(Method, {k: v.lower() if isinstance(v, str) else v for k, v in entry.items()})


def _run(entry: Entry) -> Run:
    unfinished, prediction = entry["unfinished"], entry["prediction"]
    return _record(
        Run,
        entry,
        problem=entry["input"],
        method=_method(entry["method"]),
        outcome=entry["outcome"].lower(),
        measurements=tuple(map(_measurement, entry["measurements"])),
        unfinished=_columns(unfinished) if unfinished else None,
        prediction=None if prediction is None else _record(Prediction, prediction),
        minimum=-1 if entry["minimum"] is None else entry["minimum"],
    )


def _measurement(entry: Entry) -> Measurement:
    added = entry["added_memory_in_bytes"]
    return _record(
        Measurement,
        entry,
        summary=_record(Summary, entry["summary"], processes=None),
        iterations=_columns(entry["iterations"]),
        added_memory_in_bytes=-1 if added is None else added,
    )


def _profile(entry: Entry) -> PerformanceProfile:
    ratios = tuple(math.inf if ratio is None else ratio for ratio in entry["ratios"])
    return _record(PerformanceProfile, entry, method=_method(entry["method"]), ratios=ratios)


def _recommendation(entry: Entry) -> Recommendation:
    foreseen = tuple(one and _method(one) for one in entry["foreseen"])
    return _record(Recommendation, entry, method=_method(entry["method"]), foreseen=foreseen)


def _record(kind: type[_Kind], entry: Entry, **changed: Any) -> _Kind:
    """Return a dataclass from its fields in JSON: lists are tuples, and null is NaN in numbers."""
    values = {}
    for field in dataclasses.fields(kind):  # type: ignore[arg-type]
        value = changed[field.name] if field.name in changed else entry[field.name]
        if value is None and field.type == "float":
            value = math.nan
        values[field.name] = tuple(value) if isinstance(value, list) else value
    return kind(**values)


def _columns(rows: Sequence[Entry]) -> dict[str, NDArray[Any]]:
    """Return one array per entry of the iterations; numbers that are null become NaN."""
    if not rows:
        return {name: np.empty(0) for name in _TRACE}
    return {
        name: np.array([math.nan if row[name] is None else row[name] for row in rows])
        for name in rows[0]
    }
