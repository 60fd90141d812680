"""Sections on a model: outcome, RMSE, lenses, shutters, tracks, georeference."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.statistics.description import Description
from bundle.base.words import contents, few, number, pixels, plural, seconds
from bundle.figures import structure_figures
from bundle.figures.cost_figures import iteration_figure
from bundle.figures.lens_figures import LensCurve, focal_figure, lens_figure, most_observed_cameras
from bundle.figures.marks import Figure
from bundle.figures.placement_figures import (
    Placement,
    block,
    overlap_figure,
    plan_figure,
    position_figure,
    target_figure,
)
from bundle.figures.residual_field import twist_figures
from bundle.figures.residual_figures import (
    ResidualHistogram,
    coordinate_figure,
    image_error_figure,
    length_figure,
)
from bundle.figures.structure_figures import (
    CovisibilityGraph,
    TrackStatistics,
    angle_figure,
    covisibility_figure,
)
from bundle.interface.options import SolveOptions
from bundle.model.cameras import camera_models, param_kinds
from bundle.model.problem import Problem
from bundle.model.residuals import Residuals
from bundle.reports.sections import Section, Table
from bundle.reports.terminal.inputs import (
    about_shutter,
    shutter_fact,
    solved_data,
    solved_sentences,
)
from bundle.reports.terminal.outputs import distributions
from bundle.reports.terminal.solve_data import ERRORS, before_and_after, round_tables
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
    tables = round_tables(result)
    costs = np.asarray(result.iterations.get("cost", ()), float)
    figures = [iteration_figure(costs)] if len(costs) > 1 else []
    return [
        Section(title="Solver and options", text=[result.outcome], facts=facts, figures=figures),
        *([Section(title="Rounds", tables=tables, is_joined=True)] if tables else []),
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
        return few(value, 20) or "none"
    return str(value)


ROWS = 12


ROWS_OPEN = 20  # number of control points up to which their table is open
_UNKNOWN = (math.nan, math.nan)
CE90, LE90 = 1.5175, 1.6449
"""90 % quantiles of normal errors over their RMS: of the horizontal length, and of a height."""


def placement_sections(place: Placement, problem: Problem) -> list[Section]:
    """Return tables and figures; all lengths are in metres (east, north, up)."""
    dimensions = block(problem)
    system = place.reference_system
    words = "Metres east, north, up: model minus measurement."
    words += f" Coordinates were read in {system}." if system else ""
    plan = plan_figure(place, problem.projection_centers)
    overlap = None if dimensions is None else overlap_figure(dimensions, problem.projection_centers)
    figures = (plan, overlap, target_figure(place), position_figure(place))
    return [
        Section(
            title="Control points and positions",
            text=[*([] if dimensions is None else [dimensions.sentence]), words],
            tables=_rms(place),
            figures=[figure for figure in figures if figure is not None],
        ),
        *([_targets(place)] if place.targets else []),
        *([_positions(place)] if place.images else []),
    ]  # fmt: skip


def _rms(place: Placement) -> list[Table]:
    """Return RMS errors, those that measure accuracy first, and what is left without their mean."""
    head = ["RMS error", "count", "east [m]", "north [m]", "up [m]", "horizontal [m]", "total [m]"]
    names = {
        "check": "check points",
        "left out": "control points, each left out",
        "control": "control points",
        "gps": "positions of images",
    }
    rows, means = [], []
    for kind, name in names.items():
        errors, rms = place.errors(kind), place.rms(kind)
        if np.isfinite(rms).any():
            known = [column[np.isfinite(column)] for column in errors.T]
            ends = [(one.mean(), one.std(ddof=1)) if len(one) > 1 else _UNKNOWN for one in known]
            east, north, up = (deviation for _, deviation in ends)
            of_90 = CE90 * rms[3], LE90 * rms[2], CE90 * math.hypot(east, north), LE90 * up
            rows.append([name, f"{len(errors)}", *map(_metres, rms)])
            words = [f"{mean:+.4f} ± {d:.4f}" if math.isfinite(d) else "-" for mean, d in ends]
            means.append([name, *words, *map(_metres, of_90)])
    legend = (
        "CE90, LE90: horizontal and vertical errors that 90 % of points do not exceed, if errors "
        "are normal and equal in east and north; relative: without their mean, as between points. "
        "A mean far from 0 beside its deviation is systematic, such as a wrong datum of heights."
    )
    head_of_means = ["mean ± standard deviation", *head[2:5], "CE90 [m]", "LE90 [m]",
                     "relative CE90 [m]", "relative LE90 [m]"]  # fmt: skip
    return [Table.of(head, rows), Table.of(head_of_means, means, legend=legend)] if rows else []


def _targets(place: Placement) -> Section:
    head = ["point", "role", "images", "east [m]", "north [m]", "up [m]", "sigma [m]",
            "left out [m]", "RMSE [px]"]  # fmt: skip
    rows = [
        [target.name, "suspect" if target.suspect else target.role, f"{target.num_images}",
         *map(_metres, target.residual), "/".join(map(number, target.sigma[::2])),
         _metres(_length(target.leave_one_out)), pixels(target.pixels)]
        for target in place.targets
    ]  # fmt: skip
    words = "Left out: length of the error when only the other points place the model."
    table = Table.of(head, rows, left=2, most=ROWS, legend=words)
    title = f"Each of {plural(len(rows), 'control or check point', 'control and check points')}"
    return Section(title=title, tables=[table], is_detail=len(rows) > ROWS_OPEN)


def _positions(place: Placement) -> Section:
    head = ["image", "used", "east [m]", "north [m]", "up [m]", "sigmas"]
    ranked = sorted(place.images, key=lambda i: -i.sigmas if math.isfinite(i.sigmas) else 1.0)
    rows = [
        [image.name, "yes" if image.used else "no", *map(_metres, image.residual),
         f"{image.sigmas:.1f}" if math.isfinite(image.sigmas) else "-"]
        for image in ranked
        if np.isfinite(image.residual).any()
    ]  # fmt: skip
    without = len(place.images) - len(rows)
    words = f"{plural(without, 'image')} without a position." if without else ""
    table = Table.of(head, rows, left=2, most=ROWS, legend=words)
    title = f"Each of {plural(len(rows), 'measured position')}"
    return Section(title=title, tables=[table], is_detail=True)


def _length(values: Sequence[float]) -> float:
    known = [value for value in values if math.isfinite(value)]
    return math.hypot(*known) if known else math.nan


def _metres(value: float) -> str:
    return f"{value:.4f}" if math.isfinite(value) else "-"


def structure_section(
    description: Description, tracks: TrackStatistics, graph: CovisibilityGraph
) -> Section:
    """Return the section on tracks and co-visibility."""
    longest = description.track_length.max
    sizes = description.covisibility.component_sizes
    listed = ", ".join(f"{size:,}" for size in sizes[:5]) + (", ..." if len(sizes) > 5 else "")
    words = "No image shares a point with another."
    if sizes:
        words = f"{plural(len(sizes), 'connected piece')} of images that share points: {listed}."
    return Section(
        title="Tracks and co-visibility",
        text=[f"{words} The stronger an edge, the more points its images share."],
        tables=[distributions(description)],
        figures=[
            *([structure_figures.length_figure(tracks, int(longest))] if longest > 0 else []),
            *([angle_figure(tracks)] if tracks.angles.any() else []),
            covisibility_figure(graph),
        ],
    )


MOST_LENSES = 200  # number of cameras whose curves and focal lengths are drawn

Sigmas = Mapping[int, NDArray[np.float64]]


def lens_sections(
    problem: Problem,
    curves: Sequence[LensCurve],
    initial: Problem | None,
    before: Sequence[LensCurve],
    sigmas: Sigmas | None,
) -> list[Section]:
    """Return the figures of each kind of camera, and the parameters.

    Curves of the problem before a solve are drawn for single cameras, where they differ. Sigmas are
    by index, NaN for constant parameters; None if unknown.
    """
    words = (
        "Distortion: outward shift of the image of a ray. Dashed: outermost observation, corner."
    )
    index = {int(camera_id): k for k, camera_id in enumerate(problem.camera_ids.tolist())}
    kinds: dict[tuple[str, int, int], list[LensCurve]] = {}
    for curve in curves:
        width, height = problem.camera_sizes[index[curve.camera_id]].tolist()
        kinds.setdefault((curve.model, width, height), []).append(curve)
    figures: list[Figure | None] = []
    earlier = {curve.camera_id: curve for curve in before}
    for (model, width, height), group in kinds.items():
        if len(group) == 1:
            figures.append(_single(group[0], earlier.get(group[0].camera_id)))
            continue
        size = f", {width} x {height}" if width > 0 else ""
        name = f"{plural(len(group), 'camera', grouped=True)}, {model}{size}"
        named = {f"camera {curve.camera_id}": curve for curve in group}
        figures.append(lens_figure(named, name))
        figures += _focal(problem, sorted(index[curve.camera_id] for curve in group), sigmas)
    drawn = [figure for figure in figures if figure is not None]
    text = [words] if any(figure.name == "distortion" for figure in drawn) else []
    cameras = most_observed_cameras(problem)
    title = "Parameters"
    if len(cameras) < problem.num_cameras:
        title += f" of the {plural(len(cameras), 'camera')} with most observations"
    table = _parameters(problem, initial, cameras, sigmas)
    if len(cameras) == 1:
        return [Section(title="Lenses", text=text, figures=drawn, tables=[table])]
    return [
        Section(title="Lenses", text=text, figures=drawn),
        Section(title=title, tables=[table], is_detail=True),
    ]


def _focal(problem: Problem, cameras: Sequence[int], sigmas: Sigmas | None) -> list[Figure]:
    model = problem.camera_models[cameras[0]]
    names = camera_models()[model]
    chosen = [k for k, kind in enumerate(param_kinds(model)) if kind == "focal"]
    unknown = np.full(len(names), math.nan)
    known = np.array([unknown if sigmas is None else sigmas.get(k, unknown) for k in cameras])
    return [
        focal_figure(
            problem.camera_ids[list(cameras)].astype(float),
            {names[k]: problem.camera_params[list(cameras), k] for k in chosen},
            {names[k]: known[:, k] for k in chosen},
            "Focal lengths",
        )
    ]


def _parameters(
    problem: Problem, initial: Problem | None, cameras: Sequence[int], sigmas: Sigmas | None
) -> Table:
    head = ["camera", "model", "parameter", *(["before"] if initial else []), "value"]
    head += ["sigma"] if sigmas is not None else []
    earlier = {} if initial is None else {int(k): i for i, k in enumerate(initial.camera_ids)}
    rows = []
    for camera in cameras:
        model, camera_id = problem.camera_models[camera], int(problem.camera_ids[camera])
        for index, name in enumerate(camera_models()[model]):
            row = [f"{camera_id}", model, name]
            if initial is not None:
                first = earlier.get(camera_id, -1)
                same = first >= 0 and initial.camera_models[first] == model
                row.append(f"{initial.camera_params[first, index]:.7g}" if same else "-")
            row.append(f"{problem.camera_params[camera, index]:.7g}")
            if sigmas is not None:
                value = float(sigmas[camera][index]) if camera in sigmas else math.nan
                row.append(number(value) if math.isfinite(value) else "held")
            rows.append(row)
    return Table.of(head, rows, left=3, most=40)


def _single(curve: LensCurve, before: LensCurve | None) -> Figure | None:
    curves = {"now": curve}
    if before is not None and not (
        len(before.radius) == len(curve.radius)
        and np.allclose(before.radius, curve.radius)
        and np.allclose(before.distortion, curve.distortion)
    ):
        curves = {"before": before, "after": curve}
    words = ["Shaded: one standard deviation."] if len(curve.sigma) else []
    if math.isfinite(curve.fold_radius):
        words.append(
            f"The lens folds at {curve.fold_radius:.0f} px: nothing is imaged farther out."
        )
    return lens_figure(curves, f"Camera {curve.camera_id}, {curve.model}", " ".join(words))


def shutter_section(
    problem: Problem, result: Result | None, sigmas: dict[int, float]
) -> list[Section]:
    """Return the rolling shutters of a problem or a solve; ``sigmas`` are by camera id."""
    facts = shutter_fact(problem)
    if not facts:
        return []
    words = [] if result is None else solved_sentences(result, sigmas)
    return [
        Section(
            title="Rolling shutter",
            text=[
                *words,
                "Each image moves while it is read. Its pose is that of the middle row. "
                "Residuals by row are among the residuals over the image.",
            ],
            facts=facts,
            figures=twist_figures(problem),
        )
    ]


def shutter_data(
    problem: Problem, result: Result | None, sigmas: dict[int, float]
) -> dict[str, Any]:
    """Return the same as JSON entries; empty without rolling shutters."""
    if result is None or not about_shutter(problem):
        return about_shutter(problem)
    return solved_data(result, sigmas)
