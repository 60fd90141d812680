"""What `bundle compare` says."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.console import RenderableType
from rich.text import Text

from bundle.base.memory_sizes import format_size
from bundle.base.tables import (
    CommandLine,
    columns,
    facts,
    format_name,
    notes,
    number,
    plural,
    seconds,
)
from bundle.base.words import contents
from bundle.errors import shown
from bundle.interface.summary import share
from bundle.planning.comparison.comparison_result import (
    GAPS,
    ComparedProblem,
    Comparison,
    Measurement,
    Run,
)
from bundle.planning.comparison.method import Method

__all__ = ["compared"]

FACTORS = (1.5, 2.0, 5.0, 10.0)
LEGEND = (
    "gap: final cost over the best one, less 1; to: seconds to a cost within it; total in seconds; "
    "MB: peak of the process"
)
PHASES = ("residuals", "Jacobians", "linear solver", "rest")


def compared(comparison: Comparison) -> list[RenderableType]:
    """Return the report on a comparison."""
    report: list[RenderableType] = [_conditions(comparison)]
    for index, problem in enumerate(comparison.problems):
        report += ["", *_problem(comparison, index, problem)]
    if comparison.profiles:
        report += ["", *_profiles(comparison)]
    return [*report, "", *_recommendation(comparison)]


def _conditions(comparison: Comparison) -> RenderableType:
    most = max((len(run.measurements) for run in comparison.runs), default=0)
    cap = comparison.memory_cap_in_bytes
    words = [
        f"median of {most} runs" if most > 1 else "one run each",
        f"at most {comparison.timeout:g} s",
    ]
    if cap:
        words.append(f"at most {format_size(cap)} beyond the loaded problem")
    took = f"{seconds(comparison.wall_time_in_seconds)} s"
    return facts([("each method", ", ".join(words)), ("all of it took", took)])


def _problem(comparison: Comparison, index: int, problem: ComparedProblem) -> list[RenderableType]:
    """Return the tables of one input; what has no result is told below the first."""
    runs = comparison.runs_of(index)
    names = _Names(comparison)
    report: list[RenderableType] = [
        facts(
            [
                ("input", f"{shown(problem.name)} ({format_name(problem.format)})"),
                ("", contents(problem)),
                ("best cost", _cost(comparison.best_cost(index))),
            ]
        )
    ]
    usable = [(run, run.measurement) for run in runs if run.is_usable]
    measured = [(run, one) for run, one in usable if one is not None]
    if measured:
        report += [
            "",
            columns(
                (
                    *(*names.head("method"), "gap", "steps", "s/step"),
                    *(f"to {gap:.0e}".replace("e-0", "e-") for gap in GAPS),
                    *("total", "MB"),
                ),
                [
                    _result_row(comparison, names.cells(run.method), run, one)
                    for run, one in measured
                ],
            ),
            Text(LEGEND, "dim"),
        ]
    told = [
        (names.words(run.method), run.message or run.outcome) for run in runs if not run.is_usable
    ]
    if told:
        report += ["", *notes((f"{name}: {why}" for name, why in told), style="yellow")]
    if measured:
        head = (*names.head("share of the time"), *PHASES)
        rows = [(*names.cells(run.method), *_shares(one)) for run, one in measured]
        report += ["", columns(head, rows)]
    report += _predicted(measured, names)
    return report + _warnings(measured, names)


def _result_row(
    comparison: Comparison, name: tuple[str, ...], run: Run, measurement: Measurement
) -> tuple[str, ...]:
    gap = comparison.gap(run)
    return (
        *name,
        f"{gap:.0e}" if gap > 0 else "0",
        str(measurement.num_steps),
        number(measurement.time_per_step_in_seconds),
        *(seconds(comparison.time_to_gap(run, gap)) for gap in GAPS),
        seconds(measurement.total_time_in_seconds),
        number(run.peak_memory_in_bytes / 1e6),
    )


def _shares(measurement: Measurement) -> tuple[str, ...]:
    breakdown, total = measurement.breakdown, measurement.total_time_in_seconds
    return tuple(share(breakdown[phase], total) for phase in PHASES)


def _predicted(measured: Sequence[tuple[Run, Measurement]], names: _Names) -> list[RenderableType]:
    """Return predicted against measured, where anything was predicted."""
    rows = []
    for run, measurement in measured:
        known = run.prediction
        if known is None:
            continue
        added = measurement.added_memory_in_bytes
        rows.append(
            (
                *names.cells(run.method),
                number(known.nnz_factor) if known.nnz_factor else "-",
                number(known.flops) if known.flops else "-",
                number(known.time_per_step_in_seconds),
                number(measurement.time_per_step_in_seconds),
                number(known.memory_in_bytes / 1e6),
                number(added / 1e6 if added >= 0 else math.nan),
            )
        )
    if not rows:
        return []
    head = (
        *names.head("predicted, measured"),
        "nnz(L)",
        "flops",
        "s/step",
        "measured",
        "MB",
        "measured",
    )
    return [
        "",
        columns(head, rows),
        Text("nnz(L): lower triangle with the diagonal; MB: beyond the loaded problem", "dim"),
    ]


def _warnings(measured: Sequence[tuple[Run, Measurement]], names: _Names) -> list[RenderableType]:
    """Return what the solvers took instead and what they warn of, each sentence once."""
    said: dict[str, list[str]] = {}
    for run, measurement in measured:
        for sentence in (*_taken(run, measurement), *measurement.summary.warnings):
            said.setdefault(sentence, []).append(names.words(run.method))
    if not said:
        return []
    lines = (
        sentence if len(sayers) == len(measured) else f"{', '.join(sayers)}: {sentence}"
        for sentence, sayers in said.items()
    )
    return ["", *notes(lines, style="yellow")]


def _taken(run: Run, measurement: Measurement) -> list[str]:
    """Return what was taken in place of what the method names, "auto" or not."""
    summary = measurement.summary
    taken = (summary.backend_used.lower(), summary.linear_solver_type_used)
    if taken == (run.method.backend, run.method.linear_solver_type.upper()):
        return []
    return [f"took {' '.join(taken)}."]


def _profiles(comparison: Comparison) -> list[RenderableType]:
    """Return how many problems each method solves within a factor of the fastest."""
    names = _Names(comparison)
    report: list[RenderableType] = []
    for gap in GAPS:
        profiles = [profile for profile in comparison.profiles if profile.gap == gap]
        solved = plural(profiles[0].num_problems, "problem")
        rows = [
            (
                *names.cells(profile.method),
                *(f"{100 * profile.share(factor):.0f} %" for factor in (1.0, *FACTORS, math.inf)),
            )
            for profile in profiles
        ]
        title = f"{solved} solved to {gap:.0e} within".replace("e-0", "e-")
        head = (*names.head(title), "fastest", *(f"{factor:g} times" for factor in FACTORS), "ever")
        report += ["", columns(head, rows)]
    return report[1:]


def _recommendation(comparison: Comparison) -> list[RenderableType]:
    found = comparison.recommendation
    report: list[RenderableType] = []
    if comparison.interrupted:
        report.append(facts([("interrupted", "what was not run yet is missing")]))
    if found is None:
        return [*report, facts([("recommended", "nothing: no method has a usable solution")])]
    rows = [("recommended", found.reason)]
    if found.verdict:
        rows.append(("", found.verdict))
    return [*report, facts(rows), "", CommandLine(found.command)]


class _Names:
    """How methods are named: with their threads only if that tells any apart."""

    def __init__(self, comparison: Comparison) -> None:
        self._with_threads = len({method.num_threads for method in comparison.methods}) > 1

    def head(self, title: str) -> tuple[str, ...]:
        """Return the titles of the columns that `cells` fills."""
        return (title, "threads") if self._with_threads else (title,)

    def cells(self, method: Method) -> tuple[str, ...]:
        """Return a method as the first cells of a row."""
        return (method.name, str(method.num_threads)) if self._with_threads else (method.name,)

    def words(self, method: Method) -> str:
        """Return a method within a sentence."""
        return f"{method.name}, {method.threads}" if self._with_threads else method.name


def _cost(value: float) -> str:
    """Return a cost in ten digits; "-" where no run has one."""
    return f"{value:.9e}" if math.isfinite(value) else "-"
