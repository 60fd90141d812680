r"""Measured positions against the model: sigmas, single wrong positions, drift of the scale.

The residual of image i in units of its sigma has the length d_i; for right sigmas d_i^2 is chi^2
with as many degrees of freedom as measured axes (median 2.37 for three, 1.39 for two).

Wrong sigmas. The ratio sqrt(median d^2 / its expected median) is above 2, over at least 6 images.
The command gives the sigma that the residuals show.
Single positions. d_i is above 5 ratios (at least 5 sigmas) in at most a third of the images.
Both limits are 1.5 times as high if outliers or a small lens bend the model.

Drift. Priors pull the model, so that a drift shows little in the residuals. If these show any
tension (a ratio above 1.5, or a residual above 5 sigmas), the model is solved without positions,
and with a larger lens if its own is too small. With its centres c and the positions p, the scale of
a part of the images is s = sum |p - mean p| / sum |c - mean c|. That of the first half of the
images in their order and that of the second differ by more than 9 % and by 5 standard errors; the
error of each is sigma / (spread sqrt n).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.words import number, plural
from bundle.errors import shown
from bundle.interface.finding import Finding
from bundle.judging.findings.measured import Measured, median
from bundle.model.problem import Problem
from bundle.model.rotations import quaternion_inverse, quaternion_rotate

__all__ = ["is_tense", "measured_positions", "position_offset", "scale_drift"]

CHI2_MEDIANS = {1: 0.4549, 2: 1.3863, 3: 2.3660}
RATIO, BENT_FACTOR = 2.0, 1.5
TENSION = 1.5
OUTLIER = 5.0
FEWEST = 6
DRIFT, DRIFT_ERRORS = 0.09, 5.0

Floats = NDArray[np.float64]


def measured_positions(measured: Measured, *, model_bends: bool = False) -> Finding | None:
    """Return the finding about positions that contradict the model, or None.

    Args:
        measured: the model with its measured positions.
        model_bends: True if outliers or a small lens bend the model.
    """
    rows, priors = _used(measured)
    if len(rows) < FEWEST:
        return None
    factor = BENT_FACTOR if model_bends else 1.0
    distance, ratio = _distances(measured, rows, priors)
    wrong = np.flatnonzero(distance > OUTLIER * factor * max(ratio, 1.0))
    problem = measured.whole
    sigma = _horizontal_sigma(priors)
    evidence: dict[str, Any] = {
        "num_positions": len(rows),
        "ratio": ratio,
        "image_ids": [int(problem.image_ids[rows[k]]) for k in wrong.tolist()],
        "sigmas": distance[wrong].tolist(),
    }
    is_robust = all(prior.loss != "trivial" for prior in priors)
    if len(wrong) and 3 * len(wrong) <= len(rows) and not is_robust:
        worst = int(wrong[np.argmax(distance[wrong])])
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
    if ratio > RATIO * factor:
        return Finding(
            kind="positions",
            sentence=f"Measured positions and model differ by {number(ratio)} times the sigmas: "
            f"they are nearer to {number(ratio * sigma)} than to {number(sigma)}, or the model is "
            "bent.",
            command=measured.command.refine("--gps-sigma", f"{ratio * sigma:.2g}"),
            evidence=evidence,
        )
    return None


def position_offset(measured: Measured) -> Finding | None:
    """Return the finding about an offset of positions from control points, or None.

    ``solving/survey_checks.py`` has the test. Without the offset, a focal length absorbs it.
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
            " With the offset only relief determines both: add oblique images, or a prior on f."
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


def is_tense(measured: Measured) -> bool:
    """Return True if residuals of positions are larger than their sigmas say."""
    rows, priors = _used(measured)
    if len(rows) < FEWEST:
        return False
    distance, ratio = _distances(measured, rows, priors)
    return bool(ratio > TENSION or (distance > OUTLIER).any())


def scale_drift(measured: Measured, free: Problem) -> Finding | None:
    """Return the finding about a scale that changes along the images, or None.

    Args:
        measured: the model with its measured positions.
        free: the model as the images alone determine it, in any frame.
    """
    rows, priors = _used(measured)
    if len(rows) < 2 * FEWEST:
        return None
    distance, ratio = _distances(measured, rows, priors)
    right = np.flatnonzero(distance <= OUTLIER * max(ratio, 1.0)).tolist()
    rows, priors = [rows[k] for k in right], [priors[k] for k in right]
    if len(rows) < 2 * FEWEST:
        return None
    order = np.argsort(measured.whole.image_ids[rows], kind="stable")
    antennas = np.array(
        [_antenna(free, row, prior) for row, prior in zip(rows, priors, strict=True)]
    )[order]
    positions = np.array([np.asarray(prior.position) for prior in priors])[order]
    flat = np.isnan(positions[:, 2]).any()
    given, found = (values[:, : 2 if flat else 3] for values in (positions, antennas))
    sigma = _horizontal_sigma(priors)
    half = len(rows) // 2
    scales, errors = [], []
    for part in (slice(None, half), slice(half, None)):
        spread = [
            float(np.linalg.norm(values[part] - values[part].mean(axis=0), axis=1).sum())
            for values in (given, found)
        ]
        if not spread[1] > 0 or not spread[0] > 0:
            return None
        count = len(given[part])
        scales.append(spread[0] / spread[1])
        errors.append(sigma * np.sqrt(count) / spread[0])
    change = float(np.log(scales[1] / scales[0]))
    error = float(np.hypot(*errors))
    if not (abs(change) > DRIFT and abs(change) > DRIFT_ERRORS * error):
        return None
    return Finding(
        kind="scale_drift",
        sentence=f"The scale drifts: the second half of the images is {100 * np.expm1(change):+.1f}"
        f" % larger in the measured positions than in the model, against the first half "
        f"(standard error {100 * error:.1f} %). Give the positions smaller sigmas, or close loops.",
        command=measured.command.refine("--gps-sigma", f"{sigma / 3:.2g}"),
        evidence={"change": float(np.expm1(change)), "standard_error": error},
    )


def _distances(measured: Measured, rows: list[int], priors: list[Any]) -> tuple[Floats, float]:
    """Return residuals in sigmas, and the ratio of their median to the expected one."""
    whitened = np.array(
        [prior.whiten(_antenna(measured.whole, row, prior) - np.asarray(prior.position))
         for row, prior in zip(rows, priors, strict=True)]
    )  # fmt: skip
    axes = int(np.clip(median((np.abs(whitened) > 0).sum(axis=1).astype(float)), 1, 3))
    distance = np.sqrt((whitened**2).sum(axis=1))
    ratio = float(median(distance) / np.sqrt(CHI2_MEDIANS[axes]))
    return distance, ratio


def _used(measured: Measured) -> tuple[list[int], list[Any]]:
    """Return rows of images with measured positions, and these positions."""
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


def _antenna(problem: Problem, row: int, prior: Any) -> Floats:
    """Return the position of the antenna of an image in the model."""
    pose = problem.cam_from_world[row : row + 1]
    turned = quaternion_rotate(
        quaternion_inverse(pose[:, :4]), np.asarray(prior.lever_arm, float)[None]
    )
    antenna: Floats = problem.projection_centers[row] + turned[0]
    return antenna


def _horizontal_sigma(priors: list[Any]) -> float:
    sigmas = [float(np.sqrt(prior.full_covariance[0, 0])) for prior in priors]
    return median(np.array(sigmas))
