"""Reports of `bundle info`, and of `align`, `convert`, `merge`, `report` and `synth`."""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bundle.analysis.diagnosis.track_table import Covisibility
from bundle.analysis.statistics.description import Description, Distribution
from bundle.analysis.statistics.suspicions import COLLAPSED
from bundle.base.tables import Bar
from bundle.base.words import contents, format_name, format_size, number, pixels, plural
from bundle.editing.merge_models import Merge
from bundle.errors import shown
from bundle.georeference.alignment_result import (
    Alignment,
    ImageError,
    metres,
    plain_metres,
    point_errors,
    suspicions,
)
from bundle.georeference.local_frame import frame_sentences
from bundle.interface.finding import DETAILS, Finding
from bundle.interface.scene_options import SceneOptions
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.problem import Problem
from bundle.model.pycolmap.problem_source import imported_source
from bundle.model.unobserved import unobserved
from bundle.reports.sections import Column, Report, Section, Table, displayed, fields
from bundle.reports.terminal.inputs import (
    about_input,
    contents_of,
    edit_data,
    edit_rows,
    import_notes,
    input_facts,
    rig_sections,
    shutter_data,
    shutter_fact,
    shutter_moves,
    written,
)
from bundle.reports.terminal.refine import worst_sections
from bundle.synthetic.blocks import SceneTally

if TYPE_CHECKING:
    from bundle.editing.camera_sharing import CameraEdits
    from bundle.editing.rolling_shutters import GlobalShutterModel


CAMERAS = (
    Column("camera model", "model"),
    Column("cameras", "num_cameras"),
    Column("images", "num_images"),
    Column("images/camera", lambda group: _range(*map(str, group.images_per_camera))),
    Column(
        "focal length [px]", lambda group: _range(*map(number, group.focal)) if group.focal else "-"
    ),
    Column("refinable", lambda group: "yes" if group.supported else "no"),
)


def information(
    path: str,
    problem: Problem,
    description: Description,
    findings: Sequence[Finding],
    place: Mapping[str, Any] | None = None,
) -> Report:
    """Return the report on a problem; ``place``: the content of its georeference.json."""
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
        headline=[
            *_contents(path, problem, description),
            *frame_sentences(place or {}),
            f"{plural(count_of_findings, 'finding')}:"
            if count_of_findings
            else "Nothing looks wrong.",
        ],
        findings=findings,
        sections=[dataclasses.replace(section, is_detail=True) for section in details],
        data=fields(description),
    )


def _contents(path: str, problem: Problem, description: Description) -> list[str]:
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


def converted(
    path: str,
    given: Problem | PoseGraph,
    output: dict[str, str],
    lost: Sequence[str],
    edits: CameraEdits | None = None,
    moved: GlobalShutterModel | None = None,
) -> Report:
    """Return the report on a reconstruction or a pose graph."""
    content = given if edits is None else edits.problem
    warnings = [] if edits is None else [*edits.warnings]
    notes, more = [], edit_rows(edits)
    if isinstance(content, Problem):
        warnings += filter(None, [unobserved(content)])
    if isinstance(given, Problem):
        notes = import_notes(given)
    else:
        more = [("", note) for note in given.notes]
    rest = "These data are lost:" if lost else "Nothing is lost."
    return Report(
        command="convert",
        input=about_input(path, given),
        headline=[
            f"Wrote {written(output, path)[1]}: {contents_of(content)}. {rest}",
            *shutter_moves(moved),
        ],
        warnings=warnings,
        sections=[
            Section(facts=edit_rows(edits), notes=[*lost, *notes]),
            Section(facts=[*input_facts(path, given), *more], is_detail=True),
        ],
        data={**edit_data(edits), **shutter_data(moved), "output": output, "lost": lost},
    )


def reported(
    path: str,
    given: Problem | PoseGraph,
    page: str,
    notes: Sequence[str],
    wall_time: float,
    findings: Sequence[Finding] = (),
) -> Report:
    """Return the report of `bundle report` about the page that it wrote, and its missing parts."""
    size = f" ({format_size(Path(page).stat().st_size)})" if Path(page).is_file() else ""
    return Report(
        command="report",
        input=about_input(path, given),
        headline=[f"Wrote {shown(page)}{size}: {contents_of(given)}."],
        warnings=notes,
        findings=findings,
        sections=[Section(facts=input_facts(path, given, rigs=True), is_detail=True)],
        data={
            "notes": notes,
            "wall_time": {"total": wall_time},
            "output": {"path": page, "format": "html"},
        },
    )


def merged_report(
    paths: tuple[str, str],
    problems: tuple[Problem, Problem],
    merged: Merge,
    output: dict[str, str],
    lost: Sequence[str],
) -> Report:
    """Return the report: shared images, merged parts, undetermined directions, next step."""
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
        left = f" {plural(undetermined, 'degree')} of freedom between the models are undetermined."
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


EMPTY: Mapping[str, str] = {}
ERRORS = ("rmse", "median", "p95", "max")
SPREAD = ("min", "median", "mean", "max")


