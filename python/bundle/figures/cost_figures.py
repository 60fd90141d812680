"""Figures of costs: by iteration, of compared methods, predicted and measured."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.figures.marks import Array, Bars, Figure, StackedBars, Steps, linear, logarithmic
from bundle.planning.comparison.comparison_result import Comparison, PerformanceProfile
from bundle.planning.comparison.graph_comparison import GraphComparison, GraphRun, best_cost
from bundle.planning.comparison.measured_run import Method

WIDE = 30.0  # ratio of costs above which the axis is logarithmic


def iteration_figure(cost: Array) -> Figure:
    """Return the cost by iteration; for a small decrease, the difference to the final cost."""
    count = float(len(cost))
    last = cost[np.isfinite(cost)][-1:]
    positive = cost[np.isfinite(cost) & (cost > 0)]
    if len(positive) and positive.max() > WIDE * positive.min():
        values, y = cost, logarithmic(positive.tolist(), "cost, log scale")
    else:  # on an axis of complete decades, a small decrease would be invisible
        label = "cost above the last, % of the first"
        values = 100.0 * (cost - last) / cost[0] if cost[0] else 0.0 * cost
        y = linear(values.tolist(), label, low=min(0.0, float(np.nanmin(values))))
    x = linear([0.0, count], "iteration")
    whole = tuple(tick for tick in x.ticks if tick == int(tick))
    shown = np.where(np.isfinite(values), values, y.high)
    return Figure(
        name="cost",
        title="Cost by iteration",
        x=replace(x, ticks=whole),
        y=y,
        marks=(Steps("cost", np.arange(count + 1), shown),),
    )


def time_figure(comparison: Comparison, problem: int, *, outcomes: bool = False) -> Figure:
    """Return the distance of each run's cost to the best cost against time, both logarithmic.

    With ``outcomes``, labels of runs without a usable solution say why.
    """
    names, looks = labels(comparison.methods), styles(comparison.methods)
    marks = []
    for index, run in enumerate(comparison.runs):
        times, gaps = cost_curve(comparison, index)
        if run.problem == problem and len(times):
            look = looks[run.method]
            name = names[run.method]
            if outcomes and not run.is_usable:
                name += f" ({run.outcome.replace('_', ' ')})"
            marks.append(Steps(name, times, gaps, look.colour, look.line))
    return cost_against_time(marks, "the loaded problem")


def cost_against_time(marks: Sequence[Steps], start: str) -> Figure:
    """Return gaps to the best cost against the seconds from ``start`` on, both logarithmic."""
    return Figure(
        name="cost_against_time",
        title="Cost against time",
        x=logarithmic(_values(mark.x for mark in marks), f"seconds from {start} on"),
        y=logarithmic(_values(mark.y for mark in marks), "cost / best cost - 1"),
        marks=tuple(marks),
    )


def breakdown_figure(comparison: Comparison, problem: int) -> Figure:
    """Return the phases of each run as stacked bars, the fastest on top."""
    names = labels(comparison.methods)
    runs = [run for run in comparison.runs_of(problem) if run.is_usable and run.measurement]
    runs.sort(key=lambda run: run.total_time_in_seconds)
    rows = {names[run.method]: run.measurement.breakdown for run in runs if run.measurement}
    return Figure(
        name="breakdown",
        title="Where the time went",
        marks=(StackedBars(rows, " s"),),
        note="The fused backend eliminates the points while it computes Jacobians: the time of its "
        "linear solver is that of the reduced system only.",
    )


def profile_figure(comparison: Comparison, gap: float) -> Figure:
    """Return the share of problems that each method solves within a factor of the fastest."""
    names, looks = labels(comparison.methods), styles(comparison.methods)
    profiles = [profile for profile in comparison.profiles if profile.gap == gap]
    ratios = [ratio for profile in profiles for ratio in profile.ratios]
    x = logarithmic([1.0, *ratios], "time / that of the fastest method")
    marks = []
    for profile in profiles:
        factors, shares = profile_curve(profile, x.high)
        look = looks[profile.method]
        marks.append(Steps(names[profile.method], factors, shares, look.colour, look.line))
    return Figure(
        name="profile",
        title=f"To {gap:g} of the best cost",
        x=x,
        y=linear([0.0, 1.0], "share of problems"),
        marks=tuple(marks),
    )


def column_figure(profiles: Mapping[str, Sequence[float] | Array]) -> Figure:
    """Return nonzeros below the diagonal of L by column, for each method.

    Profiles may have any number of bins; each profile extends over the full width of L.
    """
    marks = []
    for index, (name, profile) in enumerate(profiles.items()):
        counts = np.asarray(profile, float)
        place = np.linspace(0.0, 1.0, len(counts) + 1)
        # Dash an order that has the colour of another order.
        marks.append(Steps(name, place, counts, index % 10, index // 10))
    return Figure(
        name="column_counts",
        title="Column counts of L",
        x=linear([0.0, 1.0], "share of columns, as eliminated"),
        y=linear(_values(mark.y for mark in marks), "nonzeros below the diagonal"),
        marks=tuple(mark for mark in marks if len(mark.y)),
    )


def bar_figure(
    name: str,
    title: str,
    values: Mapping[str, float],
    show: Callable[[float], str],
    impossible: Collection[str] = (),
    most: int | None = None,
) -> Figure:
    """Return one bar per value; see :class:`Bars`."""
    bars = Bars(values, show, impossible, most=most)
    return Figure(name=name, title=title, marks=(bars,))


def _values(parts: Iterable[Array]) -> list[float]:
    return [value for part in parts for value in part.tolist()]


MOST_DRAWN = 8  # number of the fastest methods in a figure

PHASES = {
    "set-up": "preprocessor_time_in_seconds",
    "Jacobians": "jacobian_evaluation_time_in_seconds",
    "residuals": "residual_evaluation_time_in_seconds",
    "linear solver": "linear_solver_time_in_seconds",
}


def graph_time_figure(found: GraphComparison) -> Figure:
    """Return the distance of each run's cost to the best cost against time, both logarithmic."""
    best = best_cost(found.runs)
    marks = []
    backends = list(dict.fromkeys(_backend(run) for run in found.runs))
    for colour, run in enumerate(_fastest(found)):
        table = run.result.iterations
        times, costs = table["cumulative_time_in_seconds"], table["cost"]
        known = np.isfinite(costs) & (times > 0)
        if known.any() and np.isfinite(best):
            gaps = gaps_to(best, costs[known])
            line = backends.index(_backend(run))
            marks.append(Steps(_name(found, run), times[known], gaps, colour, line))
    return cost_against_time(marks, "the start")


