"""Report of `bundle refine` on a reconstruction."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from bundle.base.own_process import Waiting
from bundle.base.words import change, few, format_size, pixels, plural
from bundle.errors import shown
from bundle.interface.summary import Summary, sizes
from bundle.model.content_digests import content_digests
from bundle.model.problem import Problem
from bundle.model.residuals import ImageError
from bundle.reports.sections import Column, Report, Section, Table, displayed
from bundle.reports.terminal.inputs import (
    about_input,
    edit_data,
    edit_rows,
    input_facts,
    rig_fact,
    sensor_sections,
    solved_data,
    solved_sentences,
    written,
)
from bundle.reports.terminal.solve_data import (
    WallTime,
    before_and_after,
    constraint_sections,
    environment_data,
    factor_fact,
    loops_section,
    process_sections,
    result_data,
    round_tables,
    wall_section,
)
from bundle.solving.headline import edit_facts, headline
from bundle.solving.parameter_changes import CameraChange, camera_changes, sensor_changes
from bundle.solving.result import Result

if TYPE_CHECKING:
    from bundle.editing.camera_sharing import CameraEdits
    from bundle.georeference.measurements import MeasurementErrors
    from bundle.graphs.loops.loop_closing import LoopClosing
    from bundle.inertial.offline.inertial_result import InertialAdjustment
    from bundle.interface.finding import Finding
    from bundle.solving.measured_result import RestRecord

OPTIONAL = ("rounds", "tracks", "held_out", "part", "constraints")
"""Entries of the JSON report that exist if the result has such records."""
MOST_CAMERAS = 5  # number of cameras whose changes are shown


def refinement(
    path: str,
    problem: Problem,
    solved: Result,
    wall: WallTime,
    output: dict[str, str] | None,
    lost: Sequence[str] = (),
    more_options: Mapping[str, Any] | None = None,
    edits: CameraEdits | None = None,
    closed: LoopClosing | None = None,
    findings: Sequence[Finding] = (),
    waiting: Waiting | None = None,
    measured: Sequence[MeasurementErrors] = (),
    inertial: InertialAdjustment | None = None,
    readout_sigma: dict[int, float] | None = None,
) -> Report:
    """Return the report on one solve; ``output`` is None if nothing was written."""
    sigmas = readout_sigma or {}
    summary, changes = solved.summary, camera_changes(solved)
    warnings = (*(edits.warnings if edits else ()), *summary.warnings)
    first, last = ([], []) if inertial is None else inertial.headline
    details = [
        Section(facts=_facts(path, problem, solved, edits)),
        *([] if closed is None else [loops_section(closed)]),
        *(Section(tables=[table]) for table in round_tables(solved)),
        Section(tables=[before_and_after(solved)]),
        *_held_out(solved),
        *(section for errors in measured for section in displayed(errors.displays)),
        *_cameras(changes),
        *constraint_sections(solved.constraints),
        *sensor_sections(sensor_changes(solved)),
        *worst_sections(solved.worst_images, "worst images, after"),
        wall_section(summary, wall),
        *([] if summary.processes is None else process_sections(summary.processes)),
    ]
    about = result_data(solved)
    about["options"] |= more_options or {}
    data = {
        **edit_data(edits),
        **({} if closed is None else {"loops": closed.asdict()}),
        **about,
        **{name: known for name in OPTIONAL if (known := getattr(solved, name))},
        "held_cost": summary.held_cost,
        "convergence": {
            "distance_in_sigmas": summary.distance_in_sigmas,
            "largest_camera_step_in_sigmas": summary.largest_camera_step_in_sigmas,
        },
        "deleted": solved.deleted,
        "edits": _edits(solved),
        "movement": solved.movement,
        "cameras": changes,
        **({"sensors": sensor_changes(solved)} if problem.num_frames else {}),
        "worst_images": solved.worst_images,
        **({} if inertial is None else {"imu": inertial.asdict()}),
        **{key: entry for errors in measured for key, entry in errors.entries.items()},
        **solved_data(solved, sigmas),
        "wall_time": wall,
        "environment": environment_data(waiting),
        "output": output,
    }
    return Report(
        command="refine",
        input=about_input(path, problem) | {"digests": content_digests(problem)},
        headline=[
            *first,
            *headline(solved),
            *solved_sentences(solved, sigmas),
            *(sentence for errors in measured for sentence in errors.sentences),
            *last,
        ],
        findings=findings,
        warnings=[
            *warnings,
            *(warning for errors in measured for warning in errors.warnings),
            *(f"lost: {what}" for what in lost),
        ],
        sections=[
            Section(facts=[*edit_facts(solved), written(output, path)]),
            *(dataclasses.replace(section, is_detail=True) for section in details),
        ],
        data=data,
    )


def _facts(
    path: str, problem: Problem, solved: Result, edits: CameraEdits | None
) -> list[tuple[str, str]]:
    summary = solved.summary
    return [
        *input_facts(path, problem),
        *edit_rows(edits),
        *rig_fact(problem),
        ("refined", _refined(solved)),
        *_gauge(solved),
        *_part(solved),
        ("backend", _backend(summary)),
        *((("", summary.backend_choice),) if summary.backend_choice else ()),
        ("solver", _solver(summary)),
        *((("", summary.linear_solver_choice),) if summary.linear_solver_choice else ()),
        ("ordering", _ordering(summary)),
        *factor_fact(summary),
    ]


def _held_out(solved: Result) -> list[Section]:
    held = solved.held_out
    if held is None:
        return []
    rows = [
        (
            name,
            str(errors.num_observations),
            pixels(errors.median),
            pixels(errors.clipped_rmse),
            f"{100 * errors.share_clipped:.2f} %",
        )
        for name, errors in (("fitted", held.fitted), ("held out", held))
    ]
    head = ("", "observations", "median [px]", f"RMSE, at most {held.clip:g} px", "clipped")
    notes = [
        f"A second fit without {held.percent:g} % of the observations (seed {held.seed}); OUTPUT "
        "is the fit to all."
    ]
    if not held.is_converged:
        notes.append("The second fit did not converge: its held-out error may be too small.")
    return [Section(tables=[Table.of(head, rows)], notes=notes)]


def _part(solved: Result) -> list[tuple[str, str]]:
    part = solved.part
    if part is None:
        return []
    neighbours = plural(part.num_images_held, "image")
    adjusted = (
        f"only {plural(part.num_images, 'image')}, {plural(part.num_points, 'point')}; "
        f"{plural(part.num_observations, 'observation')} of these points, with {neighbours} "
        f"{'constant' if part.rest is None else 'under a marginal prior'}"
    )
    if part.rest is not None:
        return [("", adjusted), *_rest(part.rest)]
    held = set(solved.options.fixed_camera_ids)
    shared = [str(key) for key in part.shared_camera_ids if key not in held]
    if not shared or not {"focal", "principal_point", "extra"} & set(solved.options.refine):
        return [("", adjusted)]
    cameras = f"{'camera' if len(shared) == 1 else 'cameras'} {few(shared)}"
    return [
        ("", adjusted),
        ("", f"{cameras} also serve constant images (--fix-cameras keeps their errors)"),
    ]


def _rest(rest: RestRecord) -> list[tuple[str, str]]:
    gone = f"{plural(rest.num_images, 'image')} and {plural(rest.num_points, 'point')} marginalised"
    if rest.prior_size == 0:
        return [("", f"{gone}: no influence on the others")]
    prior = (
        f"{gone}: a prior on {plural(rest.prior_size, 'unknown')} (rank "
        f"{rest.prior_rank}, {format_size(rest.prior_bytes)}), cost "
        f"{change(rest.cost_before, rest.cost_after)}"
    )
    if rest.gauge_degrees == 0:
        return [("", prior)]
    degrees = plural(rest.gauge_degrees, "degree")
    held = f"{degrees} of freedom, fixed by keeping the neighbouring images in place on average"
    return [("", prior), ("gauge", held)]


def _edits(solved: Result) -> list[dict[str, Any]]:
    rows = [*solved.edit_errors]
    if solved.deleted.num_observations:
        rows.append(("deletion", solved.reprojection_error_before, solved.kept.before))
    return [{"edit": edit, "before": before, "after": after} for edit, before, after in rows]


def worst_sections(images: Sequence[ImageError], title: str) -> list[Section]:
    """Return the images with the largest errors; empty for a problem with one image."""
    columns = (
        Column(title, lambda image: shown(image.name) or f"image {image.image_id}"),
        Column("observations", "num_observations"),
        Column("RMSE [px]", "rmse", pixels),
        Column("max error [px]", "max", pixels),
    )
    return [Section(tables=[Table(columns, images)])] if len(images) > 1 else []


def _cameras(changes: Sequence[CameraChange]) -> list[Section]:
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
    head = ("camera", "parameter", "before", "after", "change")
    count = len(changes) - MOST_CAMERAS
    others = [f"{plural(count, 'other camera')} changed less; --json FILE lists all"]
    table = Table.of(head, rows, left=2, keys=2)
    return [Section(tables=[table], notes=others if count > 0 else [])]


def _refined(solved: Result) -> str:
    options, part = solved.options, solved.part
    names = [name.replace("_", " ") for name in options.refine]
    if options.refine_sensor_from_rig:
        if part is None or part.num_sensors:
            names.append("sensors on rigs")
        else:
            names.append("no sensors on rigs, which have images outside of the part")
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
