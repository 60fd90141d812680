"""Models and graphs: `bundle info`, `convert`, `align`, `merge`, `report`; `refine` of a graph."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bundle.cli.error_lines import EXIT_NO_SOLUTION
from bundle.cli.georeferencing import (
    carry_georeference,
    check_georeference,
    georeference_at,
    prior_flags,
    write_georeference,
)
from bundle.cli.option_flags import naming_flags, options_given
from bundle.cli.output import check_replaced, same_images
from bundle.cli.problem_edits import cameras_edited, with_rigs
from bundle.errors import InputError, shown
from bundle.georeference.measurements import ROWS, settings_of
from bundle.georeference.survey_priors import survey_settings
from bundle.interface.camera_edit_options import LensOptions
from bundle.interface.finding import one_list
from bundle.interface.georeference_options import GeoreferenceOptions
from bundle.interface.options import SolveOptions
from bundle.io.georeference_file import owner_of, path_beside
from bundle.io.open import check_target, load, output_format, save
from bundle.reports.sections import Report

if TYPE_CHECKING:
    from bundle.cli.run import Run
    from bundle.model.pose_graph_arrays import PoseGraph
    from bundle.model.problem import Problem


def describe_model(run: Run) -> Report:
    """Describe the reconstruction INPUT."""
    from bundle.analysis.statistics.description import describe
    from bundle.cli.declarations import READING, given_of
    from bundle.judging.findings.find import find
    from bundle.reports.terminal.outputs import information

    problem = run.load()
    run.progress.stage("counting")
    description = describe(problem)
    given = given_of(run.arguments, "rig_config", *READING)
    found = find(problem, source=run.source, given=given)
    findings = one_list(description.suspicions, found)
    return information(run.source, problem, description, findings, georeference_at(run.source))


def convert_model(run: Run) -> Report:
    """Write the reconstruction INPUT in another format."""
    from bundle.reports.terminal.outputs import converted

    problem = run.load(rigs=False)
    edits = cameras_edited(run.given(LensOptions), problem)
    edited = problem if edits is None else edits.problem
    edited = with_rigs(edited, run.arguments.rig_config)
    moved = None
    if run.arguments.global_shutter:
        from bundle.editing.rolling_shutters import to_global_shutter

        run.progress.stage("moving observations")
        with naming_flags(problem=f"--global-shutter: {shown(run.source)}"):
            moved = to_global_shutter(edited)
        edited = moved.problem
    output, place = _checked_output(run, [run.source], edited)
    lost = _saved(run, edited, output)
    carry_georeference(place, **output)
    return converted(run.source, problem, output, lost, edits, moved)


def _checked_output(
    run: Run, sources: Sequence[str], *problems: Problem
) -> tuple[dict[str, str], dict[str, Any] | None]:
    """Check that the first problem can be written to OUTPUT, and may replace what is there.

    Return path and format of OUTPUT, and the georeference of the first source, if any.
    """
    first, path = problems[0], run.target
    format = output_format(first.format, path, run.arguments.format, sources[0])
    output = {"path": path, "format": format}
    check_target(first, path, format)
    place = georeference_at(sources[0])
    if place is not None:
        check_georeference(**output)
    check_replaced(path, sources, run.arguments.overwrite, same_images(*problems))
    return output, place


def _saved(run: Run, problem: Problem, output: dict[str, str]) -> tuple[str, ...]:
    """Write OUTPUT; return the data that its format loses."""
    lost: tuple[str, ...] = run.write(
        run.target, lambda _: save(problem, **output, progress=run.progress.text)
    )
    return lost


MERGED = "Merged with another model, in the frame of the first."


def merge_models(run: Run) -> Report:
    """Merge models A and B into OUTPUT."""
    from bundle.editing.merge_models import merge
    from bundle.reports.terminal.outputs import merged_report

    arguments = run.arguments
    paths = (arguments.a, arguments.b)
    with naming_flags(a="A", b="B", max_error="--max-error"):
        problems = []
        for path in paths:
            run.progress.stage(f"reading {shown(path)}")
            problems.append(load(path, run.progress.text))
        a, b = problems
        output, place = _checked_output(run, paths, a, b)
        run.progress.stage("merging")
        merged = merge(a, b, max_error=arguments.max_error)
        lost = _saved(run, merged.problem, output)
        carry_georeference(place, **output, changed=MERGED)
    return merged_report(paths, (a, b), merged, output, lost)


def convert_pose_graph(run: Run) -> Report:
    """Write the pose graph INPUT with or without compression; compute missing poses."""
    from bundle.io.g2o_files import check_g2o_target, graph_format, save_g2o
    from bundle.reports.terminal.outputs import converted

    check_g2o_target(run.target)
    graph = run.load()
    _check_graph_replaced(run, graph)
    lost = run.write(run.target, partial(save_g2o, graph))
    output = {"path": run.target, "format": graph_format(run.target)}
    return converted(run.source, graph, output, lost)


def refine_pose_graph(run: Run) -> Report:
    """Refine the pose graph INPUT into OUTPUT."""
    from bundle.base.own_process import Waiting, waiting_since
    from bundle.cli.many_processes import note_alone
    from bundle.graphs.pose_graphs.solve_pose_graph import solve_pose_graph
    from bundle.interface.pose_graph_options import PoseGraphOptions
    from bundle.io.g2o_files import check_g2o_target, graph_format, save_g2o
    from bundle.reports.terminal.pose_graph_tables import refined_graph

    note_alone("refines the pose graph")
    options = run.given(PoseGraphOptions)
    check_g2o_target(run.target)
    with run.timing("load"):
        graph = run.load()
    _check_graph_replaced(run, graph)
    run.progress.stage("building the problem")
    before = Waiting.now()
    with naming_flags(PoseGraphOptions):
        solved = solve_pose_graph(graph, options, progress=run.progress.iteration)
    waiting = waiting_since(before)
    is_done = solved.summary.is_solution_usable and not solved.summary.interrupted
    is_saved = solved.summary.is_solution_usable or solved.summary.interrupted
    if is_saved:
        with run.timing("save"):
            run.write(run.target, partial(save_g2o, solved.problem))
    run.page("reports.page.graph_report:write_graph_report", solved, name=str(run.source))
    wall = run.wall_time(solved)
    run.end(0 if is_done else EXIT_NO_SOLUTION, solved.outcome)
    written = {"path": run.target, "format": graph_format(run.target)} if is_saved else None
    return refined_graph(run.source, solved, wall, written, waiting)


def plan_pose_graph(run: Run) -> list[str]:
    """Check and read a pose graph for --dry-run; return its predicted cost."""
    from bundle.interface.pose_graph_options import PoseGraphOptions
    from bundle.io.g2o_files import check_g2o_target
    from bundle.planning.inspection.problem_inspection import inspect
    from bundle.reports.terminal.graph_costs import inspected_graph

    options = run.given(PoseGraphOptions)
    check_g2o_target(run.target)
    graph = run.load()
    _check_graph_replaced(run, graph)
    run.progress.stage("inspecting")
    found = inspect(graph, num_threads=options.num_threads)
    return [*inspected_graph(run.source, graph, found, run.wall).headline]


def _check_graph_replaced(run: Run, graph: PoseGraph) -> None:
    """Refuse to replace a pose graph with other poses."""
    from bundle.io.g2o_files import load_g2o

    def has_same_poses(path: Path) -> bool:
        there = load_g2o(path)
        return there.poses.shape == graph.poses.shape and sorted(there.ids) == sorted(graph.ids)

    check_replaced(run.target, [run.source], run.arguments.overwrite, has_same_poses)


def report_model(run: Run) -> Report:
    """Write the page of the reconstruction INPUT."""
    from bundle.analysis.statistics.description import describe
    from bundle.analysis.uncertainty.covariance_by_input import covariance
    from bundle.reports.page.report_page import write_report
    from bundle.reports.terminal.outputs import reported

    source, page = str(run.source), _page(run)
    run.options = run.given(SolveOptions, ("loss", "loss_scale"))
    run.check_knowledge(run.options.refine, page=True)
    run.open()
    place, lost = placed(source)
    with run.naming():
        run.progress.stage("computing the covariance")
        certainty = None  # if it does not exist, the page says why
        with suppress(InputError):
            certainty = covariance(
                run.input, run.options, priors=run.priors, constraints=run.constraints,
                scale="sigma0",
            )  # fmt: skip
        run.progress.stage("judging")
        run.judge(lens_sigmas=None if certainty is None else certainty.lens_sigmas)
        found = one_list(describe(run.input).suspicions, run.findings)
        run.progress.stage(f"writing {shown(page)}")
        notes = write_report(
            run.input,
            page,
            options=run.options,
            images=run.arguments.images,
            georeference=place,
            covariance=certainty,
            priors=run.priors,
            constraints=run.constraints,
            findings=found,
            name=source,
        )
    return reported(source, run.input, page, (*lost, *notes), run.wall, found)


def _page(run: Run) -> str:
    if run.target == "-":
        raise InputError("--output: expected a file for the page, found -")
    return run.target


def placed(source: str) -> tuple[dict[str, Any] | None, tuple[str, ...]]:
    """Return the content of the georeference.json that `bundle refine` wrote, if it exists.

    The second value has a sentence if the file has other content.
    """
    is_folder = Path(source).is_dir()
    path = path_beside(Path(source), is_folder=is_folder)
    of_it = owner_of(path) in (None, "" if is_folder else Path(source).name)
    if not path.is_file() or not of_it:
        return None, ()
    try:
        found = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError):
        found = None
    if not isinstance(found, dict) or not {"gps", "gcps", "reference_system"} <= found.keys():
        return None, (f"{shown(str(path))} was not written by bundle refine: left out.",)
    return found, ()


def report_pose_graph(run: Run) -> Report:
    """Write the page of the pose graph INPUT."""
    from bundle.reports.page.graph_report import write_graph_report
    from bundle.reports.terminal.outputs import reported

    page = _page(run)
    graph = run.load()
    findings = run.write(page, lambda path: write_graph_report(graph, path, name=str(run.source)))
    return reported(str(run.source), graph, page, (), run.wall, findings)


FLAGS = {
    "to": "--reference",
    "align": "expected --gcp, --gps or --reference",
}
"""Flags of the arguments of :func:`bundle.align`, which refuses flags without effect."""


def align_model(run: Run) -> Report:
    """Align INPUT into OUTPUT."""
    from bundle.georeference.alignment import align
    from bundle.reports.terminal.outputs import alignment

    arguments = run.arguments
    given = options_given(arguments, GeoreferenceOptions, beside=GeoreferenceOptions.names())
    if given.gps_offset != "none":
        raise InputError(
            "--gps-offset: valid only with refine, which estimates it together with the cameras"
        )
    with naming_flags(**{**prior_flags(given), **FLAGS}):
        problem = run.load()
        output, _ = _checked_output(run, [run.source], problem)
        check_georeference(**output)
        run.progress.stage("aligning")
        settings = settings_of(given, *(row for row in ROWS if row.places))
        aligned = align(problem, to=arguments.reference, **survey_settings(problem, settings))
    lost = _saved(run, aligned.problem, output)
    write_georeference(aligned, **output, reference=arguments.reference)
    return alignment(run.source, problem, aligned, output, lost)
