"""Page of a comparison: recommendation, runs, and their time by phase."""

from __future__ import annotations

import math
import os
from html import escape

from bundle.base.arguments import check_type
from bundle.base.memory_sizes import format_size
from bundle.base.paths import as_path
from bundle.base.words import amount, plural, span
from bundle.figures.cost_figures import breakdown_figure, profile_figure, time_figure
from bundle.figures.drawing import Figure
from bundle.figures.marks import StackedBars
from bundle.figures.series import labels
from bundle.planning.comparison.comparison_result import GAPS, Comparison
from bundle.planning.comparison.graph_comparison import GraphComparison
from bundle.planning.comparison.measured_run import Run
from bundle.reports.page.graph_comparison_page import write_graph_comparison
from bundle.reports.page.page import tag, write_page
from bundle.reports.page.svg import grid
from bundle.reports.page.table import Notes, convention, table
from bundle.reports.terminal.compare_verdict import findings, headline, sigmas


def write_comparison(
    comparison: Comparison | GraphComparison, path: str | os.PathLike[str]
) -> None:
    """Write a comparison of a problem or of a graph as one self-contained HTML file.

    Raises:
        InputError: the path is a folder, or a path above it is no folder.
        OSError: the file cannot be written.
    """
    if isinstance(comparison, GraphComparison):
        return write_graph_comparison(comparison, path)
    check_type("comparison", comparison, Comparison)
    sections = [_scope(comparison), _recommendation(comparison)]
    for problem in range(len(comparison.problems)):
        sections += [_problem(comparison, problem)]
    sections.append(_profiles(comparison))
    count = len(comparison.problems)
    name = comparison.problems[0].name if count == 1 else f"{count} problems"
    write_page(as_path(path), f"Solvers compared: {name}", sections)
    return None


def _scope(comparison: Comparison) -> str:
    cap = format_size(comparison.memory_cap_in_bytes)
    words = (
        f"{len(comparison.methods)} methods, each in its own process, stopped after "
        f"{comparison.timeout:g} seconds or at {cap} beyond the loaded problem; "
        f"{span(comparison.wall_time_in_seconds)} in all."
    )
    if comparison.repeat > 1:
        words += f" Runs of up to {comparison.repeat} repeats show the one of median time."
    if comparison.perturb:
        words += f" The start is perturbed by {comparison.perturb:g}, seed {comparison.seed}."
    conditions = comparison.environment.sentence
    return tag("p", escape(words), class_="quiet") + tag("p", escape(conditions), class_="quiet")


def _recommendation(comparison: Comparison) -> str:
    """Return headline, findings with their commands, and the recommended command."""
    found = comparison.recommendation
    style = {} if found is not None else {"class_": "warn"}
    lines = [tag("p", escape(sentence), **style) for sentence in headline(comparison)]
    for finding in findings(comparison):
        lines.append(tag("p", escape(finding.sentence), class_="warn"))
        if finding.command:
            lines.append(tag("pre", tag("code", escape(finding.command))))
    if found is not None:
        lines.append(tag("p", escape(found.reason)))
        lines.append(tag("pre", tag("code", escape(found.command))))
        if found.verdict:
            lines.append(tag("p", escape(found.verdict), class_="quiet"))
    return tag("div", *lines, class_="recommended")


def _problem(comparison: Comparison, problem: int) -> str:
    given = comparison.problems[problem]
    figures = [
        time_figure(comparison, problem, outcomes=True),
        breakdown_figure(comparison, problem),
    ]
    size = ", ".join(
        [
            plural(given.num_images, "image", grouped=True),
            plural(given.num_cameras, "camera", grouped=True),
            plural(given.num_points, "point", grouped=True),
            plural(given.num_observations, "observation", grouped=True),
        ]
    )
    return "".join(
        [
            tag("h2", escape(given.name)),
            tag("p", size, class_="quiet"),
            _runs(comparison, problem),
            _predictions(comparison, problem),
            grid(figure for figure in figures if not _is_empty(figure)),
        ]
    )


