"""How cost grows: over the drives of growing length, and from one thread to several."""

from __future__ import annotations

from benchmarks import table
from benchmarks.measure import Spread, slope
from benchmarks.results import Results
from benchmarks.solvers import SCALED, SOLVERS

# The family of scenes that differ in length alone.
FAMILY = "street-"


def points(results: Results, solver: str, quantity: str = "total") -> list[tuple[int, Spread]]:
    """Return (observations, seconds) of the drives that a solver finished, by observations.

    ``quantity`` is "total" or "step".
    """
    found = []
    for name in results.problems("synthetic"):
        row, size = results.row(name, solver), results.size(name)
        seconds = getattr(row, quantity) if row else None
        if name.startswith(FAMILY) and seconds and size:
            found.append((size["observations"], seconds))
    return sorted(found, key=lambda pair: pair[0])


def exponent(results: Results, solver: str, quantity: str = "total") -> float | None:
    """Return the fitted power of growth, None with fewer than two drives."""
    found = points(results, solver, quantity)
    if len(found) < 2:
        return None
    return slope([size for size, _ in found], [seconds.median for _, seconds in found])


def growth_table(results: Results) -> str:
    """Return one line a solver: totals by drive, and the exponents; "" without two drives."""
    names = [name for name in results.problems("synthetic") if name.startswith(FAMILY)]
    lines = []
    for solver in (solver.name for solver in SOLVERS):
        powers = [exponent(results, solver, quantity) for quantity in ("total", "step")]
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
    return table.grid(["total", *header, "power", "power, time per step"], lines)


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
