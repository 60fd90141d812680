"""Report of `bundle merge`."""

from __future__ import annotations

import shlex
from collections.abc import Sequence

from bundle.base.words import contents, number, pixels, plural
from bundle.editing.merge_result import Merge
from bundle.errors import shown
from bundle.interface.finding import Finding
from bundle.model.problem import Problem
from bundle.reports.sections import Report, Section
from bundle.reports.terminal.inputs import about_input, written


def merged_report(
    paths: tuple[str, str],
    problems: tuple[Problem, Problem],
    merged: Merge,
    output: dict[str, str],
    lost: Sequence[str],
) -> Report:
    """Return the report: shared images, merged parts, remaining freedoms, and the next step.

    In the data, ``input`` is A and ``other`` is B.
    """
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
    ]
    joined = plural(counts.num_points_joined, "point", grouped=True)
    if counts.num_points_joined:
        joined += f" (rms {pixels(merged.rms_pixels)} px)"
    # One model keeps half of the freedoms of two.
    undetermined = merged.free_before - merged.free_before // 2 - merged.determined
    left = ""
    if undetermined > 0:
        left = f" {plural(undetermined, 'degree')} of freedom between the models stay open."
    headline = [
        f"Merged by {shared}: joined {joined}, added {plural(counts.num_images, 'image')} and "
        f"{plural(counts.num_points_added, 'point', grouped=True)}.{left}",
        f"The merged model has {contents(merged.problem)}.",
    ]
    path = shlex.quote(output["path"])
    next_step = Finding(
        kind="not_adjusted",
        sentence="Nothing is adjusted yet.",
        command=f"bundle refine {path} -o {path}",
    )
    return Report(
        command="merge",
        input=about_input(paths[0], problems[0]),
        headline=headline,
        warnings=(*merged.notes, *lost),
        findings=[next_step],
        sections=[Section(facts=[written(output)]), Section(facts=rows, is_detail=True)],
        data={
            "other": about_input(paths[1], problems[1]),
            "merge": merged.asdict(),
            "output": output,
        },
    )
