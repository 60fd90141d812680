"""Everything that one run of the benchmark measured, and what can be asked of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from benchmarks import rows
from benchmarks.rows import Row, Run
from benchmarks.solvers import SOLVERS


@dataclass(frozen=True)
class Results:
    """Everything measured.

    Attributes:
        machine: machine.describe().
        command: what was typed.
        settings: threads, repeats, stopping rules, the DGEMM rate in flops a second.
        kinds: "bal", "colmap" or "synthetic" for each problem, in the order of the tables.
        runs: every single run.
        whole: problem -> process -> runs.
        practitioners: title -> whose -> runs, of ``benchmarks.practitioners``.
        uncertainty: model -> whose -> runs, of ``benchmarks.uncertainty``.
        judging: input -> runs, of ``benchmarks.judging``.
        pose_graphs: set -> solver -> runs, of ``benchmarks.pose_graphs``.
        inertial: implementation -> interval -> times, of ``benchmarks.inertial``.
        windows: size and runs, of ``benchmarks.windows``.
    """

    machine: dict[str, str]
    command: str
    settings: dict[str, Any]
    kinds: dict[str, str]
    runs: list[Run]
    whole: dict[str, dict[str, list[dict[str, Any]]]]
    practitioners: dict[str, dict[str, list[dict[str, Any]]]] = field(default_factory=dict)
    uncertainty: dict[str, dict[str, list[dict[str, Any]]]] = field(default_factory=dict)
    pose_graphs: dict[str, dict[str, list[dict[str, float]]]] = field(default_factory=dict)
    inertial: dict[str, dict[str, list[float]]] = field(default_factory=dict)
    windows: dict[str, Any] = field(default_factory=dict)
    judging: dict[str, list[dict[str, Any]]] = field(default_factory=dict)

    def followed_by(self, later: Results) -> Results:
        """Return both as one; where both measured the same, the later ones."""
        kept = [run for run in self.runs if run["problem"] not in later.kinds]
        tables = (
            "whole",
            "practitioners",
            "uncertainty",
            "pose_graphs",
            "inertial",
            "windows",
            "judging",
        )
        return Results(
            machine={
                **later.machine,
                "load before": f"{self.machine['load before']}, {later.machine['load before']}",
            },
            command=f"{self.command}`, then `{later.command}",
            settings=later.settings,
            kinds={**self.kinds, **later.kinds},
            runs=[*kept, *later.runs],
            **{name: {**getattr(self, name), **getattr(later, name)} for name in tables},
        )

    def of(self, problem: str, rule: str = "default", threads: int = 0) -> list[Run]:
        """Return the runs of a problem under a rule; threads 0 are the ones of the settings."""
        threads = threads or self.settings["threads"]
        return [
            run
            for run in self.runs
            if (run["problem"], run["rule"], run["threads"]) == (problem, rule, threads)
        ]

    def tried(self, problem: str, *solvers: str) -> bool:
        """Return True if any of the solvers has runs; some problems are for a few solvers only."""
        return any(run["solver"] in solvers for run in self.of(problem))

    def best_cost(self, problem: str) -> float:
        """Return the best known cost of a problem, from all runs of whatever rule and threads."""
        return rows.best_known_cost([run for run in self.runs if run["problem"] == problem])

    def rows_of(self, problem: str, rule: str = "default", threads: int = 0) -> list[Row]:
        """Return the rows of a problem, in the order of SOLVERS, the reference first."""
        runs, best = self.of(problem, rule, threads), self.best_cost(problem)
        present = {run["solver"] for run in runs}
        gaps = rows.TIGHT_GAPS if rule == "tight" else rows.GAPS
        return [
            rows.row(problem, name, [run for run in runs if run["solver"] == name], best, gaps)
            for name in (solver.name for solver in SOLVERS)
            if name in present
        ]

    def row(self, problem: str, solver: str, rule: str = "default", threads: int = 0) -> Row | None:
        """Return a row that has numbers, None if there is none."""
        found = [row for row in self.rows_of(problem, rule, threads) if row.solver == solver]
        return found[0] if found and not found[0].failure else None

    def size(self, problem: str) -> dict[str, int]:
        """Return images, points, observations and camera pairs; empty if no runner said them."""
        outcomes = [run["outcome"] for run in self.runs if run["problem"] == problem]
        sizes = [outcome["size"] for outcome in outcomes if outcome and outcome["size"]]
        return dict(sizes[0]) if sizes else {}

    def problems(self, *kinds: str) -> list[str]:
        """Return the problems of some kinds, in order."""
        return [name for name, kind in self.kinds.items() if kind in kinds]
