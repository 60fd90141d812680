"""Outcome of a solve: errors before and after, cost by iteration, rounds, options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bundle.analysis.statistics.description import Description
from bundle.base.words import contents, pixels, plural, seconds
from bundle.figures.cost_figures import iteration_figure
from bundle.figures.drawing import Figure
from bundle.figures.residual_figures import (
    ResidualHistogram,
    coordinate_figure,
    image_error_figure,
    length_figure,
)
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.model.reprojection import Residuals
from bundle.reports.sections import Section, Table
from bundle.reports.terminal.refine import before_and_after
from bundle.reports.terminal.solve_data import ERRORS, ROUNDS
from bundle.solving.headline import edit_facts
from bundle.solving.result import Result


def contents_of(problem: Problem) -> str:
    """Return what a problem contains, in words."""
    words = contents(problem)
    if problem.num_frames:
        words += f"; {plural(problem.num_rigs, 'rig')} with {plural(problem.num_frames, 'frame')}"
    models: dict[str, int] = {}
    for model in problem.camera_models:
        models[model] = models.get(model, 0) + 1
    most = sorted(models.items(), key=lambda item: -item[1])[:4]
    kinds = ", ".join(f"{model} x {count:,}" if count > 1 else model for model, count in most)
    return f"{words}. Camera models: {kinds}." if kinds else f"{words}."


def residual_section(
    problem: Problem,
    result: Result | None,
    description: Description,
    found: Residuals,
    histogram: ResidualHistogram | None,
) -> list[Section]:
    """Return the distribution of residuals, and the table of errors."""
    figures: list[Figure] = []
    if histogram is not None:
        figures += [coordinate_figure(histogram), length_figure(histogram)]
        figures.append(image_error_figure(problem, found))
    table = _errors_now(description, found) if result is None else _errors_of(result)
    sections = [Section(title="Residuals", figures=figures)]
    if table is not None:
        sections.append(Section(title="Errors and counts", tables=[table], is_detail=True))
    return sections


def solve_sections(result: Result) -> list[Section]:
    """Return the outcome of a solve with its rounds and its options."""
    used, usual = result.options.asdict(), SolveOptions().asdict()
    summary = result.summary
    facts = [
        ("solver", f"{summary.backend_used} {summary.linear_solver_type_used}"),
        ("threads", str(summary.num_threads_used)),
        ("time", f"{seconds(result.build_time_in_seconds + result.solve_time_in_seconds)} s"),
    ]
    facts += edit_facts(result)
    facts += [(name, _value(value)) for name, value in used.items() if value != usual.get(name)]
    rest = [(name, _value(value)) for name, value in used.items() if value == usual.get(name)]
    rounds = [Table(ROUNDS, result.rounds)] if result.rounds else []
    costs = np.asarray(result.iterations.get("cost", ()), float)
    figures = [iteration_figure(costs)] if len(costs) > 1 else []
    return [
        Section(
            title="Solver and options",
            text=[result.outcome],
            facts=facts,
            figures=figures,
        ),
        *([Section(title="Rounds", tables=rounds, is_joined=True)] if rounds else []),
        Section(title=f"{plural(len(rest), 'option')} at the default", facts=rest, is_detail=True),
    ]


def _errors_now(description: Description, found: Residuals) -> Table | None:
    error = description.reprojection_error
    if error is None:
        return None
    half = 0.5 * float((found.xy[found.counted] ** 2).sum())
    rows = [
        ["cost, half the sum of squares [px²]", f"{half:.9g}"],
        *([title, pixels(getattr(error, name))] for name, title in ERRORS.items()),
        ["observations that count", f"{error.num_observations:,}"],
        ["behind their camera", f"{error.num_behind_camera:,}"],
    ]
    return Table.of(["", "now"], rows)


def _errors_of(result: Result) -> Table:
    made = before_and_after(result)
    first, last = result.initial_problem, result.problem
    counts = [
        ("images", f"{first.num_images:,}", f"{last.num_images:,}"),
        ("points", f"{first.num_points:,}", f"{last.num_points:,}"),
    ]
    return replace(made, rows=[*made.rows, *counts])


def _value(value: object) -> str:
    if isinstance(value, list | tuple):
        words: Sequence[str] = [str(one) for one in value]
        more = f" and {len(words) - 20} more" if len(words) > 20 else ""
        return (", ".join(words[:20]) + more) or "none"
    return str(value)
