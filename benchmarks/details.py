"""The page with everything: one table a problem, growth, threads, the limit of arithmetic."""

from __future__ import annotations

from typing import Any

from benchmarks import (
    backend,
    flops,
    judging,
    practitioners,
    report,
    scale,
    scaling,
    table,
    targets,
    uncertainty,
    whole,
)
from benchmarks.results import Results
from benchmarks.solvers import REFERENCE

_SHARE_SOLVERS = (REFERENCE, targets.CERES, targets.PEER)


def page(results: Results, heading: str, plots: dict[str, str]) -> str:
    """Return the page; ``plots`` maps "gap" and "scaling" to paths as its links have them."""
    parts = ["# Benchmarks", report.answer(results)]
    parts += ["## Method", heading]
    parts.append(
        "Written by `benchmarks/run.py`; the method is in "
        "[benchmarks/README.md](../benchmarks/README.md). Brackets show the spread of the runs."
    )
    for title, text in (
        ("Targets", _targets(results)),
        (f"Ratios to {REFERENCE}", _ratios(results)),
        ("Growth with the observations", _with_plot(scaling.growth_table(results), plots)),
        ("Growth of drives in laps", scaling.growth_table(results, scaling.LAPS)),
        ("Threads: time per step, 1 thread over all", scaling.threads_table(results)),
        ("Share of the limit of arithmetic and memory", _share(results)),
        ("Time to 1e-8 of the best known cost, tight stopping rule", _tight(results)),
        (
            "Practitioners' inputs: priors, rigs, filters",
            practitioners.as_table(results.practitioners),
        ),
        ("Covariance and diagnosis", uncertainty.as_table(results.uncertainty)),
        ("Validation of lenses, whole processes", judging.as_table(results.judging)),
        ("Pose graphs", backend.graphs_table(results.pose_graphs)),
        ("Preintegration", backend.inertial_table(results.inertial)),
        ("A batch of visual-inertial keyframes", backend.windows_table(results.windows)),
        ("Whole processes: start, load, solve, save", _whole_table(results)),
        ("Large problems, from file to file", scale.measured()),
    ):
        if text:
            parts += [f"## {title}", text]
    parts.append("## Problem by problem")
    if "gap" in plots:
        parts.append(f"![Cost gap against time]({plots['gap']})")
    for problem in results.kinds:
        size = results.size(problem)
        kinds = ("images", "points", "observations") if size else ()
        counts = ", ".join(f"{size[kind]:,} {kind}" for kind in kinds)
        parts += [
            f"<details><summary>{problem}: {counts}</summary>",
            f"Best known cost {results.best_cost(problem):.9e}; ratios to {REFERENCE}.",
            table.of_problem(results.rows_of(problem)),
            "</details>",
        ]
    return "\n\n".join(parts) + "\n"


def _targets(results: Results) -> str:
    goals = targets.of(results)
    return targets.as_table(goals) if goals else ""


def _ratios(results: Results) -> str:
    """Return a table per peer: one line per problem."""
    parts = []
    for peer in (targets.PEER, targets.CERES):
        tables = [{row.solver: row for row in results.rows_of(name)} for name in results.kinds]
        pairs = [(rows[REFERENCE], rows[peer]) for rows in tables if {REFERENCE, peer} <= set(rows)]
        if pairs:
            parts += [
                f"`{peer}` as a ratio to `{REFERENCE}` (above 1: it needs more):",
                table.of_pair(pairs),
            ]
    return "\n\n".join(parts)


def _with_plot(text: str, plots: dict[str, str]) -> str:
    if text and "scaling" in plots:
        return f"![Total time against observations]({plots['scaling']})\n\n{text}"
    return text


def _share(results: Results) -> str:
    """Return the limit of a step, by problem, and the share of it that solvers reach."""
    rates = results.settings["rates"]
    lines = []
    for problem in results.kinds:
        size = results.size(problem)
        if not size or size["rigs"]:  # shared poses have other products
            continue
        rows = {solver: results.row(problem, solver) for solver in _SHARE_SOLVERS}
        shares = []
        for row in rows.values():
            step = row.step.median if row and row.step else None
            least = flops.limit(size, bool(row and "DENSE" in row.used), rates)
            shares.append(f"{100 * least / step:.0f} %" if step else "")
        ours = rows[REFERENCE]
        dense = bool(ours and "DENSE" in ours.used)
        each = flops.per_step(size, dense) / size["observations"]
        limit = flops.limit(size, dense, rates)
        lines.append([problem, f"{each:.0f}", table.seconds(limit), *shares])
    if not lines:
        return ""
    header = ["problem", "flops an observation", "limit of a step", *_SHARE_SOLVERS]
    text = (
        "The limit is the time of the least arithmetic of a step and of its bytes "
        f"([flops.py](../benchmarks/flops.py)) at the rates of DGEMM, {rates['dgemm'] / 1e9:.0f} "
        f"GFLOP/s, and of a copy, {rates['copy'] / 1e9:.0f} GB/s, on "
        f"{results.settings['threads']} threads. A sparse factorisation is not counted."
    )
    return f"{text}\n\n{table.grid(header, lines)}"


def _tight(results: Results) -> str:
    """Return one line a problem and solver: the absolute times to each gap."""
    lines = []
    for problem in results.kinds:
        for row in results.rows_of(problem, "tight"):
            if row.failure:
                lines.append([problem, row.solver, f"no result: {row.failure}", "", "", "", ""])
                continue
            times = [table.absolute(time) for time in (*row.reached, row.total)]
            lines.append([problem, row.solver, *times, f"{max(row.gap, 0.0):.0e}"])
    header = ["problem", "solver", "time to 1e-3", "to 1e-5", "to 1e-8", "total", "final gap"]
    return table.grid(header, lines) if lines else ""


def _whole_table(results: Results) -> str:
    header = ["problem", f"`{whole.OURS}`", "pycolmap, wall time", "pycolmap, CPU time"]
    header.append("pycolmap, peak memory")
    lines = [_whole_line(problem, processes) for problem, processes in results.whole.items()]
    return table.grid([*header, "pycolmap, final cost - 1"], lines) if lines else ""


def _whole_line(problem: str, processes: dict[str, list[dict[str, Any]]]) -> list[str]:
    ours, theirs = processes[whole.OURS], processes[whole.THEIRS]
    failures = [run["failure"] for run in ours + theirs if run["failure"]]
    if failures:
        return [problem, f"no result: {failures[0]}", "", "", "", ""]
    (our_wall, our_memory), (their_wall, their_memory) = (
        whole.spreads(ours),
        whole.spreads(theirs),
    )
    return [
        problem,
        table.seconds(our_wall.median) if our_wall else "",
        table.ratio(their_wall, our_wall),
        table.ratio(whole.cpu(theirs), whole.cpu(ours)),
        table.ratio(their_memory, our_memory, table.megabytes),
        f"{theirs[-1]['final_cost'] / ours[-1]['final_cost'] - 1.0:+.0e}",
    ]
