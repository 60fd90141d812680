"""From single runs to rows: medians over repeats, and what counts as having reached a cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.measure import Spread, time_to_cost

# Relative distances to the best known cost at which the clock is read; the smallest is beyond the
# usual stopping rule and read from runs with a tight one.
GAPS = (1e-3, 1e-5)
TIGHT_GAPS = (1e-3, 1e-5, 1e-8)
# A final cost that the independent evaluation finds further off than this is reported as wrong.
COST_AGREEMENT = 1e-6

# One run, as in the JSON: problem, solver, rule (of series.RULES), threads, failure ("" or
# why there is no outcome), wall and cpu seconds of the process, outcome (protocol.Outcome as a
# dict, or None).
Run = dict[str, Any]


@dataclass(frozen=True)
class Row:
    """One solver on one problem.

    Attributes:
        failure: why there are no numbers; "" otherwise.
        remark: which repeats failed, though others did not; "" otherwise.
        step: seconds per LM step.
        reached: seconds to each gap; None where a run did not get there.
        total: seconds of build and solve.
        memory: peak bytes of the process.
        added_memory: peak bytes of solving beyond the loaded problem; None if not measured.
        gap: (final cost - best known cost) / best known cost.
        cores: CPU seconds over wall seconds of the whole process.
        doubt: what is wrong with the final cost, "" if the independent evaluation confirms it.
    """

    problem: str
    solver: str
    failure: str
    remark: str = ""
    used: str = ""
    num_steps: int = 0
    step: Spread | None = None
    reached: tuple[Spread | None, ...] = (None,) * len(GAPS)
    total: Spread | None = None
    memory: Spread | None = None
    added_memory: Spread | None = None
    gap: float = float("nan")
    cores: float = float("nan")
    doubt: str = ""


def best_known_cost(runs: Sequence[Run]) -> float:
    """Return the lowest final cost that any run arrived at and the evaluation confirmed."""
    outcomes = [run["outcome"] for run in runs if run["outcome"] is not None]
    return min((o["verified_cost"] for o in outcomes if not _doubt(o)), default=float("nan"))


def row(
    problem: str,
    solver: str,
    runs: Sequence[Run],
    best_cost: float,
    gaps: Sequence[float] = GAPS,
) -> Row:
    """Return one solver's row on one problem; the numbers are of the runs that ended."""
    failures = [run["failure"] for run in runs if run["failure"]]
    outcomes = [run["outcome"] for run in runs if run["outcome"] is not None]
    if not outcomes:
        return Row(problem, solver, failures[0] if failures else "not run")
    last = outcomes[-1]
    steps = [_step(outcome) for outcome in outcomes]
    return Row(
        problem=problem,
        solver=solver,
        failure="",
        remark=f"{len(failures)} of {len(runs)} runs: {failures[0]}" if failures else "",
        used=" ".join(note for note in last["notes"] if note),
        num_steps=last["num_steps"],
        step=Spread.of(steps),
        reached=tuple(
            Spread.of(time_to_cost(o["trace"], best_cost * (1.0 + gap)) for o in outcomes)
            for gap in gaps
        ),
        total=Spread.of(outcome["build"] + outcome["solve"] for outcome in outcomes),
        memory=Spread.of(outcome["peak_memory"] for outcome in outcomes),
        added_memory=Spread.of(_added_memory(outcome) for outcome in outcomes),
        gap=last["verified_cost"] / best_cost - 1.0,
        cores=sum(run["cpu"] for run in runs) / sum(run["wall"] for run in runs),
        doubt=_doubt(last),
    )


def _added_memory(outcome: dict[str, Any]) -> float | None:
    added: int = outcome.get("added_memory", -1)
    return added if added >= 0 else None


def _step(outcome: dict[str, Any]) -> float | None:
    """Seconds per LM step; None if no step was needed."""
    return outcome["minimizer"] / outcome["num_steps"] if outcome["num_steps"] else None


def _doubt(outcome: dict[str, Any]) -> str:
    said, found = outcome["final_cost"], outcome["verified_cost"]
    if abs(said - found) <= COST_AGREEMENT * abs(found):
        return ""
    return f"says a final cost of {said:.9e}, its parameters give {found:.9e}"
