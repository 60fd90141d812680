"""Report of `bundle info` on a reconstruction."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from bundle.analysis.diagnosis.track_table import Covisibility
from bundle.analysis.statistics.description import Description, Distribution
from bundle.analysis.statistics.suspicions import COLLAPSED
from bundle.base.tables import Bar
from bundle.base.words import contents, format_name, number, pixels, plural
from bundle.errors import shown
from bundle.interface.finding import DETAILS, Finding
from bundle.model.problem import Problem
from bundle.model.pycolmap.problem_source import imported_source
from bundle.reports.sections import Column, Report, Section, Table, fields
from bundle.reports.terminal.inputs import about_input, input_facts, rig_sections, shutter_fact
from bundle.reports.terminal.refine import worst_sections

CAMERAS = (
    Column("camera model", "model"),
    Column("cameras", "num_cameras"),
    Column("images", "num_images"),
    Column("images/camera", lambda group: _range(*map(str, group.images_per_camera))),
    Column(
        "focal length [px]",
        lambda group: _range(*map(number, group.focal)) if group.focal else "-",
    ),
    Column("refinable", lambda group: "yes" if group.supported else "no"),
)


def information(
    path: str, problem: Problem, description: Description, findings: Sequence[Finding]
) -> Report:
    """Return the report on the description of a problem and the findings about it."""
    count = description.num_repeated_observations
    count_of_findings = sum(finding.kind not in DETAILS for finding in findings)
    tracks = f"{plural(count, 'repeated observation')} (a track visits the same image twice)"
    facts = [
        ("covisibility", _covisibility(description.covisibility)),
        ("depth", _depths(description)),
        ("error now", _error(description)),
        *([("tracks", tracks)] if count else []),
    ]
    details = [
        Section(facts=input_facts(path, problem, rigs=True)),
        Section(tables=[Table(CAMERAS, description.cameras)]),
        *rig_sections(description.rigs),
        Section(tables=[distributions(description)]),
        Section(tables=[_histogram("track length", "points", description.track_length)]),
        Section(
            tables=[_histogram("obs. per image", "images", description.observations_per_image)]
        ),
        Section(facts=facts),
        *worst_sections(description.worst_images, "worst images"),
    ]
    return Report(
        command="info",
        input=about_input(path, problem),
        headline=_headline(path, problem, description, count_of_findings),
        findings=findings,
        sections=[dataclasses.replace(section, is_detail=True) for section in details],
        data=fields(description),
    )


def _headline(path: str, problem: Problem, description: Description, count: int) -> list[str]:
    error, tracks = description.reprojection_error, description.track_length
    rmse = "Reprojection error unknown"
    if error is not None and error.num_observations:
        rmse = f"RMSE {pixels(error.rmse)} px, median {pixels(error.median)} px"
    imported = imported_source(problem)
    if imported is not None:
        source = pixels(imported.source_rmse)
        rmse += f" (RMSE by the formula of {format_name(problem.format)}: {source} px)"
    pieces = plural(len(description.covisibility.component_sizes), "connected piece")
    shutter = "".join(f" Rolling shutter: {value}." for _, value in shutter_fact(problem)[:1])
    return [
        f"{shown(path)} ({format_name(problem.format)}): {contents(problem)}.{shutter}",
        f"{rmse}; {number(tracks.mean)} observations per point; {pieces}.",
        f"{plural(count, 'finding')}:" if count else "Nothing looks wrong.",
    ]


def _range(low: str, high: str) -> str:
    return low if low == high else f"{low} to {high}"


def distributions(description: Description) -> Table:
    """Return the lengths of tracks and the observations of images."""

    def row(name: str, values: Distribution) -> tuple[str, ...]:
        return (name, *map(number, (values.min, values.median, values.mean, values.max)))

    rows = [
        row("observations per point", description.track_length),
        row("observations per image", description.observations_per_image),
    ]
    return Table.of(("", "min", "median", "mean", "max"), rows)


def _histogram(title: str, noun: str, values: Distribution) -> Table:
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
    return Table.of((title, "", noun, "share"), rows, left=2)


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


def _error(description: Description) -> str:
    error = description.reprojection_error
    if error is None:
        return "unknown: there are camera models that bundle does not know"
    if error.num_observations == 0:
        return "no observation has a projection"
    return (
        f"RMSE {pixels(error.rmse)} px, mean {pixels(error.mean)}, median {pixels(error.median)}, "
        f"95th percentile {pixels(error.p95)}, max {pixels(error.max)}, "
        f"over {plural(error.num_observations, 'observation')}"
    )
