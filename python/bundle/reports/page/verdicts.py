"""Verdicts of a report: one line per question, with a mark and its number.

A mark is "attention" if a finding is about the question, or if the number is beyond the first of
two limits; "problem" beyond the second. docs/report.md lists numbers and limits. Medians of errors
tolerate outliers, which have a line of their own; systematic residuals below 0.3 times the noise do
no harm; a single image is not a problem.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from html import escape

import numpy as np

from bundle.analysis.statistics.description import Description
from bundle.analysis.uncertainty.covariance_result import Certainty
from bundle.base.records import dataclass
from bundle.base.words import few, plural
from bundle.errors import shown
from bundle.figures.marks import short
from bundle.figures.placement_figures import Placement
from bundle.figures.residual_field import ResidualField
from bundle.figures.residual_figures import ImageResiduals
from bundle.figures.structure_figures import CovisibilityGraph, TrackStatistics
from bundle.interface.finding import Finding
from bundle.judging.findings.measured import Measured
from bundle.model.cameras import param_kinds
from bundle.model.problem import Problem
from bundle.model.problem_keys import parameter_names
from bundle.reports.page.page import command_box, tag
from bundle.solving.headline import headline
from bundle.solving.result import Result

MARKS = {"good": "✓", "attention": "!", "problem": "✕", "unknown": "?"}
SEVERE = ("problem", "attention")
FAR = 4.0  # length of the error of a surveyed point in sigmas that needs attention
FLAT = 2.0  # parallax in degrees below which a point is uncertain in depth


@dataclass(frozen=True)
class Verdict:
    """Answer to a question about a model, with the number behind its mark in words."""

    name: str
    mark: str
    number: str
    command: str = ""  # the next command, if no finding has one


@dataclass(frozen=True, eq=False, kw_only=True)
class Judged:
    """The parts of a report from which verdicts follow; None if a part is unknown."""

    problem: Problem
    result: Result | None
    description: Description
    measured: Measured
    fields: Sequence[ResidualField]
    images: Sequence[ImageResiduals]
    certainty: Certainty | None
    no_certainty: str
    place: Placement | None
    tracks: TrackStatistics
    graph: CovisibilityGraph
    findings: Sequence[Finding]


def verdicts(given: Judged) -> list[Verdict]:
    """Return the verdicts that have a number, the most general first."""
    is_hidden = any(one.kind.startswith(HIDING) for one in given.findings)
    found = []
    for answer, kinds in QUESTIONS:
        one = answer(given)
        about = [each for each in given.findings if each.kind in kinds.split()]
        if one is not None and is_hidden and not about and answer in OF_A_MINIMUM:
            found.append(Verdict(one.name, "unknown", one.number))
        elif one is not None:
            step = _next(given, one.command or STEPS.get(answer, "diagnose"))
            found.append(_with_findings(one, about, step * (not is_hidden)))
    return found


def _next(given: Judged, step: str) -> str:
    """Return a command line: of refine with the flags of the run, others on its output."""
    run, (name, *flags) = given.measured.command, shlex.split(step)
    if name == "refine":
        return run.refine(*flags)
    return replace(run, source=run.target if given.result else run.source).other(name, *flags)


def summarised(found: Sequence[Verdict], findings: Sequence[Finding]) -> str:
    """Return the number of verdicts that need attention, in words."""
    problems, attention = (sum(one.mark == mark for one in found) for mark in SEVERE)
    words = [plural(problems, "problem")] if problems else []
    if attention:
        words.append(plural(attention, "check needs attention", "checks need attention"))
    if not words and findings:
        words.append(plural(len(findings), "finding"))
    return ", ".join(words) or "nothing needs attention"


def verdict_list(found: Iterable[Verdict]) -> str:
    """Return the verdicts as a list with marks."""
    rows = [
        tag("div",
            tag("dd", tag("span", MARKS[one.mark], class_=f"mark {one.mark}", role="img",
                          aria_label=one.mark)),
            tag("dt", escape(one.name)), tag("dd", escape(one.number),
            command_box(one.command) if one.command else "", class_="number"))
        for one in found
    ]  # fmt: skip
    return tag("dl", *rows, class_="verdicts")


def _with_findings(one: Verdict, about: Collection[Finding], step: str) -> Verdict:
    """Return a verdict as severe as the findings about its subject, with names and a command."""
    order = ("unknown", "good", "attention", "problem")
    marks = [one.mark, *("problem" if each.is_problem else "attention" for each in about)]
    named = dict.fromkeys(each.kind.replace("_", " ") for each in about)
    known = f"{one.name} {one.number}".lower()
    words = [one.number, *(name for name in named if name not in known)]
    mark = max(marks, key=order.index)
    command = next((each.command for each in about if each.command), step * (mark in SEVERE))
    return Verdict(one.name, mark, "; ".join(words), command)


def _mark(value: float, first: float, second: float = math.inf) -> str:
    if not math.isfinite(value):
        return "unknown"
    return "good" if value <= first else "attention" if value <= second else "problem"


def _two(value: float) -> str:
    return short(float(f"{value:.2g}"))


def _share(value: float) -> str:
    percent = 100 * value
    return f"{percent:,.0f} %" if percent >= 10 else f"{percent:.2g} %"


def _solve(given: Judged) -> Verdict | None:
    if given.result is None:
        return None
    summary = given.result.summary
    if not summary.is_solution_usable:
        return Verdict("Solve", "problem", "no usable solution")
    outcome = headline(given.result)[0].partition(": ")[0].rstrip(".")
    is_done = summary.termination_type == "CONVERGENCE"
    return Verdict("Solve", "good" if is_done else "attention", outcome)


def _error(given: Judged) -> Verdict:
    error = given.description.reprojection_error
    if error is None or not math.isfinite(error.median):
        return Verdict("Reprojection error", "problem", "no observation counts")
    words = f"median {error.median:.3g} px, RMSE {error.rmse:.3g} px"
    if given.result is not None:  # of the same observations
        words += f" (before {given.result.kept.before.rmse:.3g})"
    return Verdict("Reprojection error", _mark(error.median, 1.5, 4.0), words)


def _held_out(given: Judged) -> Verdict | None:
    held = None if given.result is None else given.result.held_out
    if held is None:
        return None
    words = f"median {held.median:.3g} px of {held.num_observations:,} observations, "
    words += f"fitted {held.fitted.median:.3g} px"
    ratio = held.median / held.fitted.median if held.fitted.median > 0 else math.nan
    return Verdict("Held-out error", _mark(ratio, 2.0, 5.0), words)


def _outliers(given: Judged) -> Verdict | None:
    tested, counted = given.measured.standardized, given.measured.counted
    if not counted.any():
        return None
    far = tested.is_outlier & tested.counted
    words = f"{_share(float(far[counted].mean()))} beyond 5 sigmas"
    without = int((~counted).sum())
    words += f", {without:,} without a value" if without else ""
    return Verdict("Outliers", _mark(float((far | ~counted).mean()), 0.05, 0.2), words)


def _worst(given: Judged) -> Verdict | None:
    rmse = [image.error.rmse for image in given.images]
    if len(rmse) < 3:
        return None
    name = given.images[0].error.name or f"image {given.images[0].error.image_id}"
    ratio = rmse[0] / float(np.median(rmse)) if rmse[-1] > 0 else math.nan
    words = f"worst {shown(name)}, {ratio:.2g} x the typical RMSE"
    return Verdict("Images", _mark(ratio, 3.0), words)


def _lens(given: Judged) -> Verdict | None:
    if not given.fields:
        return None
    field = given.fields[0]
    many, cells = field.num_significant
    if cells < 4:
        return Verdict("Lens model", "unknown", "too few observations per part of the image")
    length = np.hypot(field.mean[..., 0], field.mean[..., 1])
    typical = float(np.median(length[np.isfinite(field.significance)]))
    is_large = typical > 0.3 * given.measured.scale
    words = f"{many} of {cells} image cells systematic, by {typical:.2g} px"
    return Verdict("Lens model", _mark(many / cells if is_large else 0.0, 0.2, 0.6), words)


def _focal(given: Judged) -> Verdict:
    problem, known = given.problem, given.certainty
    cameras = np.unique(problem.image_camera)
    words = f"{plural(len(cameras), 'camera', grouped=True)} for "
    words += plural(problem.num_images, "image", grouped=True)
    if known is None:
        return Verdict("Intrinsics", "unknown", words)
    shares, step = [], (0.0, "")
    for camera in cameras.tolist():
        kinds = param_kinds(problem.camera_models[camera])
        focal = [k for k, kind in enumerate(kinds) if kind == "focal"]
        if camera in known.cameras and focal:
            sigma = known.sigmas(camera)[focal]
            shares.append(float(np.max(sigma / problem.camera_params[camera, focal])))
            name = parameter_names("plan", problem, camera)[focal[0]]
            step = max(step, (shares[-1], f"plan --for '{name} {problem.camera_ids[camera]}'"))
    finite = [share for share in shares if math.isfinite(share)]
    if not finite:
        return Verdict("Intrinsics", "good", f"{words}; focal length held")
    share = float(np.median(finite))
    words += f"; focal length to {_share(share)}"
    return Verdict("Intrinsics", _mark(share, 0.01, 0.1), words, step[1])


def _positions(given: Judged) -> Verdict | None:
    if given.certainty is None:
        return Verdict("Positions", "unknown", "no covariance") if given.no_certainty else None
    sigmas = given.certainty.position_sigmas
    sigmas = sigmas[np.isfinite(sigmas) & (sigmas > 0)]
    extent = float(np.ptp(given.problem.projection_centers, axis=0).max(initial=0.0))
    if len(sigmas) == 0 or not extent > 0:
        return None
    middle, largest = float(np.median(sigmas)), float(sigmas.max())
    unit = " m" if given.place is not None else ""
    words = f"sigma {_two(middle)}{unit}, {_share(middle / extent)} of the extent; "
    words += f"largest {_two(largest)}{unit}"
    return Verdict("Positions", _mark(middle / extent, 0.03, 0.1), words)


def _tracks(given: Judged) -> Verdict | None:
    tracks = given.tracks
    total = int(tracks.angles.sum())
    if total == 0:
        return None
    below = max(k for k, angle in enumerate(tracks.angle_limits) if angle <= FLAT)
    flat = float(tracks.angles[: below + 1].sum()) / total
    double = float(tracks.lengths[2:3].sum()) / int(tracks.lengths.sum())
    words = f"{given.description.track_length.mean:.3g} images per point; "
    words += f"{_share(double)} in two, {_share(flat)} below {FLAT:g}°"
    return Verdict("Tracks", _mark(flat, 0.25, 0.6), words)


def _connection(given: Judged) -> Verdict:
    sizes = given.description.covisibility.component_sizes
    images = given.problem.num_images
    weights = np.zeros(images, np.int64)
    for side in given.graph.edges.T:
        np.maximum.at(weights, side, given.graph.weights)
    alone = images - sum(sizes)
    if len(sizes) != 1 or alone:
        words = f"{plural(len(sizes), 'piece')} of {', '.join(f'{k:,}' for k in sizes[:4])}"
        words += ", ..." if len(sizes) > 4 else " images" if sizes else ""
        words += f", {plural(alone, 'image')} without points" if alone else ""
        return Verdict("Connection", "problem", words)
    if images < 2:
        return Verdict("Connection", "unknown", "one image")
    least = int(weights.min())
    words = f"one piece; an image shares {least:,} points or more"
    return Verdict("Connection", _mark(-least, -10), words)


def _place(given: Judged) -> Verdict | None:
    place = given.place
    if place is None:
        return None
    kind = "check" if any(one.role == "check" for one in place.targets) else "control"
    points = [one for one in place.targets if one.role == kind]
    far: list[str] = []
    if place.targets:
        rms = float(place.rms(kind)[4])
        sigma = np.array([one.sigma for one in points]).reshape(-1, 3)
        ratio = rms / float(np.sqrt(np.nanmean(sigma**2) * 3)) if points else math.nan
        words = f"{plural(len(points), f'{kind} point')}, RMS {rms:.3g} m"
        words += "; no check point" if kind == "control" else ""
        residual = np.array([one.residual for one in points]).reshape(-1, 3)
        lengths = np.sqrt(np.nansum((residual / sigma) ** 2, axis=1))
        far = [one.name for one, length in zip(points, lengths, strict=True) if length > FAR]
        words += f"; {few(far)} beyond {FAR:g} sigmas" if far else ""
    else:
        used = [image.sigmas for image in place.images if image.used]
        known = np.array(used)[np.isfinite(used)]
        ratio = float(np.sqrt(np.mean(known**2) / 3)) if len(known) else math.nan
        words = f"{plural(len(used), 'position')}, RMS {place.rms('gps')[4]:.3g} m"
    suspects = sum(one.suspect for one in place.targets)
    unused = sum(not image.used for image in place.images if np.isfinite(image.residual).all())
    words += f", {plural(suspects, 'suspect point')}" if suspects else ""
    words += f", {unused} without influence" if unused else ""
    mark = _mark(ratio, 3.0, 10.0)
    is_worse = (suspects or far) and mark == "good"
    flag = "--gcp FILE" if place.targets else "--gps FILE"
    step = "" if given.result else f"refine {flag} --prior-loss cauchy"  # a run repeats its own
    return Verdict("Georeference", "attention" if is_worse else mark, words, step)


STEPS: dict[Callable[[Judged], Verdict | None], str] = {
    _solve: "refine --max-iterations 200", _place: "refine --prior-loss cauchy",
    _error: "validate", _held_out: "validate", _lens: "validate",
    _outliers: "refine --loss cauchy", _worst: "info --verbose",
}  # fmt: skip
"""The next command of a question, by its function; of the others it is `bundle diagnose`."""

QUESTIONS: tuple[tuple[Callable[[Judged], Verdict | None], str], ...] = (
    (_solve, "not_converged rules constant_poses constant_points constant_sensors"),
    (_place, "positions attitudes gps_offset control_points"),
    (_error, "not_refined far_start shifted_pixels no_observations unsupported_camera_models "
             "observations_outside_image"),
    (_held_out, ""),
    (_outliers, "outliers gross_errors observations_behind_camera"),
    (_worst, "motion image_residuals"),
    (_lens, "lens_model folding_distortion absurd_distortion"),
    (_focal, "undetermined_intrinsics constant_lens local_lens shared_lens focal_drift "
             "absurd_focal_lengths"),
    (_positions, "scale_drift no_covariance images_with_few_observations undetermined_poses"),
    (_tracks, "duplicate_points collapsed_points far_points points_not_seen points_seen_once"),
    (_connection, "weak_joint disconnected images_without_observations"),
)  # fmt: skip
"""Functions that answer a question, and the kinds of findings about its subject."""

OF_A_MINIMUM = (_outliers, _worst, _lens, _focal, _positions)
HIDING = ("not_refined", "rules", "constant_")
"""Questions without an answer beside kinds of findings: errors of a start hide the answer, and so
does what is held at a wrong value."""
