"""Outliers: observations that do not belong to their points.

Test. Errors are divided by the local noise, the scale of their surroundings (measured.py). Gaussian
noise exceeds 6 scales once in 65 million observations. Real keypoints have heavier tails, which
alone do no harm: an outlier matters by its share of the cost, which least squares minimises. With a
share q of the cost beyond 6 scales, the RMSE is larger by 1 / sqrt(1 - q).

Threshold. At least 3 observations, and q >= 0.2: RMSE inflated by 12 % or more.

Advice. First a loss whose influence vanishes for large errors: it reduces the weight of outliers
wherever they are, and nothing is deleted. The errors of such a fit tell a tail from a group of its
own. A tail ends gradually: with a density as e^-nu, only 2^(1 - nu) of the errors beyond 6 scales
are beyond 12. If at least half of them are, they are a group, and rounds delete it. The limit lies
in the gap, at 6 sqrt(2) scales. Points are not deleted for small angles, which say how certain
depths are and not that an observation is wrong.
"""

from __future__ import annotations

import numpy as np

from bundle.base.words import number, plural
from bundle.interface.finding import Finding
from bundle.judging.findings.measured import Measured

BEYOND = 6.0
COST_SHARE = 0.2
GAP = 2.0
"""Errors of a group are beyond as many times the limit of outliers."""
GROUP = 0.5
"""Share of the outliers that are a group of their own."""
SMALLEST_LIMIT = 0.5
"""Smallest error that a command deletes [px]."""
BOUNDED = ("cauchy", "tukey", "arctan")
"""Losses whose influence vanishes for large errors."""
FEWEST_OUTLIERS = 3
FEWEST_OBSERVATIONS = 30


def outliers(measured: Measured) -> Finding | None:
    """Return the finding about outliers, or None."""
    known = measured.counted
    count = int(known.sum())
    if count < FEWEST_OBSERVATIONS:
        return None
    errors, scales = measured.errors[known], measured.local_scale[known]
    far = errors > BEYOND * scales
    with np.errstate(over="ignore", invalid="ignore"):
        squares = errors**2
        share = float(squares[far].sum() / squares.sum()) if far.any() else 0.0
    num = int(far.sum())
    if num < FEWEST_OUTLIERS or not share >= COST_SHARE:
        return None
    loss = measured.options.loss
    if loss not in BOUNDED:
        flags: tuple[str, ...] = ("--loss", "cauchy")
        advice = f"they are {number(100 * share)} % of the cost. A robust loss reduces their weight"
    elif measured.rounds or not (errors > GAP * BEYOND * scales).sum() >= GROUP * num:
        return None
    else:
        limit = f"{max(GAP**0.5 * BEYOND * measured.scale, SMALLEST_LIMIT):.2g}"
        flags = ("--rounds", "3", "--max-error", limit, "--min-angle", "0")
        deleted = plural(int((errors > float(limit)).sum()), "observation")
        advice = (
            f"the {loss} loss reduces their weight, and they are a group apart. Rounds delete "
            f"{deleted} above {limit} px, and no point for its angle"
        )
    return Finding(
        kind="outliers",
        sentence=f"Outliers: {plural(num, 'observation')} "
        f"({number(100 * float(far.mean()))} %) have errors beyond {BEYOND:g} times the noise of "
        f"their surroundings ({measured.scale:.2g} px); {advice}.",
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