def synthesized(
    options: SceneOptions,
    num_cameras: int,
    tally: SceneTally,
    output: dict[str, str],
    truth: dict[str, str],
    measured: Mapping[str, str] = EMPTY,
    lost: Sequence[str] = (),
) -> Report:
    """Return the report on a scene with its start, its truth and its measured attitudes by kind."""
    counts = {
        "num_cameras": num_cameras,
        "num_images": options.num_images,
        "num_points": options.num_points,
        "num_observations": tally.num_observations,
        "num_outliers": tally.num_outliers,
    }
    things = ("image", "camera", "point", "observation", "outlier")
    contents = ", ".join(plural(counts[f"num_{thing}s"], thing) for thing in things)
    where = f"{shown(truth['path'])} ({format_name(truth['format'])})"
    start, goal = tally.errors["start"], tally.errors["ground_truth"]
    headline = [
        f"Wrote {written(output)[1]}: {contents}.",
        f"The ground truth is {where}. RMSE {pixels(start.rmse)} px at the start, "
        f"{pixels(goal.rmse)} px at the truth.",
    ]
    headline += [f"Measured {kind}: {shown(path)}." for kind, path in measured.items()]
    sizes = {"track_length": tally.track_length(), "observations_per_image": tally.image_size()}
    names = [("track length", "track_length"), ("observations per image", "observations_per_image")]
    spread = [(label, *(number(sizes[name][key]) for key in SPREAD)) for label, name in names]
    errors = [
        (label, *(pixels(getattr(tally.errors[name], key)) for key in ERRORS))
        for label, name in (("start", "start"), ("ground truth", "ground_truth"))
    ]
    return Report(
        command="synth",
        headline=headline,
        warnings=lost,
        sections=[
            Section(
                is_detail=True,
                tables=[
                    Table.of(("", *SPREAD), spread),
                    Table.of(("error in pixels", *ERRORS), errors),
                ],
            )
        ],
        data={
            "options": options.asdict(),
            "output": output,
            "ground_truth": truth,
            **({"measured": dict(measured)} if measured else {}),
            **counts,
            **sizes,
            "reprojection_error": tally.errors,
        },
    )


MOST_IMAGES = 10  # number of listed positions, those with the largest errors first


def alignment(
    path: str, problem: Problem, aligned: Alignment, output: dict[str, str], lost: Sequence[str]
) -> Report:
    """Return the report on an alignment of a problem: the place of the model and the errors."""
    rows = [
        *input_facts(path, aligned.problem),
        ("scale", f"{number(aligned.similarity.scale)} per length unit of the input"),
    ]
    if aligned.origin is None and aligned.reference_system:
        rows.append(("coordinates", aligned.reference_system))
    if not np.isnan(aligned.sigma0):
        rows.append(("residuals", f"{number(aligned.sigma0)} sigmas"))
    details = [
        Section(facts=rows),
        *displayed(point_errors(aligned.control_points)),
        *_images("GPS", aligned.positions, aligned.rms("gps"), "m"),
        *_images("image", aligned.shared_images, aligned.rms("shared_images"), "units"),
    ]
    return Report(
        command="align",
        input=about_input(path, problem),
        headline=_headline(aligned),
        warnings=[*suspicions(aligned.control_points), *aligned.notes, *lost],
        sections=[
            Section(facts=[written(output, path)]),
            *(dataclasses.replace(section, is_detail=True) for section in details),
        ],
        data={"georeference": aligned.asdict(), "output": output},
    )


def _headline(aligned: Alignment) -> list[str]:
    said = []
    controls = [point for point in aligned.control_points if point.role == "control"]
    checks = [point for point in aligned.control_points if point.role == "check"]
    for kind, things, noun in (
        ("control", controls, "control point"),
        ("gps", [image for image in aligned.positions if image.used], "position"),
        ("shared_images", [image for image in aligned.shared_images if image.used], "shared image"),
        ("check", checks, "check point"),
    ):
        rms = aligned.rms(kind)
        if things and not np.isnan(rms[0]):
            axes = "x / y / z" if kind == "shared_images" else "east / north / up"
            unit = "units" if kind == "shared_images" else "m"
            errors = " / ".join(map(plain_metres, rms))
            said.append(f"{plural(len(things), noun)}: rms {errors} {unit} {axes}.")
    scale = f"Aligned, scale {number(aligned.similarity.scale)}."
    first = f"{scale} {said[0]}" if said else scale
    return [first, *said[1:], *frame_sentences(aligned.asdict())]


def _images(
    title: str, images: Iterable[ImageError], rms: Iterable[float], unit: str
) -> list[Section]:
    found = list(images)
    if not found:
        return []
    order = sorted(found, key=lambda image: -float(np.nansum(np.square(image.residual))))
    cells = [
        (image.name, "used" if image.used else "not used", *map(metres, image.residual))
        for image in order[:MOST_IMAGES]
    ]
    cells.append(("total rms", plural(len(found), "image"), *map(plain_metres, rms)))
    head = (f"worst {title}", "role", f"east [{unit}]", "north", "up")
    if unit != "m":
        head = (f"worst {title}", "role", f"x [{unit}]", "y", "z")
    return [Section(tables=[Table.of(head, cells, left=2)])]