def _is_empty(figure: Figure) -> bool:
    """Tell whether a figure has no measured values."""
    return not any(mark.rows if isinstance(mark, StackedBars) else True for mark in figure.marks)


def _runs(comparison: Comparison, problem: int) -> str:
    names = labels(comparison.methods)
    runs = comparison.runs_of(problem)
    head = [
        "method", "cost", "above the best", "sigmas", "steps", "total", "spread",
        *(f"to {gap:g}" for gap in GAPS), "peak memory", "outcome",
    ]  # fmt: skip
    rows = [[names[run.method], *_measured(comparison, run)] for run in runs]
    usable = [run for run in runs if run.is_usable]
    found = comparison.recommendation
    best = next((i for i, run in enumerate(runs) if found and run.method == found.method), None)
    return table(head, rows, words={len(head) - 1}, best=best if usable else None)


def _measured(comparison: Comparison, run: Run) -> list[str]:
    measurement = run.measurement
    gaps = [span(comparison.time_to_gap(run, gap)) for gap in GAPS]
    if measurement is None:
        return [*6 * ["-"], *gaps, "-", _outcome(run)]
    above, spread = comparison.gap(run), run.spread
    several = len(comparison.minima(run.problem)) > 1 and run.minimum >= 0
    minimum = f", minimum {run.minimum + 1}" if several else ""
    return [
        f"{run.final_cost:#.7g}" if run.is_usable else "-",
        _above(above),
        sigmas(run.distance_in_sigmas) + minimum,
        f"{measurement.num_steps}",
        span(measurement.total_time_in_seconds),
        f"{100 * spread.relative:.0f} %" if spread and spread.num_repeats > 1 else "-",
        *gaps,
        format_size(run.peak_memory_in_bytes),
        _outcome(run),
    ]


def _above(gap: float) -> str:
    if not math.isfinite(gap):
        return "-"
    return "best" if gap == 0 else f"{gap:.1e}"


def _outcome(run: Run) -> str:
    if run.outcome == "done":
        return "done"
    return f"{run.outcome.replace('_', ' ')}: {run.message}".removesuffix(": ")


def _predictions(comparison: Comparison, problem: int) -> str:
    names = labels(comparison.methods)
    head = [
        "predicted and measured", "ordering", "unknowns", "nonzeros of S", "nonzeros of L", "flops",
        "time per step, predicted", "measured", "memory, predicted", "measured", "note",
    ]  # fmt: skip
    notes = Notes()
    rows = []
    for run in comparison.runs_of(problem):
        before, after = run.prediction, run.measurement
        if before is None:
            continue
        note = before.note or ("" if before.fits_in_memory else "does not fit in memory")
        rows.append([
            names[run.method],
            before.ordering or "-",
            amount(before.num_unknowns or math.nan),
            amount(before.nnz_reduced or math.nan),
            amount(before.nnz_factor or math.nan),
            amount(before.flops or math.nan),
            span(before.time_per_step_in_seconds),
            span(after.time_per_step_in_seconds) if after else "-",
            format_size(before.memory_in_bytes),
            format_size(after.added_memory_in_bytes) if after else "-",
            notes.refer(note),
        ])  # fmt: skip
    if not rows:
        return ""
    return table(head, rows) + convention() + notes.listed()


def _profiles(comparison: Comparison) -> str:
    if not comparison.profiles:
        return ""
    figures = [profile_figure(comparison, gap) for gap in GAPS]
    words = (
        "The share of problems that a method solves within a factor of the fastest on each (Dolan "
        "and Moré 2002): the higher and the further left, the better."
    )
    return "".join(
        [
            tag("h2", "Performance profiles"),
            tag("p", words, class_="quiet"),
            grid(figures),
        ]
    )
