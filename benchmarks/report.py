"""The whole report in Markdown, and its place in the README."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks import rows, table, whole
from benchmarks.rows import Row, Run
from benchmarks.solvers import REFERENCE, SOLVERS

BEGIN, END = "<!-- bench:begin -->", "<!-- bench:end -->"
PEER = "pycolmap auto"
TARGET_PROBLEM = "16-22106"
STEP_LIMIT, WHOLE_LIMIT = 0.75, 0.7


@dataclass(frozen=True)
class Results:
    """Everything measured.

    Attributes:
        machine: machine.describe().
        command: what was typed.
        settings: threads, repeats, stopping rule.
        kinds: kind of each problem, in the order of the tables.
        runs: every single run.
        marks: runs with a tighter stopping rule, for the best known cost alone.
        whole: problem -> process -> runs.
    """

    machine: dict[str, str]
    command: str
    settings: dict[str, Any]
    kinds: dict[str, str]
    runs: list[Run]
    marks: list[Run]
    whole: dict[str, dict[str, list[dict[str, Any]]]]

    def of(self, problem: str) -> list[Run]:
        """Return the runs of one problem."""
        return [run for run in self.runs if run["problem"] == problem]

    def best_cost(self, problem: str) -> float:
        """Return the best known cost of one problem."""
        marks = [run for run in self.marks if run["problem"] == problem]
        return rows.best_known_cost(self.of(problem) + marks)

    def rows_of(self, problem: str) -> list[Row]:
        """Return the rows of one problem, the reference first."""
        runs, best = self.of(problem), self.best_cost(problem)
        present = {run["solver"] for run in runs}
        names = [solver.name for solver in SOLVERS if solver.name in present]
        return [
            rows.row(problem, name, [run for run in runs if run["solver"] == name], best)
            for name in names
        ]


def verdicts(results: Results) -> list[tuple[str, float | None, float]]:
    """Return the targets on 16-22106: what, ours over pycolmap's, limit."""
    if TARGET_PROBLEM not in results.kinds:
        return []
    by_solver = {row.solver: row for row in results.rows_of(TARGET_PROBLEM)}
    lines = []
    for name in (solver.solver for solver in SOLVERS if solver.runner == "pycolmap_"):
        ours, theirs = by_solver.get(f"bundle {name}"), by_solver.get(f"pycolmap {name}")
        if ours and theirs:
            value = _quotient(ours.step, theirs.step)
            lines.append((f"time per LM step, both {name}", value, STEP_LIMIT))
    if TARGET_PROBLEM in results.whole:
        wall = {
            name: whole.spreads(runs)[0] for name, runs in results.whole[TARGET_PROBLEM].items()
        }
        value = _quotient(wall.get(whole.OURS), wall.get(whole.THEIRS))
        lines.append(("whole process, load and save included", value, WHOLE_LIMIT))
    return lines


def _quotient(ours: Any, theirs: Any) -> float | None:
    return ours.median / theirs.median if ours and theirs else None


def _whole_table(results: Results) -> str:
    header = ["problem", f"`{whole.OURS}`", "pycolmap, wall time", "pycolmap, peak memory"]
    lines = []
    for problem, processes in results.whole.items():
        ours, theirs = processes[whole.OURS], processes[whole.THEIRS]
        failures = [run["failure"] for run in ours + theirs if run["failure"]]
        if failures:
            lines.append([problem, f"no result: {failures[0]}", "", "", ""])
            continue
        (our_wall, our_memory), (their_wall, their_memory) = (
            whole.spreads(ours),
            whole.spreads(theirs),
        )
        lines.append(
            [
                problem,
                table.seconds(our_wall.median) if our_wall else "",
                table.ratio(their_wall, our_wall),
                table.ratio(their_memory, our_memory, table.megabytes),
                f"{theirs[-1]['final_cost'] / ours[-1]['final_cost'] - 1.0:+.0e}",
            ]
        )
    return table.grid([*header, "pycolmap, final cost - 1"], lines)


def _heading(results: Results) -> str:
    machine, settings = results.machine, results.settings
    versions: dict[str, str] = {}
    for run in results.runs:
        versions |= run["outcome"]["versions"] if run["outcome"] else {}
    listed = ", ".join(f"{name} {version}" for name, version in versions.items())
    stopping = ", ".join(f"{name} {value:g}" for name, value in settings["stopping"].items())
    return (
        f"Measured {machine['date']} on {machine['cpu']}, {machine['cores']} cores, "
        f"{machine['system']}, load {machine['load before']} before; "
        f"{settings['threads']} threads, "
        f"median of {settings['repeat']} interleaved runs (a run above "
        f"{settings['repeat_below']:g} s is not repeated). {listed}. Stopping rule of all: "
        f"{stopping}. `{results.command}`"
    )


def markdown(results: Results, image: str) -> str:
    """Return the report; ``image`` is the plot's path as links have it, "" without one."""
    tables = {problem: results.rows_of(problem) for problem in results.kinds}
    parts = [_heading(results)]
    targets = verdicts(results)
    if targets:
        parts += [f"Targets, on {TARGET_PROBLEM}:", table.of_targets(targets)]
    if image:
        parts.append(f"![Cost gap against time]({image})")
    pairs = [
        (by_name[REFERENCE], by_name[PEER])
        for by_name in ({row.solver: row for row in mine} for mine in tables.values())
        if REFERENCE in by_name and PEER in by_name
    ]
    if pairs:
        parts += [
            f"`{PEER}` as a ratio to `{REFERENCE}` (above 1: pycolmap needs more; in brackets the "
            "spread of the runs):",
            table.of_pair(pairs),
        ]
    if results.whole:
        parts += [
            "Whole processes (start, load, solve, save), ratios to ours:",
            _whole_table(results),
        ]
    for problem, mine in tables.items():
        summary = (
            f"{problem}, best known cost {results.best_cost(problem):.9e}, ratios to {REFERENCE}"
        )
        parts.append(
            f"<details><summary>{summary}</summary>\n\n{table.of_problem(mine)}\n\n</details>"
        )
    return "\n\n".join(parts) + "\n"


def put_into(readme: Path, text: str) -> None:
    """Replace what stands between the markers of the README.

    Raises:
        ValueError: the file has not exactly one pair of markers, in order.
    """
    content = readme.read_text()
    before, begin, rest = content.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end or BEGIN in rest or END in before or END in after:
        raise ValueError(f"{readme}: expected one {BEGIN} followed by one {END}")
    readme.write_text(f"{before}{BEGIN}\n{text}{END}{after}")
