"""Performance profiles: share of problems that a method solves within a factor of the fastest.

E. D. Dolan and J. J. More, Benchmarking optimization software with performance profiles,
Mathematical Programming 91 (2002). Let t(p, s) be the time of method s on problem p and r(p, s) =
t(p, s) / min over s' of t(p, s'). The profile of s is

    rho_s(tau) = share of problems with r(p, s) <= tau,

so rho_s(1) is the share of problems on which s is the fastest, and rho_s at large tau the share
that s solves at all. t is the time to a cost within a gap of the best known cost. All methods are
thus compared at the same accuracy, independent of their stopping rules.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from bundle.base.records import dataclass
from bundle.planning.comparison.method import Method


@dataclass(frozen=True, kw_only=True)
class PerformanceProfile:
    """Share of problems that a method solves within a factor of the fastest (Dolan and More 2002).

    A problem is solved when the cost is within ``gap`` of the best; the measure is the time to it.

    Attributes:
        ratios: time of ``method`` divided by that of the fastest method, for each problem that
            ``method`` solved; ascending.
        num_problems: problems that at least one method solved.
    """

    method: Method
    gap: float
    ratios: tuple[float, ...]
    num_problems: int

    def share(self, factor: float) -> float:
        """Return the share of problems solved within this factor of the fastest, 0 to 1."""
        return sum(ratio <= factor for ratio in self.ratios) / max(self.num_problems, 1)


def performance_profiles(
    times: Sequence[Mapping[Method, float]], methods: Sequence[Method], gap: float
) -> tuple[PerformanceProfile, ...]:
    """Return one profile per method.

    Args:
        times: for each problem the seconds of each method; NaN or missing if not solved. Problems
            that no method solved are left out.
        methods: methods to profile.
        gap: gap of these times.
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
