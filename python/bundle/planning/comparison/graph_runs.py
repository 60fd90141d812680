"""Measured solves of a graph by several methods, and the choice among them."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from bundle.base.records import dataclass
from bundle.base.words import number, plural, seconds
from bundle.errors import InputError
from bundle.interface.compare_options import SECONDS_NOT_REPEATED

NEAR_ENOUGH = 1.15
"""Factor of the shortest time within which methods count as equally fast."""

COST_TOLERANCE = 1e-6
"""Relative distance to the best final cost within which solutions count as equally good."""

DIAGNOSE = "run bundle diagnose to find the cause"


@dataclass(frozen=True, kw_only=True)
class GraphRun:
    """Measurement of one method.

    Attributes:
        method: the method, an object with a ``name``.
        times_in_seconds: time of each solve, without reading and without the start.
        final_cost: 1/2 sum rho; NaN after a failure.
        chi2_final: sum of squares without 1/2 and without loss; NaN after a failure.
        num_steps: number of attempted steps.
        termination_type: as in a summary, or "TIMEOUT".
        failure: reason for a missing solution, as a sentence; "" with a solution.
        warnings: warnings of the solve.
        result: the last solve; None after a failure.
        predicted_time_per_step_in_seconds: prediction of :func:`bundle.inspect`; NaN without one.
    """

    method: Any
    times_in_seconds: tuple[float, ...]
    final_cost: float
    chi2_final: float
    num_steps: int
    termination_type: str
    failure: str = ""
    warnings: tuple[str, ...] = ()
    result: Any = None
    predicted_time_per_step_in_seconds: float = math.nan

    @property
    def time_per_step_in_seconds(self) -> float:
        """Median time of the steps of the last solve; NaN without a step."""
        if self.result is None or self.num_steps < 1:
            return math.nan
        times = self.result.iterations["iteration_time_in_seconds"][1:].tolist()
        return float(statistics.median(times))

    @property
    def time_in_seconds(self) -> float:
        """Median time; NaN after a failure."""
        return statistics.median(self.times_in_seconds) if self.times_in_seconds else math.nan


def measure(
    method: Any,
    solve: Callable[[Callable[[Any], None]], tuple[Any, float]],
    repeat: int,
    timeout: float,
    predicted: float = math.nan,
) -> GraphRun:
    """Solve several times by one method.

    Args:
        method: the method.
        solve: function of a progress callback that returns the result and its chi2.
        repeat: number of solves.
        timeout: seconds after which a solve is stopped.
        predicted: predicted time of a step in seconds.
    """
    times: list[float] = []
    for _ in range(repeat):
        begun = time.perf_counter()

        def watch(_: Any, begun: float = begun) -> None:
            if time.perf_counter() - begun > timeout:
                raise _TimeoutError

        try:
            result, chi2 = solve(watch)
        except _TimeoutError:
            return _failed(method, "TIMEOUT", f"stopped after {number(timeout)} s")
        except InputError:
            raise
        except (RuntimeError, MemoryError) as error:
            return _failed(method, "FAILURE", str(error).partition("\n")[0] or "no memory")
        summary = result.summary
        if summary.interrupted:
            raise KeyboardInterrupt
        if not summary.is_solution_usable:
            return _failed(method, summary.termination_type, summary.message)
        times.append(result.solve_time_in_seconds)
        if times[-1] > SECONDS_NOT_REPEATED:
            break
    return GraphRun(
        method=method,
        times_in_seconds=tuple(times),
        final_cost=summary.final_cost,
        chi2_final=chi2,
        num_steps=len(result.iterations["cost"]) - 1,
        termination_type=summary.termination_type,
        warnings=tuple(summary.warnings),
        result=result,
        predicted_time_per_step_in_seconds=predicted,
    )


class _TimeoutError(Exception):
    """Time limit of a solve exceeded."""


def _failed(method: Any, termination: str, failure: str) -> GraphRun:
    return GraphRun(
        method=method,
        times_in_seconds=(),
        final_cost=math.nan,
        chi2_final=math.nan,
        num_steps=0,
        termination_type=termination,
        failure=failure,
    )


def best_cost(runs: Iterable[GraphRun]) -> float:
    """Return the lowest final cost; NaN without a usable solution."""
    return min((run.final_cost for run in runs if not run.failure), default=math.nan)


def recommend_run(runs: Sequence[GraphRun]) -> tuple[GraphRun | None, str]:
    """Return the recommended run and the reason; None without a usable solution."""
    usable = [run for run in runs if not run.failure]
    if not usable:
        return None, f"No method has a usable solution: {DIAGNOSE}."
    best = best_cost(usable)
    limit = best + COST_TOLERANCE * abs(best)
    good = sorted(
        (run for run in usable if run.final_cost <= limit), key=lambda run: run.time_in_seconds
    )
    near = [run for run in good if run.time_in_seconds <= NEAR_ENOUGH * good[0].time_in_seconds]
    first = min(near, key=runs.index)  # earlier methods are closer to the defaults
    reason = (
        f"{first.method.name} took {seconds(first.time_in_seconds)} s to cost "
        f"{best:.6g}: the least time, or within {round(100 * (NEAR_ENOUGH - 1))} % of "
        f"it, of the {plural(len(good), 'method')} with the lowest cost"
    )
    others = [run for run in good if _family(run) != _family(first)]
    if others:
        ratio = others[0].time_in_seconds / max(first.time_in_seconds, 1e-9)
        reason += f"; {others[0].method.name} took {number(ratio)} times as long"
    worse = len(usable) - len(good)
    if worse:
        reason += (
            f"; {plural(worse, 'method')} ended at a higher cost, in another minimum or not "
            "converged"
        )
    return first, reason + "."


def _family(run: GraphRun) -> str:
    """Return the first word of a method's name: the backend, or the solver."""
    return str(run.method.name).partition(" ")[0]