def graph_breakdown_figure(found: GraphComparison) -> Figure:
    """Return the phases of each run as stacked bars, the fastest on top."""
    rows = {}
    for run in _fastest(found):
        summary = run.result.summary
        parts = {name: float(getattr(summary, field) or 0.0) for name, field in PHASES.items()}
        rest = float(summary.total_time_in_seconds or 0.0) - sum(parts.values())
        rows[_name(found, run)] = parts | {"rest": max(0.0, rest)}
    return Figure(name="breakdown", title="Where the time went", marks=(StackedBars(rows, " s"),))


def _fastest(found: GraphComparison) -> Sequence[GraphRun]:
    usable = [run for run in found.runs if not run.failure and run.result is not None]
    return sorted(usable, key=lambda run: run.time_in_seconds)[:MOST_DRAWN]


def _backend(run: GraphRun) -> str:
    return str(getattr(run.method, "backend", ""))


def _name(found: GraphComparison, run: GraphRun) -> str:
    several = len({one.method.num_threads for one in found.runs}) > 1
    return f"{run.method.name}, {run.method.num_threads}" if several else str(run.method.name)


# Costs of different solvers agree to about this; smaller differences are due to chance.
SMALLEST_GAP = 1e-9


@dataclass(frozen=True)
class Style:
    """Drawing style of a method in all figures: a colour for all backends, a line for each."""

    colour: int
    line: int


def styles(methods: tuple[Method, ...]) -> dict[Method, Style]:
    """Return a style for each method: colour by linear solver and trust region, line by backend."""
    kinds: dict[tuple[str, ...], int] = {}
    lines: dict[tuple[str, int], int] = {}
    for method in sorted(methods, key=lambda method: -method.num_threads):
        lines.setdefault((method.backend, method.num_threads), len(lines))
    for method in methods:
        kinds.setdefault(_kind(method), len(kinds))
    return {
        method: Style(kinds[_kind(method)], lines[method.backend, method.num_threads])
        for method in methods
    }


def labels(methods: tuple[Method, ...]) -> dict[Method, str]:
    """Return the name of each method, with its thread count if the methods differ in it."""
    several = len({method.num_threads for method in methods}) > 1
    return {
        method: f"{method.name}, {method.threads}" if several else method.name for method in methods
    }


def cost_curve(comparison: Comparison, run: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (seconds, lowest cost so far / best of all - 1) of a run, empty without a trace.

    Relative distances below 1e-9 become 1e-9. If the best cost is 0, the second array is the cost.
    """
    times, costs = comparison.runs[run].trace
    best = comparison.best_cost(comparison.runs[run].problem)
    if len(costs) == 0 or not np.isfinite(best):
        return np.empty(0), np.empty(0)
    return times, gaps_to(best, costs)


def gaps_to(best: float, costs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the lowest cost so far / best - 1, as in :func:`cost_curve`."""
    lowest = np.minimum.accumulate(costs)
    gaps = lowest / best - 1.0 if best > 0 else lowest
    return np.maximum(gaps, SMALLEST_GAP)


def profile_curve(
    profile: PerformanceProfile, largest: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the corners (factor, share) of a profile's steps from factor 1 to the largest."""
    factors = np.array([1.0, *(ratio for ratio in profile.ratios if 1.0 < ratio <= largest)])
    shares = np.array([profile.share(factor) for factor in factors])
    return np.append(factors, largest), np.append(shares, shares[-1])


def _kind(method: Method) -> tuple[str, ...]:
    return (
        method.linear_solver_type,
        method.preconditioner_type,
        method.linear_solver_ordering,
        method.trust_region_strategy_type,
    )
