"""`bundle refine` of a reconstruction: INPUT, options, solve, report, OUTPUT."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from bundle.analysis.statistics.suspicions import broken_parts
from bundle.base.own_process import Waiting, waiting_since
from bundle.base.words import pixels, plural
from bundle.cli.error_lines import EXIT_DONE, EXIT_NO_SOLUTION, complain
from bundle.cli.georeferencing import carry_georeference, write_georeference
from bundle.cli.inertial_flags import adjusted_with_imu
from bundle.cli.output import Progress, publish
from bundle.cli.problem_edits import loops_closed
from bundle.cli.refine_input import Opened, on_disk, open_input, with_disk_use
from bundle.cli.refinement import Refinement
from bundle.errors import InputError, shown
from bundle.georeference.measurements import place_of
from bundle.interface.finding import Finding, one_list
from bundle.interface.pose_graph_options import LoopOptions
from bundle.io.open import save
from bundle.judging.findings.find import find
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.minimum import SMALLEST_SHIFT, shifted_pixels
from bundle.judging.findings.next_command import NextCommand
from bundle.judging.findings.positions import DAMPED, RADIUS_FLAG, positions_of_start
from bundle.reports.terminal.refine import refinement
from bundle.reports.terminal.solve_data import WallTime
from bundle.solving.kept_errors import Edit
from bundle.solving.request import PartRequest, SolveRequest
from bundle.solving.rounds.solve_rounds import run as run_plan

if TYPE_CHECKING:
    from bundle.cli.run import Run
    from bundle.georeference.measurements import MeasurementErrors
    from bundle.graphs.loops.loop_closing import LoopClosing
    from bundle.inertial.offline.inertial_result import InertialAdjustment
    from bundle.model.problem import Problem
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
        try:
            written, lost = _write(opened, solved, measured, progress)
        except InputError as error:  # of a format that cannot hold a model that a shift has bent
            for one in _shifted_input(asked, opened, solved):
                raise InputError(f"{one.sentence} `{one.command}`".removesuffix(" ``")) from error
            raise
        save_time = perf_counter() - begun
        statistics_time = _measure(opened, solved, progress)
        findings = judge(asked, opened, solved, inertial, measured)
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
    publish(with_disk_use(report, asked), arguments)
    if solved.summary.is_solution_usable and not solved.summary.interrupted:
        return EXIT_DONE
    if arguments.json == "-":  # standard output has only the JSON report
        complain(solved.outcome)
    return EXIT_NO_SOLUTION


def plan(run: Run) -> list[str]:
    """Check a refinement and read INPUT for --dry-run; return its predicted cost."""
    from bundle.planning.inspection.problem_inspection import inspect
    from bundle.reports.terminal.inspect import predicted
    from bundle.solving.prepare import prepare

    asked = Refinement.of(run.arguments)
    with on_disk(asked):
        opened = open_input(asked, run.progress)
    run.input = opened.loaded
    if opened.sliced or asked.inertial:
        return ["The cost of this kind of run is not predicted."]
    run.progress.stage("inspecting")
    with asked.naming_flags():
        ready = prepare(_request(asked, opened, None))
        inspection = inspect(ready.start, ready.options)
    return predicted(inspection, ready.options, asked.num_adjustments)


def _close_loops(given: LoopOptions, opened: Opened, progress: Progress) -> LoopClosing | None:
    if given.loops is not None:
        progress.stage(f"closing the loops of {shown(given.loops)}")
    return loops_closed(given, opened.problem)


def _request(asked: Refinement, opened: Opened, closed: LoopClosing | None) -> SolveRequest:
    return SolveRequest(
        problem=opened.problem if closed is None else closed.problem,
        options=opened.options,
        factors=() if closed is None else closed.factors,
        priors=opened.known.priors,
        align=opened.align,
        constraints=asked.constraints,
        part=PartRequest.of(asked.local.only_images, asked.local.rest),
    )


def _solve(
    asked: Refinement, opened: Opened, closed: LoopClosing | None, progress: Progress
) -> Result:
    """Refine the problem with its priors, rules and loops, by the plan of the run."""
    progress.stage("building the problem")
    with asked.naming_flags():
        if opened.sliced is not None:
            return opened.sliced.solve(opened.options, progress.iteration, asked.plan)
        request = _request(asked, opened, closed)
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
            from bundle.georeference.local_frame import with_origin  # few runs have a place

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
    if asked.arguments.json == "-":
        complain(gradient_report.outcome(report))
    settings = {"check_gradients": True, **options.asdict()}
    took = perf_counter() - begun
    publish(checked(asked.source, opened.problem, report, settings, took), asked.arguments)
    return True


# Outcome of `bundle refine`: findings, sigmas of refined readouts, and report page.

MORE_STEPS = 4  # factor on a limit of steps that did not suffice
OUT_OF_VIEW = {"too_many_behind", "invalid_solution"}
"""Warnings of a solve whose steps left the cameras or the range of their parameters."""


def judge(
    asked: Refinement,
    opened: Opened,
    solved: Result,
    inertial: InertialAdjustment | None,
    measured: Sequence[MeasurementErrors] = (),
) -> tuple[Finding, ...]:
    """Return the findings about the result, those of an IMU first.

    An unusable result has only these and the findings about the start; a result in slices has none.
    If all pixels of the input have the same shift, the solve has bent the model, and this is the
    only finding.
    """
    command = NextCommand(asked.source, asked.target, asked.given)
    about_imu = tuple(
        Finding(
            kind=one.kind,
            sentence=one.sentence,
            command=command.refine(*one.flags) if one.flags else "",
            evidence=one.evidence,
            is_problem=one.is_problem,
        )
        for one in (() if inertial is None else inertial.findings)
    )
    if opened.sliced is not None:
        return about_imu
    if shift := _shifted_input(asked, opened, solved):
        return one_list(shift, about_imu, broken_parts(solved.problem))
    priors = opened.known.priors
    if not solved.summary.is_solution_usable:
        if any(one.is_problem for one in about_imu):  # the cause
            return one_list(about_imu)
        given = Measured(
            whole=_start(solved), command=command, options=solved.options, priors=priors
        )
        far = positions_of_start(given) or far_start(solved, command)
        return one_list(about_imu, () if far is None else (far,))
    found = find(
        solved.problem,
        source=asked.source,
        target=asked.target,
        given=asked.given,
        options=solved.options,
        priors=priors if inertial is None else (inertial, *priors),
        survey=solved.survey_checks,
        constraints=asked.constraints,
        start=_start(solved),
        is_minimum=solved.summary.termination_type == "CONVERGENCE",
    )
    loose = "".join(one.command for one in found if one.kind == "undetermined_intrinsics")
    limited = not_converged(solved, command.with_flags_of(loose))  # more steps alone move it on
    is_held = inertial is not None or any(one.target.kind == "image" for one in asked.constraints)
    held = set(solved.problem.image_ids.tolist()) if is_held else {*solved.options.fixed_image_ids}
    held |= {getattr(prior, "image", None) for prior in priors}
    surveyed = _about_control_points(measured, command)
    return one_list(about_imu, limited, broken_parts(solved.problem, held), surveyed, found)


def _start(solved: Result) -> Problem:
    """Return the input, moved to its priors."""
    if solved.similarity is None:
        return solved.initial_problem
    from bundle.georeference.similarity import moved  # few runs have priors

    return moved(solved.initial_problem, solved.similarity)


def _about_control_points(
    measured: Sequence[MeasurementErrors], command: NextCommand
) -> tuple[Finding, ...]:
    place = place_of(measured)
    if place is None or not place.control_points:
        return ()
    from bundle.judging.findings.control_points import control_points  # few runs need it

    found = control_points(place.control_points, command)
    return () if found is None else (found,)


def _shifted_input(asked: Refinement, opened: Opened, solved: Result) -> tuple[Finding, ...]:
    """Return the finding about pixels of the input that all have the same shift, or None.

    A refined principal point absorbs a shift without a bend. The RMSE is at least as large as the
    shift: a small RMSE excludes a shift without further work.
    """
    command = NextCommand(asked.source, asked.target, asked.given)
    is_far = opened.sliced is None and solved.reprojection_error_before.rmse >= SMALLEST_SHIFT
    if not is_far or "principal_point" in opened.options.refine:
        return ()
    found = shifted_pixels(Measured(whole=opened.problem, command=command, options=opened.options))
    return () if found is None else (found,)


def not_converged(solved: Result, command: NextCommand) -> tuple[Finding, ...]:
    """Return the finding about a solve that ended at its limit of steps, if it did."""
    most = solved.options.max_num_iterations
    steps = len(solved.iterations["cost"]) - 1
    if solved.summary.termination_type != "NO_CONVERGENCE" or steps < max(most, 1):
        return ()
    found = Finding(
        kind="not_converged",
        sentence=f"The solve ended at its limit of {plural(most, 'step')} before it converged, so "
        "that the result is not a minimum. Allow more steps.",
        command=command.refine("--max-iterations", str(MORE_STEPS * most)),
        evidence={"max_num_iterations": most},
    )
    return (found,)


def far_start(solved: Result, command: NextCommand) -> Finding | None:
    """Return the finding about a start from which steps went too far, or None.

    The first steps of a far start are long and leave the range where their linear model holds:
    points go behind cameras, where nothing brings them back, or focal lengths become negative. A
    small radius shortens them. Of 59 seeded starts with median errors above 100 px that had no
    usable solution, 42 had one with the first radius (35 of 49 with the cauchy loss, 7 of 10
    without a loss), and 2 more with the second.
    """
    radius, error = solved.options.initial_trust_region_radius, solved.reprojection_error_before
    if OUT_OF_VIEW.isdisjoint(solved.summary.warning_kinds):
        return None
    shorter = [one for one in DAMPED if one < radius]
    advice = "Begin with shorter ones" if shorter else "Correct its poses"
    return Finding(
        kind="far_start",
        sentence=f"The start is too far from a minimum (median error {pixels(error.median)} px): "
        f"the first steps went too far. {advice}.",
        command=command.refine(RADIUS_FLAG, f"{shorter[0]:g}") if shorter else "",
        evidence={"median": error.median, "radius": radius},
        is_problem=True,
    )


def readout_sigmas(
    asked: Refinement, opened: Opened, closed: LoopClosing | None, solved: Result
) -> dict[int, float]:
    """Return the standard deviation of each refined readout, by camera id."""
    shutter = solved.problem.rolling_shutter
    if not solved.options.refine_readout or not solved.summary.is_solution_usable:
        return {}
    if shutter is None or np.isnan(shutter.readout[shutter.is_rolling]).any():
        return {}  # not determined; a warning says so
    from bundle.analysis.uncertainty.covariance_by_input import covariance  # few runs need it

    return covariance(
        solved.problem,
        solved.options,
        of="intrinsics",
        scale="sigma0",
        factors=() if closed is None else closed.factors,
        priors=opened.known.priors,
        constraints=asked.constraints,
    ).readout_sigmas


def write_page(
    asked: Refinement,
    page: str,
    opened: Opened,
    solved: Result,
    measured: Sequence[MeasurementErrors],
    findings: Sequence[Finding],
) -> None:
    """Write the report page; most runs do not need its imports."""
    from bundle.reports.page.report_page import write_report

    write_report(
        solved,
        page,
        images=asked.georeference.images,
        priors=opened.known.priors,
        constraints=asked.constraints,
        georeference=place_of(measured),
        measured=measured,
        findings=findings,
        name=asked.source,
    )
