r"""Measured positions against the model: sigmas, single wrong positions, drift of the scale.

East and north are one group of axes, up is the other: receivers measure heights several times less
accurately. Let d_i be the length of image i's residual in a group, in sigmas; if the sigmas are
right, d_i^2 is chi^2 with as many degrees of freedom as measured axes (median 1.386 for two, 0.455
for one).

Wrong sigmas. The ratio of a group is the root of median d^2 over its expected median. It exceeds 2,
and 1 by 3 of its standard errors, over at least 6 images. The command sets the sigmas of each group
from the residuals. If the file has sigmas, the command gives factors on them.

Single wrong positions. In at most a third of the images, the residual over all axes exceeds 5
sigmas, after division by the ratio of each group (at least 1). If outliers or a small lens bend the
model, the test uses the model without them. If it is bent by motion that no command removes, no
sigmas are suggested, because larger sigmas would allow more bending.

Drift. Priors pull the model, so that a drift shows little in the residuals. If these show any
tension (a ratio above 1.5, or a residual above 5 sigmas), the model is solved without positions,
and with a larger lens if its own is too small. With its centres c and the positions p, the scale of
a part of the images is s = sum |p - mean p| / sum |c - mean c|. That of the first half of the
images in their order and that of the second differ by more than 9 % and by 5 standard errors; the
error of each is sigma / (spread sqrt n). Smaller sigmas are suggested while more than 3 % of drift
is left in the model with its positions, if a solve with them from the start of the run has a usable
result. The start is far from a bent model, so that the first steps must be short. If no solve has a
usable result, the images contradict the drift.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import median
from bundle.base.words import number, plural
from bundle.errors import InputError, shown
from bundle.interface.finding import Finding
from bundle.interface.georeference_options import GPS_SIGMA
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.repaired import MOST_STEPS, is_affordable, solved
from bundle.model.problem import Problem
from bundle.model.rigid_motions import (
    cross_matrices,
    quaternion_inverse,
    quaternion_rotate,
    rotation_matrices,
)

GROUPS = ((slice(0, 2), 1.3863, 0.72), (slice(2, 3), 0.4549, 1.17))
"""Axes of a group, the median of their chi^2, and the relative standard error of the median length
of n residuals, times the root of n."""
RATIO, ERRORS = 2.0, 3.0
TENSION = 1.5
UNKNOWN_SIGMA = 1e50  # sigma of an axis without a measurement
SMALLEST_CHANGE = 0.05  # relative change of a sigma from which a command is given
OUTLIER = 5.0
FEWEST = 6
DRIFT, DRIFT_ERRORS = 0.09, 5.0
LEFT = DRIFT / 3
"""Least remaining drift of the model solved with positions to suggest smaller sigmas."""
RADIUS_FLAG = "--initial-trust-region-radius"
DAMPED = (1.0, 0.01)  # radii of the first step where longer steps go too far

_NO_SOLVE = (
    "A solve without positions does not converge, so the cause is unknown: wrong positions, or a "
    "drift of the scale."
)
_MOTION = (
    "Motion during the exposure bends the model, so the sigmas may be correct; larger sigmas "
    "would allow more bending."
)

Floats = NDArray[np.float64]


def measured_positions(
    measured: Measured, *, is_open: bool = False, is_moving: bool = False
) -> Finding | None:
    """Return the finding about positions that contradict the model, or None.

    If the solve without them failed (``is_open``), a drift would look like wrong positions; if
    motion bends the model, right positions would look like wrong sigmas.
    """
    rows, priors = _used(measured)
    if len(rows) < FEWEST:
        return None
    distance, own, ratio, limit = _distances(measured, rows, priors)
    wrong = np.flatnonzero(own > OUTLIER)
    problem = measured.whole
    evidence: dict[str, Any] = {
        "num_positions": len(rows),
        "ratio": ratio,
        "image_ids": [int(problem.image_ids[rows[k]]) for k in wrong.tolist()],
        "sigmas": distance[wrong].tolist(),
    }
    why, command = f". {_NO_SOLVE if is_open else _MOTION}", ""
    is_robust = all(prior.loss != "trivial" for prior in priors)
    if len(wrong) and 3 * len(wrong) <= len(rows) and not (is_robust or is_open):
        worst = int(wrong[np.argmax(own[wrong])])
        name = shown(problem.image_names[rows[worst]]) or f"image {problem.image_ids[rows[worst]]}"
        return Finding(
            kind="positions",
            sentence=f"{plural(len(wrong), 'measured position')} of {len(rows)} "
            f"{'contradicts' if len(wrong) == 1 else 'contradict'} the model: {name} is "
            f"{number(float(distance[worst]))} sigmas away, the median image "
            f"{number(median(distance))}.",
            command=measured.command.refine("--prior-loss", "cauchy"),
            evidence=evidence,
        )
    if not (ratio > limit or (is_open and len(wrong))):
        return None
    if not (is_open or is_moving):
        factors = sigma_factors(measured, rows, priors, ratio) if is_affordable(measured) else None
        factors = factors or [ratio, ratio]
        wanted = [1.0 if one is None else one for one in factors]
        given = _sigmas(priors)
        better = [one * factor for one, factor in zip(given, wanted, strict=True)]
        why = "; the positions are too few, or too strong, to estimate their sigmas."
        if any(abs(np.log(factor)) > SMALLEST_CHANGE for factor in wanted):
            why = (
                f": the sigmas are rather {_pair(better)} m (horizontal / vertical) than "
                f"{_pair(given)}, or the model is bent."
            )
            command = _sigma_command(measured, given, wanted)
        evidence |= {"sigmas_found": better, "factors": factors}
    return Finding(
        kind="positions",
        sentence=f"Measured positions and model differ by {number(ratio)} times the sigmas{why}",
        command=command,
        evidence=evidence,
    )


def positions_of_start(measured: Measured) -> Finding | None:
    """Return the finding about positions that a start contradicts, or None.

    Their sigmas are so small that they pull the cameras away before the images can follow. The
    command sets the sigmas from the residuals at the start, so that the images decide. A scale
    below 1 was suggested against a drift and stays.
    """
    rows, priors = _used(measured)
    if len(rows) < FEWEST:
        return None
    _, _, ratio, limit = _distances(measured, rows, priors)
    scale = measured.command.value("--gps-sigma-scale", "1").split("/")
    if not ratio > limit or min(map(float, scale)) < 1.0:
        return None
    given = _sigmas(priors)
    return Finding(
        kind="positions",
        sentence="The solve found no usable model. The input, moved to its measured positions, "
        f"differs from them by {number(ratio)} times their sigmas ({_pair(given)} m), which pull "
        "the cameras away before the images can follow. Begin with larger ones.",
        command=_sigma_command(measured, given, [ratio, ratio]),
        evidence={"num_positions": len(rows), "ratio": ratio},
    )


def position_offset(measured: Measured) -> Finding | None:
    """Return the finding about an offset of positions from control points, or None.

    ``solving/survey_checks.py`` has the test. Focal lengths absorb an offset that is not modelled.
    """
    offset = None if measured.survey is None else measured.survey.offset
    if offset is None or offset.is_estimated or not offset.is_significant:
        return None
    without, focal, sigma = offset.focal_lengths
    cause = ": heights of two systems (ellipsoid, sea level)?" if offset.axes == "up" else "."
    more = ""
    if offset.bends_focal_length:
        more = (
            f" The focal length absorbs it: {without:.4g} px instead of {focal:.4g} +- {sigma:.2g}."
            " Only relief separates the two: add oblique images, or a prior on f."
        )
    return Finding(
        kind="gps_offset",
        sentence=f"{offset.sentence}{cause}{more}",
        command=measured.command.refine("--gps-offset", offset.axes),
        evidence={
            **offset.asdict(),
            "focal_length": without,
            "focal_length_with_offset": focal,
            "focal_length_sigma": sigma,
        },
    )


def _sigma_command(measured: Measured, given: list[float], factors: list[float]) -> str:
    command = measured.command
    asked = command.value("--gps-sigma", GPS_SIGMA).split("/")
    of_flag = [float(asked[0]), float(asked[-1])]
    scale = command.value("--gps-sigma-scale", "")
    if not scale and all(
        sigma >= UNKNOWN_SIGMA or abs(sigma - other) <= 1e-9 * other
        for prior in _used(measured)[1]
        for sigma, other in zip(np.sqrt(np.diag(prior.full_covariance))[::2], of_flag, strict=True)
    ):
        return command.refine(
            "--gps-sigma", _pair([g * f for g, f in zip(given, factors, strict=True)])
        )
    before = [float(word) for word in (scale or "1").split("/")]
    product = [factors[0] * before[0], factors[1] * before[-1]]
    return command.refine("--gps-sigma-scale", _pair(product))


def _pair(values: list[float]) -> str:
    """Return a horizontal and a vertical number with two digits; a single one if they are equal."""
    words = [f"{value:.2g}" for value in values if value < UNKNOWN_SIGMA]
    return "/".join(dict.fromkeys(words))


def is_tense(measured: Measured) -> bool:
    """Return True if residuals of positions are larger than their sigmas explain."""
    rows, priors = _used(measured)
    if len(rows) < FEWEST:
        return False
    distance, _, ratio, _ = _distances(measured, rows, priors)
    return bool(ratio > TENSION or (distance > OUTLIER).any())


def scale_drift(measured: Measured, free: Problem) -> Finding | None:
    """Return the finding about a scale that changes along a model without measured positions."""
    rows, priors = _used(measured)
    if len(rows) < 2 * FEWEST:
        return None
    own = _distances(measured, rows, priors)[1]
    right = np.flatnonzero(own <= OUTLIER).tolist()
    rows, priors = [rows[k] for k in right], [priors[k] for k in right]
    if len(rows) < 2 * FEWEST:
        return None
    free_drift, error = _drift(free, measured, rows, priors)
    if not (abs(free_drift) > DRIFT and abs(free_drift) > DRIFT_ERRORS * error):
        return None
    left, _ = _drift(measured.whole, measured, rows, priors)
    command, advice = "", "The positions correct it."
    if abs(left) > LEFT:
        is_robust = any(prior.loss != "trivial" for prior in priors)  # drifted ones have no weight
        factors = 2 * [1.0 if is_robust else _shrinking(free_drift, left)]
        radii = [min(one, measured.options.initial_trust_region_radius) for one in DAMPED]
        can_try = is_affordable(measured)
        usable = (one for one in radii if not can_try or _has_model(measured, factors, one))
        radius = next(usable, None)
        if radius is None:
            advice = (
                "The images contradict it: with sigmas that make them follow the positions, no "
                "model is usable. Check the positions, or close loops."
            )
        elif is_robust:
            advice = "The robust loss lets the model ignore it: use none, or close loops."
            command = measured.command.refine(RADIUS_FLAG, f"{radius:g}", "--prior-loss", "trivial")
        else:
            advice = "Give the positions smaller sigmas and begin with short steps, or close loops."
            shorter = measured.command.after(RADIUS_FLAG, f"{radius:g}")
            command = _sigma_command(measured.of_command(shorter), _sigmas(priors), factors)
    change, rest = (float(np.expm1(one)) for one in (free_drift, left))
    return Finding(
        kind="scale_drift",
        sentence="The scale drifts: from the first to the second half of the images, the scale of "
        f"the measured positions relative to the model changes by {100 * change:+.1f}"
        f" % (standard error {100 * error:.1f} %). {advice}",
        command=command,
        evidence={"change": change, "standard_error": error, "left": rest},
    )


def _has_model(measured: Measured, factors: list[float], radius: float) -> bool:
    positions = _used(measured)[1]
    plain = [dataclasses.replace(one, loss="trivial") for one in positions]
    scaled = [_scaled(one, np.array(factors)) for one in plain]
    options = measured.options.replace(num_threads=1, initial_trust_region_radius=radius)
    options = options.replace(max_num_iterations=min(options.max_num_iterations, MOST_STEPS))
    start = measured.start or measured.whole
    try:
        solved(measured, start, options, [*scaled, *_others(measured, positions)])
    except InputError:
        return False
    return True


def _shrinking(free: float, left: float) -> float:
    """Return the factor on sigmas that leaves half of LEFT of a drift.

    Positions leave the share 1 / (1 + k / sigma^2), with k from the present share.
    """
    now, wanted = (max(abs(free / drift) - 1.0, 1e-3) for drift in (left, LEFT / 2))
    return float(np.clip(np.sqrt(now / wanted), 1 / 30, 1 / 3))


def _drift(
    problem: Problem, measured: Measured, rows: list[int], priors: list[Any]
) -> tuple[float, float]:
    """Return the logarithm of the change of the scale between the halves, and its error.

    Zero, with an infinite error, if a half has no extent.
    """
    order = np.argsort(measured.whole.image_ids[rows], kind="stable")
    antennas = _antennas(problem, rows, priors)[order]
    positions = np.array([np.asarray(prior.position) for prior in priors])[order]
    flat = np.isnan(positions[:, 2]).any()
    given, found = (values[:, : 2 if flat else 3] for values in (positions, antennas))
    sigma = _sigmas(priors)[0]
    half = len(rows) // 2
    scales, errors = [], []
    for part in (slice(None, half), slice(half, None)):
        spread = [
            float(np.linalg.norm(values[part] - values[part].mean(axis=0), axis=1).sum())
            for values in (given, found)
        ]
        if not spread[1] > 0 or not spread[0] > 0:
            return 0.0, np.inf
        scales.append(spread[0] / spread[1])
        errors.append(sigma * np.sqrt(len(given[part])) / spread[0])
    return float(np.log(scales[1] / scales[0])), float(np.hypot(*errors))


def _distances(
    measured: Measured, rows: list[int], priors: list[Any]
) -> tuple[Floats, Floats, float, float]:
    """Return the residuals of positions in sigmas.

    Returns:
        Their lengths; their lengths in the sigmas that most residuals of a group show, if these are
        larger; and the larger ratio of the groups with its limit.
    """
    whitened = np.array(
        [prior.whiten(antenna - np.asarray(prior.position))
         for antenna, prior in zip(_antennas(measured.whole, rows, priors), priors, strict=True)]
    )  # fmt: skip
    own, worst = whitened.copy(), (0.0, RATIO)
    for axes, middle, error in GROUPS:
        lengths = np.linalg.norm(whitened[:, axes], axis=1)
        lengths = lengths[lengths > 0]
        if len(lengths) < FEWEST:
            continue
        ratio = float(median(lengths) / np.sqrt(middle))
        limit = max(RATIO, 1.0 + ERRORS * error / np.sqrt(len(lengths)))
        own[:, axes] /= max(ratio, 1.0)
        worst = max(worst, (ratio, limit), key=lambda pair: pair[0] / pair[1])
    return np.linalg.norm(whitened, axis=1), np.linalg.norm(own, axis=1), *worst


def _used(measured: Measured) -> tuple[list[int], list[Any]]:
    problem = measured.whole
    by_id = {int(one): row for row, one in enumerate(problem.image_ids.tolist())}
    by_name = {name: row for row, name in enumerate(problem.image_names) if name}
    seen = np.bincount(problem.observation_image, minlength=problem.num_images) > 0
    rows, priors = [], []
    for prior in measured.priors:
        if not hasattr(prior, "position"):  # attitudes
            continue
        image = getattr(prior, "image", None)
        row = by_name.get(image) if isinstance(image, str) else by_id.get(image)  # type: ignore[arg-type]
        if row is not None and seen[row]:
            rows.append(row)
            priors.append(prior)
    return rows, priors


def _antennas(problem: Problem, rows: list[int], priors: list[Any]) -> Floats:
    """Return the positions R^T (a - t) (n, 3) of antennas at the lever arms a."""
    poses = problem.cam_from_world[rows]
    levers = np.array([np.asarray(prior.lever_arm, float) for prior in priors])
    return quaternion_rotate(quaternion_inverse(poses[:, :4]), levers - poses[:, 4:])


def _sigmas(priors: list[Any]) -> list[float]:
    """Return the median horizontal (east) and vertical sigma."""
    sigmas = np.array([np.sqrt(np.diag(prior.full_covariance)) for prior in priors])
    return [median(sigmas[:, axis]) for axis in (0, 2)]


# Standard deviations of measured positions, as a model that was solved with them shows them.
#
# Maximum likelihood (variance components; Foerstner and Wrobel 2016, section 4.2.4): with the
# whitened residuals v of an axis and their redundancies
#
#     red_i = 1 - u_i^T C u_i / sigma_i^2,
#
# C the covariance of the antenna in the solution with all priors and u_i the axis, the variances of
# a group are multiplied by f = sum v^2 / sum red, and the model is solved again, until f is 1. The
# RMS of the residuals is too small as an estimate, because the model follows its positions;
# iterated, it converges to 0. The rounds begin with sigmas that are certainly too large: the first
# solve is then free, and its residuals show the errors. With sigmas that are far too small, all
# redundancies are near 0.
#
# A standard deviation has the relative error 1 / sqrt(2 sum red). Below a sum of 10, which is 22 %,
# it is not estimated.

FEWEST_REDUNDANT = 10.0
MOST_ROUNDS = 8
TOO_LARGE = 10.0  # factor of the first round, on sigmas as the residuals show them
SETTLED = 0.05  # change of a standard deviation below which the rounds end


def sigma_factors(
    measured: Measured, rows: list[int], priors: list[Any], ratio: float
) -> list[float | None] | None:
    """Return the factors on the horizontal and the vertical sigmas; None: not estimated.

    The model is at the minimum with its priors. The sigmas are too small by about the ratio. None
    for both if a solve fails.
    """
    from bundle.analysis.uncertainty.covariance_by_input import covariance

    others = _others(measured, priors)
    problem, factors = measured.whole, np.full(2, TOO_LARGE * max(ratio, 1.0))
    known = np.zeros(2, bool)
    options = measured.options.replace(gauge="none", check_solution=False, num_threads=1)
    for _ in range(MOST_ROUNDS):
        scaled = [_scaled(prior, factors) for prior in priors]
        given = [*scaled, *others]
        request = {"priors": given, "constraints": measured.constraints}
        try:
            problem = solved(measured, problem, options, given).problem
            found = covariance(problem, options, of="poses", gauge="none", **request)
        except InputError:
            return None
        place = {image: k for k, image in enumerate(found.pose_ids.tolist())}
        poses = found.pose_covariance[[place[int(problem.image_ids[row])] for row in rows]]
        sums = _sums(problem, rows, scaled, poses)
        known = sums[:, 1] >= FEWEST_REDUNDANT
        change = np.sqrt(sums[:, 0] / np.maximum(sums[:, 1], 1.0))
        change[~(change > 0)] = 1.0  # nothing is measured, or the fit is exact
        factors = factors * change
        if (np.abs(np.log(change)) < SETTLED).all():
            break
    return [float(one) if is_known else None for one, is_known in zip(factors, known, strict=True)]


def _others(measured: Measured, priors: list[Any]) -> list[Any]:
    return [one for one in measured.priors if all(one is not prior for prior in priors)]


def _scaled(prior: Any, factors: Floats) -> Any:
    axes = np.array([factors[0], factors[0], factors[1]])
    if prior.sigma is not None:
        return dataclasses.replace(prior, sigma=np.asarray(prior.sigma) * axes)
    return dataclasses.replace(
        prior, covariance=np.asarray(prior.covariance) * np.outer(axes, axes)
    )


def _sums(problem: Problem, rows: list[int], priors: list[Any], covariances: Floats) -> Floats:
    """Return, for each group, the sum of squares and that of the redundancies."""
    poses = problem.cam_from_world[rows]
    back = np.swapaxes(rotation_matrices(poses[:, :4]), 1, 2)
    antennas = _antennas(problem, rows, priors)
    # With b = R^T (a - t), db/dw is R^T [a - t]x = [b]x R^T for the rotation w, and db/dt is -R^T.
    jacobian = np.concatenate([cross_matrices(antennas) @ back, -back], axis=2)
    spread = jacobian @ covariances @ np.swapaxes(jacobian, 1, 2)
    sums = np.zeros((2, 2))
    for prior, antenna, one in zip(priors, antennas, spread, strict=True):
        position = np.asarray(prior.position, float)
        variance = np.diag(prior.full_covariance)
        for group, (axes, *_) in enumerate(GROUPS):
            sums[group, 0] += np.nansum((antenna - position)[axes] ** 2 / variance[axes])
            redundancy = (1.0 - np.diag(one)[axes] / variance[axes])[np.isfinite(position[axes])]
            sums[group, 1] += redundancy.sum()
    return sums
