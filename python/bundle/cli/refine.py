"""`bundle refine` of a reconstruction: INPUT, options, solve, report, OUTPUT."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from bundle.base.own_process import Waiting, waiting_since
from bundle.cli.carried_georeference import (
    carry_georeference,
    write_georeference,
)
from bundle.cli.error_lines import EXIT_DONE, EXIT_NO_SOLUTION
from bundle.cli.inertial_flags import adjusted_with_imu
from bundle.cli.on_disk import on_disk, with_disk_use
from bundle.cli.output import Progress, publish
from bundle.cli.problem_edits import loops_closed
from bundle.cli.refine_input import Opened, open_input
from bundle.cli.refine_outcome import judge, readout_sigmas, write_page
from bundle.cli.refinement import Refinement
from bundle.cli.standard_streams import complain
from bundle.errors import InputError, shown
from bundle.georeference.measurements import place_of
from bundle.interface.pose_graph_options import LoopOptions
from bundle.io.open import save
from bundle.reports.terminal.refine import refinement
from bundle.reports.terminal.solve_data import WallTime
from bundle.solving.kept_errors import Edit
from bundle.solving.request import PartRequest, SolveRequest
from bundle.solving.rounds.solve_rounds import run as run_plan

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bundle.georeference.measurements import MeasurementErrors
    from bundle.graphs.loops.loop_closing import LoopClosing
    from bundle.inertial.offline.inertial_result import InertialAdjustment
    from bundle.solving.result import Result

STAYED = "Refined again without positions, starting from the georeferenced model."


def run(arguments: argparse.Namespace) -> int:
    """Refine INPUT into OUTPUT."""
    started = perf_counter()
    asked = Refinement.of(arguments)
    with on_disk(asked), Progress(quiet=arguments.quiet) as progress:
        opened = open_input(asked, progress)
        if asked.check_gradients and _has_wrong_jacobians(asked, opened, progress):
            return EXIT_NO_SOLUTION
        closed = _close_loops(asked.loops, opened, progress)
        before = Waiting.now()
        inertial = _adjusted_with_imu(asked, opened, progress)
        result = _solve(asked, opened, closed, progress) if inertial is None else inertial.result
        solved = _with_edits(result, asked, opened, closed)
        waiting = waiting_since(before)
        measured = opened.known.errors(solved)
        begun = perf_counter()
        written, lost = _write(opened, solved, measured, progress)
        save_time = perf_counter() - begun
        statistics_time = _measure(opened, solved, progress)
        findings = judge(asked, opened, solved, inertial)
        if asked.page is not None:
            progress.stage(f"writing {shown(asked.page)}")
            write_page(asked, asked.page, opened, solved, measured, findings)
    wall = WallTime(
        load=opened.load_time,
        build=solved.build_time_in_seconds,
        solve=solved.solve_time_in_seconds,
        save=save_time,
        statistics=statistics_time,
        total=perf_counter() - started,
    )
    told = (asked.source, opened.loaded, solved, wall, written)
    sigmas = readout_sigmas(asked, opened, closed, solved)
    beside = asked.options_beside()
    report = refinement(
        *told, lost, beside, opened.edits, closed, findings, waiting, measured, inertial, sigmas,
    )  # fmt: skip
    publish(with_disk_use(report, asked), asked)
    if solved.summary.is_solution_usable and not solved.summary.interrupted:
        return EXIT_DONE
    if asked.json == "-":  # standard output has only the JSON report
        complain(solved.outcome)
    return EXIT_NO_SOLUTION


def _close_loops(given: LoopOptions, opened: Opened, progress: Progress) -> LoopClosing | None:
    if given.loops is not None:
        progress.stage(f"closing the loops of {shown(given.loops)}")
    return loops_closed(given, opened.problem)


def _solve(
    asked: Refinement, opened: Opened, closed: LoopClosing | None, progress: Progress
) -> Result:
    """Refine the problem with its priors, rules and loops, by the plan of the run."""
    progress.stage("building the problem")
    with asked.naming_flags():
        if opened.sliced is not None:
            return opened.sliced.solve(opened.options, progress.iteration, asked.plan)
        request = SolveRequest(
            problem=opened.problem if closed is None else closed.problem,
            options=opened.options,
            factors=() if closed is None else closed.factors,
            priors=opened.known.priors,
            align=opened.align,
            constraints=asked.constraints,
            part=PartRequest.of(asked.local.only_images, asked.local.rest),
        )
        if asked.plan.database is None:
            return run_plan(request, asked.plan, progress.iteration)
        from bundle.solving import refine_tracks  # for --database only

        return refine_tracks.run(
            request, asked.plan, progress.iteration,
            is_share_given="--hold-out" in asked.given, tell=progress.stage,
        )  # fmt: skip


def _adjusted_with_imu(
    asked: Refinement, opened: Opened, progress: Progress
) -> InertialAdjustment | None:
    """Refine the problem with the samples of an IMU; None without samples."""
    if asked.inertial is None:
        return None
    if opened.place is not None:
        raise InputError("--imu: expected a model without georeference.json, which it would move")
    progress.stage("adjusting with the IMU")
    with asked.naming_flags():
        return adjusted_with_imu(
            asked.inertial, opened.problem, opened.options, opened.known.priors, asked.plan,
            progress.iteration,
        )  # fmt: skip


def _with_edits(
    solved: Result, asked: Refinement, opened: Opened, closed: LoopClosing | None
) -> Result:
    """Return the result with the edits of cameras, rigs and loops before those of the solve."""
    problem = opened.loaded
    edits = []
    for edit, edited in (
        *(() if opened.edits is None else opened.edits.stages),
        ("" if asked.rig_config is None else "rig_config", opened.problem),  # "": only a shutter
        ("loops", opened.problem if closed is None else closed.problem),
    ):
        if edited is not problem:
            edits += [Edit(edit, problem, edited)] if edit else []
            problem = edited
    return dataclasses.replace(solved, edits=(*edits, *solved.edits)) if edits else solved


def _write(
    opened: Opened, solved: Result, measured: Sequence[MeasurementErrors], progress: Progress
) -> tuple[dict[str, str] | None, tuple[str, ...]]:
    """Write a usable result; return its path and format, and the data that the format loses."""
    if not (solved.summary.is_solution_usable or solved.summary.interrupted):
        return None, ()
    target, place = opened.output["path"], place_of(measured)
    progress.stage(f"writing {shown(target)}")
    if opened.sliced is None:
        refined = solved.problem
        if place is not None:
            from bundle.georeference.opensfm_frame import with_origin  # few runs have a place

            refined = with_origin(refined, place.origin)
        lost = save(refined, **opened.output, progress=progress.text)
    else:
        lost = opened.sliced.save(Path(target))
    if place is not None:
        write_georeference(place, **opened.output)
    else:
        carry_georeference(opened.place, **opened.output, changed=STAYED)
    return opened.output, lost


def _measure(opened: Opened, solved: Result, progress: Progress) -> float:
    """Compute reprojection errors before and after; return the elapsed seconds."""
    progress.stage("measuring reprojection errors")
    begun = perf_counter()
    if opened.sliced is not None:
        opened.sliced.measure(solved)
    solved.measure()
    return perf_counter() - begun


def _has_wrong_jacobians(asked: Refinement, opened: Opened, progress: Progress) -> bool:
    """Check the Jacobians; if any is wrong, report that instead of solving."""
    from bundle.checking import gradient_report, jacobians  # only for --check-gradients
    from bundle.reports.terminal.analyses import checked

    progress.stage("checking the Jacobians")
    begun, options = perf_counter(), opened.options
    report = jacobians.check_problem(
        opened.problem, cheirality=options.cheirality, num_threads=options.num_threads
    )
    if report.verdict != "wrong":
        if not report.ok:
            complain(f"note: {gradient_report.outcome(report)} `bundle check` shows where.")
        return False
    if asked.json == "-":
        complain(gradient_report.outcome(report))
    settings = {"check_gradients": True, **options.asdict()}
    took = perf_counter() - begun
    publish(checked(asked.source, opened.problem, report, settings, took), asked)
    return True
