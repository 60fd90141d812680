"""What `bundle merge` says."""

from __future__ import annotations

from typing import Any

from rich.console import RenderableType

from bundle.base.tables import facts, format_name, notes, plural
from bundle.base.words import contents, number, pixels
from bundle.editing.merging.merge_result import Merge
from bundle.errors import shown
from bundle.model.problem import Problem
from bundle.reports.terminal import json

__all__ = ["as_json", "merged_table"]


def merged_table(
    paths: tuple[str, str],
    problems: tuple[Problem, Problem],
    merged: Merge,
    output: dict[str, str],
    lost: tuple[str, ...],
) -> list[RenderableType]:
    """Return what was shared, joined and left, and what to do next."""
    counts, shared = merged.counts, plural(len(merged.shared_images), "shared image")
    rows = []
    for label, path, problem in zip("AB", paths, problems, strict=True):
        rows += [(label, shown(path)), ("", contents(problem))]
    free = merged.free_before - merged.determined
    rows += [
        ("shared", f"{plural(len(merged.shared_images), 'image')}, {merged.num_pairs} point pairs"),
        (
            "gauge",
            f"{merged.free_before} free degrees of two models, {merged.determined} determined by "
            f"{shared}: {free} left",
        ),
        ("scale", f"{number(merged.similarity.scale)} length units of A per unit of B"),
        ("joined points", f"{counts.num_points_joined}"),
    ]
    if counts.num_points_joined:
        rows.append(
            ("", f"rms {pixels(merged.rms_pixels)} px, {number(merged.rms_points)} units of A")
        )
    rows += [
        ("shared centres", f"rms {number(merged.rms_centers)} units of A"),
        (
            "added",
            f"{plural(counts.num_images, 'image')}, {plural(counts.num_cameras, 'camera')}, "
            f"{plural(counts.num_points_added, 'point')}, "
            f"{plural(counts.num_observations, 'observation')}",
        ),
        (
            "disagreeing",
            f"{plural(counts.num_points_apart, 'point')} apart, {counts.num_points_dropped} "
            f"dropped; {plural(counts.num_observations_dropped, 'observation')} dropped",
        ),
        ("merged", contents(merged.problem)),
        ("output", f"{shown(output['path'])} ({format_name(output['format'])})"),
    ]
    next_step = f"Nothing is adjusted yet: bundle refine {shown(output['path'])} -o ... comes next."
    return [facts(rows), "", *notes((*merged.notes, *lost, next_step))]


def as_json(
    paths: tuple[str, str],
    problems: tuple[Problem, Problem],
    merged: Merge,
    output: dict[str, str],
) -> dict[str, Any]:
    """Return the report of `bundle merge`; ``input`` is A, ``other`` B."""
    return {
        **json.heading("merge", paths[0], problems[0]),
        "other": json.heading("merge", paths[1], problems[1])["input"],
        "merge": json.plain(merged.asdict()),
        "output": output,
    }
