"""Growth of cost over drives of growing length, and from one thread to several."""

from __future__ import annotations

import math
from collections.abc import Callable

from benchmarks import table
from benchmarks.measure import slope
from benchmarks.results import Results
from benchmarks.rows import Row
from benchmarks.solvers import SCALED, SOLVERS

# Families of scenes, by how their names begin: those of the first differ in length alone, those of
# the second come back to known places ever more often (synthetic.py).
ONE_WAY, LAPS = "street-", "laps-"


def points(results: Results, solver: str, family: str = ONE_WAY) -> list[tuple[int, Row]]:
    """Return (observations, row) of the drives that a solver finished, by observations."""
    found = []
    for name in results.problems("synthetic"):
        row, size = results.row(name, solver), results.size(name)
        if name.startswith(family) and row and row.total and row.num_steps and size:
            found.append((size["observations"], row))
    return sorted(found, key=lambda pair: pair[0])


def total(row: Row) -> float:
    """Return the median total, in seconds."""
    return row.total.median if row.total else math.nan


def num_steps(row: Row) -> float:
    """Return the LM steps tried."""
    return float(row.num_steps)


def total_a_step(row: Row) -> float:
    """Return the total, whatever it went into, by the number of steps."""
    return total(row) / row.num_steps


def exponent(
    results: Results,
    solver: str,
    quantity: Callable[[Row], float] = total,
    family: str = ONE_WAY,
) -> float | None:
    """Return the fitted power of growth, None with fewer than two drives.

    Powers of products add: that of the total is that of the steps and that of the total a step.
    """
    found = points(results, solver, family)
    if len(found) < 2:
        return None
    return slope([size for size, _ in found], [quantity(row) for _, row in found])


def growth_table(results: Results, family: str = ONE_WAY) -> str:
    """Return one line a solver: totals by drive, and the exponents; "" without two drives."""
    names = [name for name in results.problems("synthetic") if name.startswith(family)]
    lines = []
    for solver in (solver.name for solver in SOLVERS):
        powers = [exponent(results, solver, of, family) for of in (total, num_steps, total_a_step)]
        if powers[0] is None:
            continue
        totals = [row.total if (row := results.row(name, solver)) else None for name in names]
        cells = [table.seconds(total.median) if total else "" for total in totals]
        lines.append([solver, *cells, *("" if p is None else f"{p:.2f}" for p in powers)])
    if not lines:
        return ""
    header = [
        f"{name}, {results.size(name).get('observations', 0):,} observations" for name in names
    ]
    powers_of = ["power of the total", "of the steps", "of the total a step"]
    return table.grid(["total", *header, *powers_of], lines)


def threads_table(results: Results) -> str:
    """Return the time per step with one thread over that with several; "" if not measured."""
    lines = []
    for name in results.kinds:
        cells = []
        for solver in SCALED:
            one, several = (
                row.step if (row := results.row(name, solver, threads=threads)) else None
                for threads in (1, 0)
            )
            cells.append(table.ratio(one, several, missing="") if one and several else "")
        if results.settings["threads"] > 1 and any(cells):
            lines.append([name, *cells])
    return table.grid(["problem", *SCALED], lines) if lines else ""
