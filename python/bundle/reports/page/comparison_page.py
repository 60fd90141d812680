"""The page of a comparison: what to take, every run, and where its time went."""

from __future__ import annotations

import math
import os
from html import escape

from bundle.base.arguments import check_type
from bundle.base.memory_sizes import format_size
from bundle.base.paths import as_path
from bundle.figures.matplotlib.series import cost_curve, labels, profile_curve, styles
from bundle.planning.comparison.comparison_result import GAPS, Comparison, Run
from bundle.reports.page.numbers import amount_if_any, counted, seconds
from bundle.reports.page.page import tag, write_page
from bundle.reports.page.scale import Scale, linear, logarithmic
from bundle.reports.page.svg_charts import Curve, curves, stacked_bars
from bundle.reports.page.table import Notes, convention, table

__all__ = ["write_comparison"]


def write_comparison(comparison: Comparison, path: str | os.PathLike[str]) -> None:
    """Write a comparison as one HTML file that needs nothing else.

    Raises:
        InputError: the path is a folder, or its parent is none.
        OSError: the file cannot be written.
    """
    check_type("comparison", comparison, Comparison)
    sections = [_scope(comparison), _recommendation(comparison)]
    for problem in range(len(comparison.problems)):
        sections += [_problem(comparison, problem)]
    sections.append(_profiles(comparison))
    count = len(comparison.problems)
    name = comparison.problems[0].name if count == 1 else f"{count} problems"
    write_page(as_path(path), f"Solvers compared: {name}", sections)


def _scope(comparison: Comparison) -> str:
    cap = format_size(comparison.memory_cap_in_bytes)
    words = (
        f"{len(comparison.methods)} methods, each in its own process, stopped after "
        f"{comparison.timeout:g} seconds or at {cap} beyond the loaded problem; "
        f"{seconds(comparison.wall_time_in_seconds)} in all."
    )
    if comparison.repeat > 1:
        words += f" Runs of up to {comparison.repeat} repeats show the one of median time."
    scope = tag("p", words, class_="quiet")
    if comparison.interrupted:
        scope += tag("p", "Interrupted: what had not run is missing.", class_="warn")
    return scope


def _recommendation(comparison: Comparison) -> str:
    found = comparison.recommendation
    if found is None:
        return tag(
            "p", "No run has a usable solution: there is nothing to recommend.", class_="warn"
        )
    lines = [tag("p", escape(found.reason)), tag("pre", tag("code", escape(found.command)))]
    if found.verdict:
        lines.append(tag("p", escape(found.verdict), class_="quiet"))
    return tag("div", *lines, class_="recommended")


def _problem(comparison: Comparison, problem: int) -> str:
    given = comparison.problems[problem]
    size = ", ".join(
        [
            counted(given.num_images, "image"),
            counted(given.num_cameras, "camera"),
            counted(given.num_points, "point"),
            counted(given.num_observations, "observation"),
        ]
    )
    return "".join(
        [
            tag("h2", escape(given.name)),
            tag("p", size, class_="quiet"),
            _runs(comparison, problem),
            _predictions(comparison, problem),
            tag("div", _cost(comparison, problem), _breakdown(comparison, problem), class_="grid"),
        ]
    )


def _runs(comparison: Comparison, problem: int) -> str:
    names = labels(comparison.methods)
    runs = comparison.runs_of(problem)
    head = [
        "method", "cost", "above the best", "steps", "time per step", "total",
        *(f"time to {gap:g}" for gap in GAPS), "peak memory", "outcome",
    ]  # fmt: skip
    rows = [[names[run.method], *_measured(comparison, run)] for run in runs]
    usable = [run for run in runs if run.is_usable]
    found = comparison.recommendation
    best = next((i for i, run in enumerate(runs) if found and run.method == found.method), None)
    return table(head, rows, words={len(head) - 1}, best=best if usable else None)


