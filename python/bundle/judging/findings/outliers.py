"""Outliers: observations that do not belong to their points.

Test. Errors are standardized (the model absorbs a part of each, by its leverage) and divided by the
local noise, the scale of their surroundings (measured.py). Gaussian noise exceeds 6 scales once in
65 million observations. Real keypoints have heavier tails. These alone do no harm: what matters is
the share of the cost that the outliers have. With a share q of the cost beyond 6 scales, the RMSE
is larger by 1 / sqrt(1 - q).

Threshold. At least 3 observations, and q >= 0.2: RMSE inflated by 12 % or more.

Advice. A loss whose influence psi = rho' e vanishes for large errors reduces the weight of outliers
wherever they are, and nothing is deleted. After it, outliers matter by their share of the sum of
psi^2, which is the variance of the gradient: with the share q they move the model by about sqrt(q)
of its standard deviation. At noise near the scale c of the loss, outliers of 15 to 60 px have
q < 0.003, and rounds that delete them change the position errors by factors of 1.00 +- 0.04 (25
scenes): no command helps. They keep q >= 0.2 only if c is much larger than the noise. Then the
suggested scale is 2.4 times the noise, where the Cauchy loss is 94 % efficient for Gaussian noise.

No estimate tells more outliers from good observations than half of the redundancy (Rousseeuw and
Leroy 1987, section 3.4). Beyond that, a loss that rejects observations has fitted the
others too well, as in short tracks: these seem to have hardly any noise, and no finding is made.

A scale c below the noise wastes good observations: the loss is 76 % efficient at c = 1 noise, 55 %
at half of it, and needs twice the steps. So the scale is suggested, too, if it is below 1.5 times
the noise (86 %). The noise is that of the model after a robust solve, because outliers bend the
model. On 16 scenes with noise of 0.3 to 1 px and motion, position errors fell to 0.63 of those of
least squares at c = 1 px, and to 0.58 at c = 2.4 times the noise.
"""

from __future__ import annotations

import numpy as np

from bundle.base.arrays import median
from bundle.base.words import number, plural
from bundle.interface.finding import Finding
from bundle.judging.findings.measured import Measured
from bundle.model.losses import evaluate_loss

BEYOND = 6.0
SHARE = 0.2
EFFICIENT, SMALLEST = 2.4, 1.5
"""Scale of the Cauchy loss over the noise: the best one, and the largest that is suggested."""
BOUNDED = ("cauchy", "tukey", "arctan")  # losses whose influence vanishes for large errors
FEWEST_OUTLIERS = 3
FEWEST_OBSERVATIONS = 30


def outliers(measured: Measured, robust: Measured | None = None) -> Finding | None:
    """Return the finding about outliers, or None; ``robust`` is the model after a robust solve."""
    tested = measured.standardized
    known = tested.counted
    count = int(known.sum())
    if count < FEWEST_OBSERVATIONS:
        return None
    errors = measured.errors[known]
    far = (tested.errors > BEYOND * tested.local_scale)[known]
    with np.errstate(over="ignore", invalid="ignore"):
        squares = errors**2
        share = float(squares[far].sum() / squares.sum()) if far.any() else 0.0
    num = int(far.sum())
    if num < FEWEST_OUTLIERS or not share >= SHARE:
        return None
    options = measured.options
    advice = f"they are {number(100 * share)} % of the cost. A robust loss reduces their weight"
    flags: tuple[str, ...] = ("--loss", "cauchy")
    sigma = measured.problem.observation_sigma
    sigmas = np.ones(count) if sigma is None else sigma[known]
    if options.loss in BOUNDED:
        whitened = np.minimum(errors / sigmas, 1e150) ** 2
        influence = whitened * evaluate_loss(options.loss, options.loss_scale, whitened)[:, 1] ** 2
        pull = float(influence[far].sum() / max(influence.sum(), 1e-300))
        scale = EFFICIENT * measured.scale / median(sigmas)
        points = measured.problem.num_points * ("points" in options.refine)
        images = measured.problem.num_images * ("poses" in options.refine)
        is_told_apart = num <= 0.5 * (count - (3 * points + 6 * images) / 2)
        if not pull >= SHARE or options.loss_scale <= scale or not is_told_apart:
            return None
        advice = (
            f"they have {number(100 * pull)} % of the influence, because the {options.loss} loss "
            f"begins only at {number(options.loss_scale)}. A smaller scale reduces their weight"
        )
        flags += ("--loss-scale", f"{scale:.2g}")
    elif robust is not None:
        noise = min(robust.scale, measured.scale) / median(sigmas)
        if options.loss_scale < SMALLEST * noise:
            flags += ("--loss-scale", f"{EFFICIENT * noise:.2g}")
    return Finding(
        kind="outliers",
        sentence=f"Outliers: {plural(num, 'observation')} "
        f"({number(100 * float(far.mean()))} %) have errors beyond {BEYOND:g} times the local "
        f"noise ({measured.scale:.2g} px); {advice}.",
        command=measured.command.refine(*flags),
        evidence={
            "num_outliers": num,
            "share": float(far.mean()),
            "cost_share": share,
            "scale": measured.scale,
            "rmse": float(np.sqrt(squares.mean())),
            "rmse_without": float(np.sqrt(squares[~far].mean())),
        },
    )
