"""Input and outcome of a solve: counts, costs, errors, options, warnings."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from bundle.analysis.statistics.description import Description
from bundle.base.words import contents, pixels, plural, seconds
from bundle.figures.cost_figures import iteration_figure
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.model.reprojection import ReprojectionError
from bundle.model.residuals import Residuals
from bundle.reports.page.page import tag
from bundle.reports.page.svg import draw
from bundle.reports.page.table import declared, table
from bundle.reports.sections import Table
from bundle.reports.terminal.solve_data import ERRORS, ROUNDS
from bundle.solving.result import Result

__all__ = ["overview_section"]


def overview_section(
    problem: Problem, result: Result | None, description: Description, found: Residuals | None
) -> list[str]:
    """Return the start of the page: tables, warnings, options and the cost by iteration."""
    sections = [tag("p", escape(_words(problem)), class_="quiet")]
    warnings = [] if result is None else list(result.summary.warnings)
    warnings += [suspicion.sentence for suspicion in description.suspicions]
    sections += [tag("p", escape(words), class_="warn") for words in dict.fromkeys(warnings)]
    if result is None:
        sections.append(_errors_now(description.reprojection_error, found))
        return sections
    sections.append(tag("p", escape(result.outcome)))
    charts = [tag("figure", tag("h3", "Before and after"), _errors_of(result))]
    if len(result.iterations.get("cost", ())) > 1:
        charts.append(draw(iteration_figure(np.asarray(result.iterations["cost"], float))))
    sections.append(tag("div", *charts, class_="grid"))
    if result.rounds:
        rounds = declared(Table(ROUNDS, result.rounds))
        sections.append(tag("h3", "Rounds") + rounds)
    sections.append(_options(result))
    return sections


def _words(problem: Problem) -> str:
    words = contents(problem)
    if problem.num_frames:
        words += f"; {plural(problem.num_rigs, 'rig')} with {plural(problem.num_frames, 'frame')}"
    models: dict[str, int] = {}
    for model in problem.camera_models:
        models[model] = models.get(model, 0) + 1
    most = sorted(models.items(), key=lambda item: -item[1])[:4]
    kinds = ", ".join(f"{model} x {count:,}" if count > 1 else model for model, count in most)
    return f"{words}. Camera models: {kinds}." if kinds else f"{words}."


def _errors_now(error: ReprojectionError | None, found: Residuals | None) -> str:
    if error is None or found is None:
        return ""
    rows = [[title, pixels(getattr(error, name))] for name, title in ERRORS.items()]
    half = 0.5 * float((found.xy[found.counted] ** 2).sum())
    rows.insert(0, ["cost, half the sum of squares [px²]", f"{half:.9g}"])
    rows.append(["observations that count", f"{error.num_observations:,}"])
    rows.append(["behind their camera", f"{error.num_behind_camera:,}"])
    return table(["", "now"], rows)


def _errors_of(result: Result) -> str:
    before, after = result.reprojection_error_before, result.reprojection_error_after
    summary = result.summary
    rows = [
        [title, pixels(getattr(before, name)), pixels(getattr(after, name))]
        for name, title in ERRORS.items()
    ]
    if not result.rounds:  # costs of different rounds are not comparable
        held = f"{summary.held_cost:.9g}"
        costs = ["cost", f"{summary.initial_cost:.9g}", f"{summary.final_cost:.9g}"]
        rows[:0] = [costs, ["held cost", "-", held]] if summary.held_cost else [costs]
    first, last = result.initial_problem, result.problem
    for title, name in (("images", "num_images"), ("points", "num_points"),
                        ("observations", "num_observations")):  # fmt: skip
        rows.append([title, f"{getattr(first, name):,}", f"{getattr(last, name):,}"])
    rows.append(["behind camera", f"{before.num_behind_camera:,}", f"{after.num_behind_camera:,}"])
    return table(["", "before", "after"], rows)


def _options(result: Result) -> str:
    used, usual = result.options.asdict(), SolveOptions().asdict()
    summary = result.summary
    rows = [
        ["solver", f"{summary.backend_used} {summary.linear_solver_type_used}"],
        ["threads", str(summary.num_threads_used)],
        ["time", f"{seconds(result.build_time_in_seconds + result.solve_time_in_seconds)} s"],
    ]  # fmt: skip
    changed = [[name, _value(value)] for name, value in used.items() if value != usual.get(name)]
    rest = [[name, _value(value)] for name, value in used.items() if value == usual.get(name)]
    chosen = table(["", "solve"], rows + changed, words=(1,))
    if rest:
        summary_line = tag("summary", f"{plural(len(rest), 'option')} at the default")
        chosen += tag("details", summary_line, table(["option", "value"], rest, words=(1,)))
    return tag("h3", "Solver and options") + chosen


def _value(value: object) -> str:
    if isinstance(value, list | tuple):
        words: Sequence[str] = [str(one) for one in value]
        more = f" and {len(words) - 20} more" if len(words) > 20 else ""
        return (", ".join(words[:20]) + more) or "none"
    return str(value)
