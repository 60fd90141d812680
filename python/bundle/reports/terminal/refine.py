"""What `bundle refine` says at the end."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.console import RenderableType

from bundle.base.memory_sizes import format_size
from bundle.base.tables import (
    Columns,
    columns,
    facts,
    format_name,
    notes,
    number,
    pixels,
    plural,
    seconds,
)
from bundle.base.words import change, contents
from bundle.errors import shown
from bundle.interface.options import SolveOptions
from bundle.interface.summary import Summary, sizes
from bundle.model.problem import Problem
from bundle.model.worst_images import ImageError
from bundle.reports.terminal.camera_edit_rows import edit_rows
from bundle.reports.terminal.loop_tables import loops_table
from bundle.reports.terminal.process_tables import process_tables
from bundle.reports.terminal.rig_tables import rig_fact, sensor_table
from bundle.reports.terminal.timing import WallTime, wall_table
from bundle.solving.camera_changes import CameraChange, camera_changes
from bundle.solving.result import Result
from bundle.solving.round_record import RestRecord
from bundle.solving.sensor_changes import sensor_changes

if TYPE_CHECKING:
    from bundle.editing.cameras.edit_record import CameraEdits
    from bundle.georeference.georeferenced import Georeference
    from bundle.graphs.loops.loop_closing import LoopClosing

__all__ = ["contents", "outcome", "refinement", "worst_table"]

MOST_CAMERAS = 5
"""Cameras whose changes are shown."""


def refinement(
    path: str,
    problem: Problem,
    solved: Result,
    wall: WallTime,
    output: dict[str, str] | None,
    lost: tuple[str, ...],
    georeference: Georeference | None = None,
    edits: CameraEdits | None = None,
    closed: LoopClosing | None = None,
) -> list[RenderableType]:
    """Return the report on one solve; `output` is None where nothing was written."""
    summary = solved.summary
    rows = [
        ("input", f"{shown(path)} ({format_name(problem.format)})"),
        ("", contents(problem)),
        *edit_rows(edits),
        *rig_fact(problem),
        ("refined", _refined(solved.options)),
        *_gauge(solved),
        *_part(solved),
        ("backend", _backend(summary)),
        *((("", summary.backend_choice),) if summary.backend_choice else ()),
        ("solver", _solver(summary)),
        *((("", summary.linear_solver_choice),) if summary.linear_solver_choice else ()),
        ("ordering", _ordering(summary)),
        *((("factor", _factor(summary)),) if summary.num_factor_nonzeros is not None else ()),
    ]
    written = (
        f"{shown(output['path'])} ({format_name(output['format'])})"
        if output
        else "nothing was written"
    )
    return [
        facts(rows),
        "",
        *([] if closed is None else loops_table(closed)),
        *_rounds(solved),
        _before_and_after(solved),
        "",
        *_positions(georeference),
        *_cameras(camera_changes(solved)),
        *_constraints(solved),
        *sensor_table(sensor_changes(solved)),
        *worst_table(solved.worst_images, "worst images, after"),
        facts([("outcome", outcome(solved))]),
        *notes((*(edits.warnings if edits else ()), *summary.warnings), style="yellow"),
        "",
        wall_table(summary, wall),
        "",
        *process_tables(summary.processes),
        facts([("output", written)]),
        *notes(f"lost: {what}" for what in lost),
    ]


def _positions(georeference: Georeference | None) -> list[RenderableType]:
    if georeference is None:
        return []
    from bundle.reports.terminal.gps import gps_report

    return gps_report(georeference)


def _constraints(solved: Result) -> list[RenderableType]:
    if not solved.constraints:
        return []
    from bundle.reports.terminal.constraint_tables import constraint_report

    return constraint_report(solved.constraints)


def _part(solved: Result) -> list[tuple[str, str]]:
    """Return which part was adjusted; nothing where it was the whole problem."""
    part = solved.part
    if part is None:
        return []
    neighbours = plural(part.num_images_held, "image")
    adjusted = (
        f"only {plural(part.num_images, 'image')}, {plural(part.num_points, 'point')}; "
        f"{plural(part.num_observations, 'observation')} of these points, with {neighbours} "
        f"{'held' if part.rest is None else 'under a marginal prior'}"
    )
    if part.rest is not None:
        return [("", adjusted), *_rest(part.rest)]
    held = set(solved.options.fixed_camera_ids)
    shared = [str(key) for key in part.shared_camera_ids if key not in held]
    if not shared or not {"focal", "principal_point", "extra"} & set(solved.options.refine):
        return [("", adjusted)]
    more = f" and {len(shared) - 3} more" if len(shared) > 3 else ""
    cameras = f"{'camera' if len(shared) == 1 else 'cameras'} {', '.join(shared[:3])}{more}"
    return [
        ("", adjusted),
        ("", f"{cameras} also took images that are held, whose errors change (--fix-cameras)"),
    ]


def _rest(rest: RestRecord) -> list[tuple[str, str]]:
    """Return what the marginal prior of the rest is made of."""
    gone = f"{plural(rest.num_images, 'image')} and {plural(rest.num_points, 'point')} marginalised"
    if rest.prior_size == 0:
        return [("", f"{gone}, which say nothing of these")]
    prior = (
        f"{gone} at their values: a prior on {plural(rest.prior_size, 'unknown')} (rank "
        f"{rest.prior_rank}, {format_size(rest.prior_bytes)}), cost "
        f"{change(rest.cost_before, rest.cost_after)}"
    )
    if rest.gauge_degrees == 0:
        return [("", prior)]
    degrees = plural(rest.gauge_degrees, "degree")
    return [("", prior), ("gauge", f"neighbours stay on average, {degrees} of freedom")]


def _rounds(solved: Result) -> list[RenderableType]:
    """Return what each round did, and an empty line; nothing where there are no rounds."""
    if not solved.rounds:
        return []
    rows = [
        (
            f"{done.round}",
            f"{done.initial_cost:.9e}",
            f"{done.cost:.9e}",
            f"{done.num_observations}",
            f"{done.num_observations_removed}",
            f"{done.num_points}",
            f"{done.num_points_removed}",
        )
        for done in solved.rounds
    ]
    titles = ("round", "cost before", "cost after")
    return [columns((*titles, "observations", "removed", "points", "removed"), rows), ""]


def worst_table(images: Sequence[ImageError], title: str) -> list[RenderableType]:
    """Return the images with the largest errors and an empty line; nothing for one image."""
    if len(images) < 2:
        return []
    rows = [
        (
            shown(image.name) or f"image {image.image_id}",
            str(image.num_observations),
            pixels(image.rmse),
            pixels(image.max),
        )
        for image in images
    ]
    return [columns((title, "observations", "RMSE [px]", "max error [px]"), rows), ""]


def _cameras(changes: Sequence[CameraChange]) -> list[RenderableType]:
    """Return what changed in the intrinsics, of the cameras that moved most."""
    if not changes:
        return []
    rows = []
    for changed in changes[:MOST_CAMERAS]:
        label = f"{changed.camera_id} {changed.model}"
        for name, before in changed.before.items():
            after = changed.after[name]
            if after != before:
                rows.append(
                    (label, name, f"{before:.7g}", f"{after:.7g}", f"{after - before:+.3g}")
                )
                label = ""
    report: list[RenderableType] = [
        columns(("camera", "parameter", "before", "after", "change"), rows, left=2, keys=2)
    ]
    if len(changes) > MOST_CAMERAS:
        others = plural(len(changes) - MOST_CAMERAS, "other camera")
        report += notes([f"{others} changed less; --json FILE lists all"])
    return [*report, ""]


def outcome(solved: Result) -> str:
    """Return how the solve ended, in plain words."""
    return solved.outcome


def _refined(options: SolveOptions) -> str:
    names = [name.replace("_", " ") for name in options.refine]
    names += ["sensors on rigs"] * options.refine_sensor_from_rig
    refined = ", ".join(names) or "nothing"
    words = [refined, f"gauge {options.gauge.replace('_', '-')}"]
    if options.loss != "trivial":
        words.append(f"{options.loss.replace('_', '-')} loss at {options.loss_scale:g} px")
    fixed = (
        (options.fixed_camera_ids, "camera"),
        (options.fixed_image_ids, "image"),
        (options.fixed_point_ids, "point"),
        (options.fixed_sensors, "sensor"),
    )
    words += [f"{plural(len(ids), noun)} fixed" for ids, noun in fixed if ids]
    return "; ".join(words)


def _gauge(solved: Result) -> list[tuple[str, str]]:
    """Return what the gauge of rigs takes away; nothing where there are no rigs."""
    if not solved.problem.num_frames or solved.options.gauge == "none":
        return []
    return [("gauge", f"{solved.gauge_freedom.sentence}: held")]


def _backend(summary: Summary) -> str:
    if summary.instruction_set:
        return f"{summary.backend_used} ({summary.instruction_set})"
    return summary.backend_used


def _solver(summary: Summary) -> str:
    words = f"{summary.linear_solver_type_used} on {plural(summary.num_threads_used, 'thread')}"
    if summary.linear_solver_type_used in ("ITERATIVE_SCHUR", "CGNR"):
        words += f", preconditioner {summary.preconditioner_type_used}"
    return words


def _ordering(summary: Summary) -> str:
    words = sizes(summary.linear_solver_ordering_used)
    if summary.linear_solver_ordering_given != summary.linear_solver_ordering_used:
        words += f" (given: {sizes(summary.linear_solver_ordering_given)})"
    if summary.schur_structure_used:
        words += f"; Schur structure {summary.schur_structure_used}"
    return words


def _factor(summary: Summary) -> str:
    nonzeros, flops = summary.num_factor_nonzeros or 0, summary.factor_flops or 0.0
    return (
        f"{plural(summary.num_factor_columns or 0, 'column')}, {summary.factor_ordering} order, "
        f"{number(nonzeros)} nonzeros, {number(flops)} flops, analysed in "
        f"{seconds(summary.symbolic_time_in_seconds or 0.0)} s"
    )


def _before_and_after(solved: Result) -> Columns:
    before, after = solved.reprojection_error_before, solved.reprojection_error_after
    titles = {
        "rmse": "RMSE [px]",
        "mean": "mean error [px]",
        "median": "median error [px]",
        "p95": "95th percentile [px]",
        "max": "max error [px]",
    }
    rows = [
        *(
            [("cost", f"{solved.summary.initial_cost:.9e}", f"{solved.summary.final_cost:.9e}")]
            if not solved.rounds  # costs of different rounds cannot be compared
            else []
        ),
        *([("held cost", "-", f"{held:.9e}")] if (held := solved.summary.held_cost) else []),
        *(
            (title, pixels(getattr(before, name)), pixels(getattr(after, name)))
            for name, title in titles.items()
        ),
        ("observations", str(before.num_observations), str(after.num_observations)),
        ("behind camera", str(before.num_behind_camera), str(after.num_behind_camera)),
    ]
    return columns(("", "before", "after"), rows)
