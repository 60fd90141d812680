"""What `bundle info` says."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.console import RenderableType

from bundle.analysis.statistics.covisibility import Covisibility
from bundle.analysis.statistics.depths import COLLAPSED
from bundle.analysis.statistics.description import CameraGroup, Description, Distribution
from bundle.base.tables import (
    Bar,
    Columns,
    columns,
    facts,
    format_name,
    notes,
    number,
    pixels,
    plural,
)
from bundle.base.words import contents
from bundle.errors import shown
from bundle.model.problem import Problem
from bundle.reports.terminal.refine import worst_table
from bundle.reports.terminal.rig_tables import rig_fact, rig_table

__all__ = ["information"]


def information(path: str, problem: Problem, description: Description) -> list[RenderableType]:
    """Return the description of a problem as tables and sentences."""
    wrong = [suspicion.sentence for suspicion in description.suspicions]
    return [
        facts(
            [
                ("input", f"{shown(path)} ({format_name(problem.format)})"),
                ("", contents(problem)),
                *rig_fact(problem),
            ]
        ),
        "",
        _cameras(description.cameras),
        "",
        *rig_table(description.rigs),
        _distributions(description),
        "",
        _histogram("track length", "points", description.track_length),
        "",
        _histogram("obs. per image", "images", description.observations_per_image),
        "",
        facts([("covisibility", _covisibility(description.covisibility))]),
        facts([("depth", _depths(description))]),
        facts([("error now", _error(description))]),
        *_repeated(description),
        "",
        *worst_table(description.worst_images, "worst images"),
        facts([("looks wrong", "" if wrong else "nothing found")]),
        *notes(wrong, style="yellow"),
    ]


def _cameras(groups: Sequence[CameraGroup]) -> Columns:
    rows = [
        (
            group.model,
            str(group.num_cameras),
            str(group.num_images),
            _range(*map(str, group.images_per_camera)),
            _range(*map(number, group.focal)) if group.focal else "-",
            "yes" if group.supported else "no",
        )
        for group in groups
    ]
    head = ("camera model", "cameras", "images", "images/camera", "focal length [px]", "refinable")
    return columns(head, rows)


def _range(low: str, high: str) -> str:
    return low if low == high else f"{low} to {high}"


def _distributions(description: Description) -> Columns:
    def row(name: str, values: Distribution) -> tuple[str, ...]:
        return (name, *map(number, (values.min, values.median, values.mean, values.max)))

    rows = [
        row("observations per point", description.track_length),
        row("observations per image", description.observations_per_image),
    ]
    return columns(("", "min", "median", "mean", "max"), rows)


def _histogram(title: str, noun: str, values: Distribution) -> Columns:
    largest = max((count for _, _, count in values.histogram), default=1)
    total = max(sum(count for _, _, count in values.histogram), 1)
    rows = [
        (
            _range(str(low), str(high)).replace(" to ", "-"),
            Bar(count / max(largest, 1)),
            str(count),
            f"{100.0 * count / total:.1f} %",
        )
        for low, high, count in values.histogram
    ]
    return columns((title, "", noun, "share"), rows, left=2)


def _covisibility(graph: Covisibility) -> str:
    if not len(graph.neighbours):
        return "no images"
    mean = float(np.mean(graph.neighbours))
    pieces = plural(len(graph.component_sizes), "connected piece")
    return (
        f"an image shares points with {number(mean)} others on average; {pieces}; "
        f"{100.0 * graph.schur_fill:.1f} % of the reduced camera matrix is filled"
    )


def _depths(description: Description) -> str:
    depths = description.depths
    if np.isnan(depths.median):
        return "there are no observations"
    return (
        f"median {number(depths.median)}, 5th to 95th percentile {number(depths.p5)} to "
        f"{number(depths.p95)}, min {depths.min:.3g}, max {depths.max:.3g}; "
        f"{depths.num_behind} behind, {depths.num_collapsed} below {COLLAPSED:g} of the median"
    )


def _repeated(description: Description) -> list[RenderableType]:
    count = description.num_repeated_observations
    words = f"{plural(count, 'repeated observation')} (a track visits the same image twice)"
    return [facts([("tracks", words)])] if count else []


def _error(description: Description) -> str:
    error = description.reprojection_error
    if error is None:
        return "unknown: there are camera models that bundle does not know"
    if error.num_observations == 0:
        return "there is no observation that counts"
    return (
        f"RMSE {pixels(error.rmse)} px, mean {pixels(error.mean)}, median {pixels(error.median)}, "
        f"95th percentile {pixels(error.p95)}, max {pixels(error.max)}, "
        f"over {plural(error.num_observations, 'observation')}"
    )
