"""Curves of a comparison as numbers, and the drawing styles of its methods."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.planning.comparison.comparison_result import Comparison, PerformanceProfile
from bundle.planning.comparison.method import Method

# Costs of different solvers agree to about this; smaller differences are due to chance.
SMALLEST_GAP = 1e-9


@dataclass(frozen=True)
class Style:
    """Drawing style of a method in all figures.

    Attributes:
        colour: index from 0, the same for all backends and thread counts.
        line: index from 0, one per backend.
    """

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
