"""Outcome of `bundle refine`: findings, sigmas of refined readouts, and report page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from bundle.analysis.statistics.suspicions import broken_parts
from bundle.base.words import pixels, plural
from bundle.georeference.measurements import place_of
from bundle.interface.finding import Finding, one_list
from bundle.judging.findings.find import find
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.minimum import SMALLEST_SHIFT, shifted_pixels
from bundle.judging.findings.next_command import NextCommand
from bundle.judging.findings.positions import positions_of_start

if TYPE_CHECKING:
    from bundle.cli.refine_input import Opened
    from bundle.cli.refinement import Refinement
    from bundle.georeference.measurements import MeasurementErrors
    from bundle.graphs.loops.loop_closing import LoopClosing
    from bundle.inertial.offline.inertial_result import InertialAdjustment
    from bundle.solving.result import Result

MORE_STEPS = 4
"""Factor on a limit of steps that did not suffice."""
DAMPED = (1.0, 0.01)
"""Radii of the first step from a start that is too far."""
OUT_OF_VIEW = {"too_many_behind", "invalid_solution"}
"""Warnings of a solve whose steps left the cameras or the range of their parameters."""


def judge(
    asked: Refinement, opened: Opened, solved: Result, inertial: InertialAdjustment | None
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
    shift = () if opened.sliced is not None else _shifted_input(opened, solved, command)
    if shift:
        return one_list(shift, about_imu, broken_parts(solved.problem))
    if opened.sliced is not None:
        return about_imu
    priors = opened.known.priors
    if not solved.summary.is_solution_usable:
        if any(one.is_problem for one in about_imu):  # the cause
            return one_list(about_imu)
        start = Measured(
            whole=solved.initial_problem, command=command, options=solved.options, priors=priors
        )
        far = positions_of_start(start) or far_start(solved, command)
        return one_list(about_imu, () if far is None else (far,))
    limited = not_converged(solved, command)
    found = find(
        solved.problem,
        source=asked.source,
        target=asked.target,
        given=asked.given,
        options=solved.options,
        priors=priors if inertial is None else (inertial, *priors),
        survey=solved.survey_checks,
        constraints=asked.constraints,
        is_minimum=solved.summary.termination_type == "CONVERGENCE",
    )
    is_held = inertial is not None or any(one.target.kind == "image" for one in asked.constraints)
    held = set(solved.problem.image_ids.tolist()) if is_held else {*solved.options.fixed_image_ids}
    held |= {getattr(prior, "image", None) for prior in priors}
    return one_list(about_imu, limited, broken_parts(solved.problem, held), found)


def _shifted_input(opened: Opened, solved: Result, command: NextCommand) -> tuple[Finding, ...]:
    """Return the finding about pixels of the input that all have the same shift, or None.

    A refined principal point absorbs a shift without a bend. The RMSE, which is at least as long as
    the shift, clears most models at no cost.
    """
    problem, options = opened.problem, opened.options
    is_far = solved.reprojection_error_before.rmse >= SMALLEST_SHIFT
    if not is_far or "principal_point" in options.refine:
        return ()
    found = shifted_pixels(Measured(whole=problem, command=command, options=options))
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
    flag = "--initial-trust-region-radius"
    return Finding(
        kind="far_start",
        sentence=f"The start is too far from a minimum (median error {pixels(error.median)} px): "
        f"the first steps went too far. {advice}.",
        command=command.refine(flag, f"{shorter[0]:g}") if shorter else "",
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
