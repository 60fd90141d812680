r"""Measured gravity, orientations and headings that contradict most others of their kind.

A robust fit first turns the model to the measurements and removes the mean of each kind. So it
finds a few wrong measurements although they pull the model, and it gives no finding for a model
that is not aligned yet. The length a_i of the remaining turn in its sigmas has a chi distribution
with k = 1, 2 or 3 degrees of freedom.

Single images. a_i is above max(1, ratio) times the quantile that the largest of n good ones exceeds
with a probability of 0.1 %, and above 1 degree, in less than half of the images. The ratio is the
median of a_i over that of the chi distribution.
Wrong sigmas. The ratio exceeds 2, and 1 by 3 of its standard errors, over at least 6 images. The
median of n lengths has the relative standard error c_k / sqrt(n), with c_k = 1 / (2 f(m) m), m the
median and f the density of the chi distribution. The command sets the sigma from the residuals.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from bundle.base.words import number, plural
from bundle.errors import shown
from bundle.interface.finding import Finding
from bundle.interface.georeference_options import GRAVITY_SIGMA
from bundle.judging.findings.measured import Measured

if TYPE_CHECKING:
    from bundle.georeference.attitudes import AttitudeErrors

RATIO = 2.0
ERRORS = 3.0
SPREAD = {"heading": 1.17, "gravity": 0.72, "orientation": 0.56}
"""c_k: relative standard error of the median length, times the root of the number of images."""
FEWEST = 6
SMALLEST = 1.0  # angle in degrees below which a measurement is not accused

SCALES = {
    "gravity": "--gravity-sigma-scale",
    "orientation": "--orientation-sigma-scale",
    "heading": "--orientation-sigma-scale",
}
"""Flags with a factor on sigmas, also on those of the file."""


def wrong_attitudes(measured: Measured) -> Finding | None:
    """Return the finding about attitudes that contradict the model, or None."""
    if not any(hasattr(prior, "num_residuals") for prior in measured.priors):
        return None
    from bundle.georeference.attitude_priors import AttitudePrior
    from bundle.georeference.attitudes import Attitudes

    priors = [prior for prior in measured.priors if isinstance(prior, AttitudePrior)]
    is_robust = all(getattr(prior, "loss", "") != "trivial" for prior in priors)
    for errors in Attitudes(tuple(priors)).errors(measured.whole, turned=True):
        found = None if is_robust else _single(measured, errors)
        found = found or _wrong_sigmas(measured, errors)
        if found is not None:
            return found
    return None


def _single(measured: Measured, errors: AttitudeErrors) -> Finding | None:
    wrong = sorted(
        (image for image in errors.suspects if image.apart > SMALLEST),
        key=lambda image: -image.apart,
    )
    count = len(errors.images)
    if not wrong or 2 * len(wrong) >= count or count < 3:
        return None
    worst = wrong[0]
    typical = float(np.median([image.apart for image in errors.images]))
    return Finding(
        kind="attitudes",
        sentence=f"{errors.noun.capitalize()} of {len(wrong)} of {plural(count, 'image')} "
        f"contradicts the others: {shown(worst.image)} is {worst.apart:.3g} degrees off, the "
        f"median image {typical:.2g}.",
        command=measured.command.refine("--prior-loss", "tukey"),
        evidence={
            "noun": errors.noun,
            "num_images": count,
            "images": [image.image for image in wrong],
            "degrees": [image.apart for image in wrong],
        },
    )


def _wrong_sigmas(measured: Measured, errors: AttitudeErrors) -> Finding | None:
    count = len(errors.images)
    limit = max(RATIO, 1 + ERRORS * SPREAD[errors.noun] / math.sqrt(max(count, 1)))
    if count < FEWEST or not errors.ratio > limit:
        return None
    sigma = f"{errors.ratio * errors.sigma:.2g}"
    return Finding(
        kind="attitudes",
        sentence=f"{errors.noun.capitalize()} and model differ by {number(errors.ratio)} times the "
        f"sigmas: the sigmas are rather {sigma} than {number(errors.sigma)} degrees, or the model "
        "is bent. Give the measurements larger sigmas.",
        command=_sigma_command(measured, errors, sigma),
        evidence={"noun": errors.noun, "num_images": count, "ratio": errors.ratio},
    )


def _sigma_command(measured: Measured, errors: AttitudeErrors, sigma: str) -> str:
    command, flag = measured.command, SCALES[errors.noun]
    scale = command.value(flag, "")
    default = float(command.value("--gravity-sigma", str(GRAVITY_SIGMA)))
    sigmas = [prior.sigma_degrees for prior in measured.priors if hasattr(prior, "direction")]
    if errors.noun == "gravity" and not scale and np.allclose(sigmas, default, rtol=1e-9):
        return command.refine("--gravity-sigma", sigma)
    return command.refine(flag, f"{errors.ratio * float(scale or 1):.2g}")
