"""Do both of our backends take the same steps?

Told from the traces of what ran anyway, by the same direct Schur solver: conjugate gradients of the
fused backend have a preconditioner of their own here, and so other steps.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from benchmarks.results import Results
from benchmarks.rows import Run

FIRST = 10
_SOLVERS = ("dense-schur", "sparse-schur")


@dataclass
class Agreement:
    """Greatest relative differences, (problem and solver, difference).

    Attributes:
        first: of the costs at the start and after each of the first steps.
        final: of the final costs; where the number of steps differs, infinity.
    """

    first: list[tuple[str, float]] = field(default_factory=list)
    final: list[tuple[str, float]] = field(default_factory=list)


def found(results: Results) -> Agreement:
    """Compare all that ran by both backends; nothing where one did not run, or failed."""
    differences = Agreement()
    for problem in results.kinds:
        runs = [run for run in results.of(problem) if run["outcome"]]
        for solver in _SOLVERS:
            ours = _costs(runs, f"bundle fused {solver}", solver)
            # Large problems are solved by Ceres once: auto takes one of these.
            theirs = _costs(runs, f"bundle ceres {solver}", solver)
            theirs = theirs or _costs(runs, "bundle ceres auto", solver)
            if not ours or not theirs:
                continue
            what = f"{problem} {solver}"
            pairs = list(zip(ours, theirs, strict=False))[: FIRST + 1]
            differences.first.append((what, max(_off(a, b) for a, b in pairs)))
            same = len(ours) == len(theirs)
            differences.final.append((what, _off(ours[-1], theirs[-1]) if same else float("inf")))
    return differences


def _costs(runs: list[Run], name: str, solver: str) -> list[float]:
    """Return the costs of a solver's first run that took this linear solver; [] without one."""
    wanted = solver.upper().replace("-", "_")
    for run in runs:
        if run["solver"] == name and wanted in run["outcome"]["notes"]:
            return [cost for _, cost in run["outcome"]["trace"]]
    return []


def _off(ours: float, theirs: float) -> float:
    return abs(ours - theirs) / abs(theirs) if theirs else abs(ours)
