"""Output of Ceres: its table of iterations, and the text of Summary::FullReport."""

from __future__ import annotations

import re
from dataclasses import dataclass

# Columns: iteration, cost, change, |gradient|, |step|, ratio, radius, linear solver iterations,
# seconds of the iteration, seconds so far.
_ITERATION = re.compile(r"^\s*\d+\s+(\S+e\S+)(?:\s+\S+){7}\s+(\S+)\s*$", re.MULTILINE)
_COST_DIGITS = 6  # after the point, in scientific notation


def iterations(text: str, final_cost: float) -> list[tuple[float, float]]:
    """Return (seconds so far, cost) of each iteration.

    Costs are printed with seven digits. Each is taken to be the lowest that prints so, but no lower
    than the exact final cost: where the clock is read at a cost, this is in the solver's favour.
    """
    lowest = [
        (float(seconds), float(cost) - _half_a_unit(cost))
        for cost, seconds in _ITERATION.findall(text)
    ]
    return [(seconds, max(cost, final_cost)) for seconds, cost in lowest]


def _half_a_unit(printed: str) -> float:
    """Return half a unit of the last digit of a printed cost."""
    return 0.5 * 10.0 ** (int(printed.partition("e")[2]) - _COST_DIGITS)


@dataclass(frozen=True)
class Report:
    """The fields of a FullReport that a row needs; times in seconds."""

    linear_solver: str
    schur_structure: str
    initial_cost: float
    final_cost: float
    num_linear_solves: int
    minimizer_time: float
    total_time: float
    termination: str
    ceres: str


def report(text: str) -> Report:
    """Read a FullReport.

    Raises:
        ValueError: a line is missing.
    """

    def field(pattern: str) -> str:
        found = re.search(pattern, text, re.MULTILINE)
        if found is None:
            raise ValueError(f"Ceres' report: expected a line like {pattern!r}")
        return found.group(1)

    return Report(
        linear_solver=field(r"^Linear solver +\S+ +(\S+)$"),
        schur_structure=field(r"^Schur structure +\S+ +(\S+)$"),
        initial_cost=float(field(r"^Initial +(\S+)$")),
        final_cost=float(field(r"^Final +(\S+)$")),
        num_linear_solves=int(field(r"^  Linear solver +\S+ \((\d+)\)$")),
        minimizer_time=float(field(r"^Minimizer +([0-9.]+)$")),
        total_time=float(field(r"^Total +(\S+)$")),
        termination=field(r"^Termination: +(\w+)"),
        ceres=field(r"^Solver Summary \(v ([0-9.]+)"),
    )