def _measured(comparison: Comparison, run: Run) -> list[str]:
    measurement = run.measurement
    gaps = [seconds(comparison.time_to_gap(run, gap)) for gap in GAPS]
    if measurement is None:
        return ["-", "-", "-", "-", "-", *gaps, "-", _outcome(run)]
    above = comparison.gap(run)
    return [
        f"{run.final_cost:#.7g}" if run.is_usable else "-",
        _above(above),
        f"{measurement.num_steps}",
        seconds(measurement.time_per_step_in_seconds),
        seconds(measurement.total_time_in_seconds),
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
            amount_if_any(before.num_unknowns),
            amount_if_any(before.nnz_reduced),
            amount_if_any(before.nnz_factor),
            amount_if_any(before.flops),
            seconds(before.time_per_step_in_seconds),
            seconds(after.time_per_step_in_seconds) if after else "-",
            format_size(before.memory_in_bytes),
            format_size(after.added_memory_in_bytes) if after else "-",
            notes.refer(note),
        ])  # fmt: skip
    if not rows:
        return ""
    return table(head, rows) + convention() + notes.listed()


def _cost(comparison: Comparison, problem: int) -> str:
    names, looks = labels(comparison.methods), styles(comparison.methods)
    lines = []
    for index, run in enumerate(comparison.runs):
        times, gaps = cost_curve(comparison, index)
        if run.problem == problem and len(times):
            look = looks[run.method]
            name = names[run.method] + ("" if run.is_usable else f" ({_short(run)})")
            lines.append(Curve(name, times.tolist(), gaps.tolist(), look.colour, look.line))
    chart = curves(
        lines,
        logarithmic([time for line in lines for time in line.x]),
        logarithmic([gap for line in lines for gap in line.y]),
        "seconds from the loaded problem on",
        "cost / best cost - 1",
    )
    return tag("figure", tag("h3", "Cost against time"), chart) if lines else ""


def _short(run: Run) -> str:
    return run.outcome.replace("_", " ")


def _breakdown(comparison: Comparison, problem: int) -> str:
    names = labels(comparison.methods)
    runs = [run for run in comparison.runs_of(problem) if run.is_usable and run.measurement]
    runs.sort(key=lambda run: run.total_time_in_seconds)
    rows = {names[run.method]: run.measurement.breakdown for run in runs if run.measurement}
    note = tag(
        "figcaption",
        "The fused backend eliminates the points while it computes Jacobians: its linear solver "
        "is that of the reduced system alone.",
    )
    chart = stacked_bars(rows, " s") + note
    return tag("figure", tag("h3", "Where the time went"), chart) if rows else ""


def _profiles(comparison: Comparison) -> str:
    if not comparison.profiles:
        return ""
    names, looks = labels(comparison.methods), styles(comparison.methods)
    figures = []
    for gap in GAPS:
        profiles = [profile for profile in comparison.profiles if profile.gap == gap]
        ratios = [ratio for profile in profiles for ratio in profile.ratios]
        scale = logarithmic([1.0, max(ratios, default=1.0)])
        lines = []
        for profile in profiles:
            factors, shares = profile_curve(profile, scale.high)
            look = looks[profile.method]
            lines.append(
                Curve(
                    names[profile.method],
                    factors.tolist(), shares.tolist(), look.colour, look.line,
                )
            )  # fmt: skip
        chart = curves(
            lines, scale, _share_scale(), f"time to {gap:g} of the best cost / the fastest's",
            "share of problems",
        )  # fmt: skip
        figures.append(tag("figure", tag("h3", f"To {gap:g} of the best cost"), chart))
    words = (
        "The share of problems that a method solves within a factor of the fastest on each (Dolan "
        "and Moré 2002): the higher and the further left, the better."
    )
    return "".join(
        [
            tag("h2", "Performance profiles"),
            tag("p", words, class_="quiet"),
            tag("div", *figures, class_="grid"),
        ]
    )


def _share_scale() -> Scale:
    return linear([0.0, 1.0])
