"""`bundle refine` of a reconstruction: INPUT, options, solve, report, OUTPUT."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from bundle.analysis.statistics.suspicions import broken_parts
from bundle.base.own_process import Waiting, waiting_since
from bundle.base.words import pixels, plural
from bundle.cli.error_lines import EXIT_DONE, EXIT_NO_SOLUTION, complain
from bundle.cli.georeferencing import carry_georeference, write_georeference
from bundle.cli.inertial_flags import InertialFiles, adjusted_with_imu
from bundle.cli.problem_edits import loops_closed
from bundle.cli.refine_input import on_disk, open_input, with_disk_use
from bundle.cli.refinement import Refinement
from bundle.errors import InputError, shown
from bundle.georeference.measurements import place_of
from bundle.interface.finding import Finding, one_list
from bundle.io.open import save
from bundle.judging.findings.focal_lengths import local_lens
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.minimum import SMALLEST_SHIFT, shifted_pixels
from bundle.judging.findings.next_command import NextCommand
from bundle.judging.findings.positions import DAMPED, RADIUS_FLAG, positions_of_start
from bundle.reports.sections import Report
from bundle.reports.terminal.refine import refinement
from bundle.solving.kept_errors import Edit
from bundle.solving.request import PartRequest, SolveRequest
from bundle.solving.rounds.solve_rounds import run as run_plan

if TYPE_CHECKING:
    from bundle.inertial.offline.inertial_result import InertialAdjustment
    from bundle.model.problem import Problem
    from bundle.solving.result import Result

STAYED = "Refined again without positions, starting from the georeferenced model."
UNTIED = "the tie of INPUT to its control points or positions; give its --gcp or --gps again"


def refine(run: Refinement) -> Report:
    """Refine INPUT into OUTPUT."""
    run.check()
    with on_disk(run):
        open_input(run)
        if run.arguments.check_gradients and (wrong := _wrong_jacobians(run)):
            return wrong
        _close_loops(run)
        before = Waiting.now()
        _solve(run)
        waiting = waiting_since(before)
        run.measured = run.known.errors(run.found)
        try:
            with run.timing("save"):
                written, lost = _write(run)
        except InputError as error:  # of a format that cannot hold a model that a shift has bent
            for one in _shifted_input(run):
                raise InputError(f"{one.sentence} `{one.command}`".removesuffix(" ``")) from error
            raise
        _measure(run)
        run.findings = judge(run)
        run.page(
            "reports.page.report_page:write_report",
            run.found,
            images=run.georeference.images,
            priors=run.priors,
            constraints=run.constraints,
            georeference=place_of(run.measured),
            measured=run.measured,
            findings=run.findings,
            name=run.source,
            command=run.command,
        )
    report = refinement(
        run.source,
        run.input,
        run.found,
        run.wall_time(run.found),
        written,
        lost,
        run.options_beside(),
        run.edits,
        run.closed,
        run.findings,
        waiting,
        run.measured,
        run.inertial,
        readout_sigmas(run),
    )
    is_done = run.found.summary.is_solution_usable and not run.found.summary.interrupted
    run.end(EXIT_DONE if is_done else EXIT_NO_SOLUTION, run.found.outcome)
    return with_disk_use(report, run)


def plan(run: Refinement) -> list[str]:
    """Check a refinement and read INPUT for --dry-run; return its predicted cost."""
    from bundle.planning.inspection.problem_inspection import inspect
    from bundle.reports.terminal.inspect import predicted
    from bundle.solving.prepare import prepare

    run.check()
    with on_disk(run):
        open_input(run)
    if run.sliced or run.imu:
        return ["The cost of this kind of run is not predicted."]
    run.closed = None
    run.progress.stage("inspecting")
    with run.naming():
        ready = prepare(_request(run))
        inspection = inspect(ready.start, ready.options)
    return predicted(inspection, ready.options, run.num_adjustments)


def _wrong_jacobians(run: Refinement) -> Report | None:
    """Check the Jacobians; if any is wrong, return the report on them, which replaces the solve."""
    from bundle.checking import gradient_report, jacobians  # only for --check-gradients
    from bundle.reports.terminal.analyses import checked

    run.progress.stage("checking the Jacobians")
    begun, options = perf_counter(), run.options
    found = jacobians.check_problem(
        run.problem, cheirality=options.cheirality, num_threads=options.num_threads
    )
    if found.verdict != "wrong":
        if not found.ok:
            complain(f"note: {gradient_report.outcome(found)} `bundle check` shows where.")
        return None
    run.end(EXIT_NO_SOLUTION, gradient_report.outcome(found))
    settings = {"check_gradients": True, **options.asdict()}
    return checked(run.source, run.problem, found, settings, perf_counter() - begun)


def _close_loops(run: Refinement) -> None:
    if run.loops.loops is not None:
        run.progress.stage(f"closing the loops of {shown(run.loops.loops)}")
    run.closed = loops_closed(run.loops, run.problem)


def _request(run: Refinement) -> SolveRequest:
    closed = run.closed
    return SolveRequest(
        problem=run.problem if closed is None else closed.problem,
        options=run.options,
        factors=() if closed is None else closed.factors,
        priors=run.priors,
        align=run.align,
        constraints=run.constraints,
        part=PartRequest.of(run.local.only_images, run.local.rest),
    )


def _solve(run: Refinement) -> None:
    """Refine the problem with its priors, rules and loops, by the plan of the run."""
    run.inertial = None
    with run.naming():
        if run.imu is not None:
            run.inertial = _adjusted_with_imu(run, run.imu)
            found = run.inertial.result
        else:
            run.progress.stage("building the problem")
            found = _adjusted(run)
    run.found = _with_edits(run, found)


def _adjusted(run: Refinement) -> Result:
    progress = run.progress
    if run.sliced is not None:
        return run.sliced.solve(run.options, progress.iteration, run.rounds_plan)
    request = _request(run)
    if run.rounds_plan.database is None:
        return run_plan(request, run.rounds_plan, progress.iteration)
    from bundle.solving import refine_tracks  # for --database only

    is_share_given = run.arguments.hold_out is not None
    return refine_tracks.run(
        request, run.rounds_plan, progress.iteration,
        is_share_given=is_share_given, tell=progress.stage,
    )  # fmt: skip


def _adjusted_with_imu(run: Refinement, files: InertialFiles) -> InertialAdjustment:
    """Refine the problem with the samples of an IMU."""
    if run.place is not None:
        raise InputError("--imu: expected a model without georeference.json, which it would move")
    run.progress.stage("adjusting with the IMU")
    return adjusted_with_imu(
        files, run.problem, run.options, run.priors, run.rounds_plan, run.progress.iteration
    )


def _with_edits(run: Refinement, solved: Result) -> Result:
    """Return the result with the edits of cameras, rigs and loops before those of the solve."""
    problem = run.input
    edits = []
    for edit, edited in (
        *(() if run.edits is None else run.edits.stages),
        # "": only a shutter
        ("" if run.arguments.rig_config is None else "rig_config", run.problem),
        ("loops", run.problem if run.closed is None else run.closed.problem),
    ):
        if edited is not problem:
            edits += [Edit(edit, problem, edited)] if edit else []
            problem = edited
    return dataclasses.replace(solved, edits=(*edits, *solved.edits)) if edits else solved


def _write(run: Refinement) -> tuple[dict[str, str] | None, tuple[str, ...]]:
    """Write a usable result; return its path and format, and the data that the format loses."""
    solved, place = run.found, place_of(run.measured)
    if not (solved.summary.is_solution_usable or solved.summary.interrupted):
        return None, ()
    run.progress.stage(f"writing {shown(run.target)}")
    if run.sliced is None:
        refined = solved.problem
        if place is not None:
            from bundle.georeference.local_frame import with_origin  # few runs have a place

            refined = with_origin(refined, place.origin)
        lost = save(refined, **run.output, progress=run.progress.text)
    else:
        lost = run.sliced.save(Path(run.target))
    if place is not None:
        write_georeference(place, **run.output)
    else:
        carry_georeference(run.place, **run.output, changed=STAYED)
        lost += (UNTIED,) * bool(run.place and (run.place.get("gcps") or run.place.get("gps")))
    return run.output, lost


def _measure(run: Refinement) -> None:
    """Compute reprojection errors before and after."""
    run.progress.stage("measuring reprojection errors")
    with run.timing("statistics"):
        if run.sliced is not None:
            run.sliced.measure(run.found)
        run.found.measure()


# Outcome of `bundle refine`: findings, and sigmas of refined readouts.

MORE_STEPS = 4  # factor on a limit of steps that did not suffice
OUT_OF_VIEW = {"too_many_behind", "invalid_solution"}
"""Warnings of a solve whose steps left the cameras or the range of their parameters."""


def judge(run: Refinement) -> tuple[Finding, ...]:
    """Return the findings about the result, those of an IMU first.

    An unusable result has only these and the findings about the start; a result in slices has none.
    If all pixels of the input have the same shift, the solve has bent the model, and this is the
    only finding.
    """
    command, solved, inertial = run.command, run.found, run.inertial
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
    if run.sliced is not None:
        return about_imu
    if shift := _shifted_input(run):
        return one_list(shift, about_imu, broken_parts(solved.problem))
    if not solved.summary.is_solution_usable:
        if any(one.is_problem for one in about_imu):  # the cause
            return one_list(about_imu)
        given = Measured(
            whole=_start(solved), command=command, options=solved.options, priors=run.priors
        )
        far = positions_of_start(given) or far_start(solved, command)
        return one_list(about_imu, () if far is None else (far,))
    run.judge(
        solved.problem,
        target=run.target,
        options=solved.options,
        priors=run.priors if inertial is None else (inertial, *run.priors),
        survey=solved.survey_checks,
        start=_start(solved),
        is_minimum=solved.summary.termination_type == "CONVERGENCE",
    )
    loose = "".join(one.command for one in run.findings if one.kind == "undetermined_intrinsics")
    limited = not_converged(solved, command.with_flags_of(loose))  # more steps alone move it on
    is_held = inertial is not None or any(one.target.kind == "image" for one in run.constraints)
    held = set(solved.problem.image_ids.tolist()) if is_held else {*solved.options.fixed_image_ids}
    held |= {getattr(prior, "image", None) for prior in run.priors}
    surveyed = _about_control_points(run)
    # More steps do not help where something is held at a wrong value.
    held_wrong = [one for one in run.findings if one.kind.startswith("constant_")]
    broken = [*broken_parts(solved.problem, held), *local_lens(solved, command)]
    return one_list(about_imu, held_wrong, limited, broken, surveyed, run.findings)


def _start(solved: Result) -> Problem:
    """Return the input, moved to its priors."""
    if solved.similarity is None:
        return solved.initial_problem
    from bundle.georeference.similarity import moved  # few runs have priors

    return moved(solved.initial_problem, solved.similarity)


def _about_control_points(run: Refinement) -> tuple[Finding, ...]:
    place = place_of(run.measured)
    if place is None or not place.control_points:
        return ()
    from bundle.judging.findings.control_points import control_points  # few runs need it

    found = control_points(place.control_points, run.command)
    return () if found is None else (found,)


def _shifted_input(run: Refinement) -> tuple[Finding, ...]:
    """Return the finding about pixels of the input that all have the same shift, or None.

    A refined principal point absorbs a shift without a bend. The RMSE is at least as large as the
    shift: a small RMSE excludes a shift without further work.
    """
    is_far = run.sliced is None and run.found.reprojection_error_before.rmse >= SMALLEST_SHIFT
    if not is_far or "principal_point" in run.options.refine:
        return ()
    found = shifted_pixels(Measured(whole=run.problem, command=run.command, options=run.options))
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


def readout_sigmas(run: Refinement) -> dict[int, float]:
    """Return the standard deviation of each refined readout, by camera id."""
    solved: Result = run.found
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
        factors=() if run.closed is None else run.closed.factors,
        priors=run.priors,
        constraints=run.constraints,
    ).readout_sigmas
