"""Outliers: observations that do not belong to their points.

Test. Errors are divided by the local noise, the scale of their surroundings (measured.py). Gaussian
noise exceeds 6 scales once in 65 million observations. Real keypoints have heavier tails, which
alone do no harm: an outlier matters by its share of the cost, which least squares minimises. With a
share q of the cost beyond 6 scales, the RMSE is larger by 1 / sqrt(1 - q).

Threshold. At least 3 observations, and q >= 0.2: RMSE inflated by 12 % or more.

A robust loss reduces the weight of outliers, and rounds remove them; neither is advised twice.
Rounds remove errors above 4 px by default. The command states another limit if 6 scales of a robust
fit are far from it; those of least squares say little, since outliers bend the model.
"""

from __future__ import annotations

import numpy as np

from bundle.base.words import number, plural
from bundle.interface.finding import Finding
from bundle.judging.findings.measured import Measured

__all__ = ["outliers"]

BEYOND = 6.0
COST_SHARE = 0.2
USUAL_LIMIT = 2.0, 4.0
"""Pixels of 6 scales between which the default limit of rounds, 4 px, is right."""
SMALLEST_LIMIT = 0.5
FEWEST_OUTLIERS = 3
FEWEST_OBSERVATIONS = 30


def outliers(measured: Measured, robust_scale: float | None = None) -> Finding | None:
    """Return the finding about outliers, or None.

    Args:
        measured: the model.
        robust_scale: noise of a fit that outliers do not bend [px]; None: unknown.
    """
    known = measured.counted
    count = int(known.sum())
    if count < FEWEST_OBSERVATIONS:
        return None
    errors = measured.errors[known]
    far = errors > BEYOND * measured.local_scale[known]
    with np.errstate(over="ignore", invalid="ignore"):
        squares = errors**2
        share = float(squares[far].sum() / squares.sum()) if far.any() else 0.0
    is_handled = measured.options.loss != "trivial" and measured.rounds > 0
    if int(far.sum()) < FEWEST_OUTLIERS or not share >= COST_SHARE or is_handled:
        return None
    rmse = float(np.sqrt(squares.mean()))
    rest = float(np.sqrt(squares[~far].mean()))
    effect = (
        f"they are {number(100 * share)} % of the cost"
        if measured.options.loss == "trivial"
        else f"the {measured.options.loss.replace('_', '-')} loss reduces their weight, and they "
        "are still in the model"
    )
    limit: tuple[str, ...] = ()
    if robust_scale is not None:
        low, high = USUAL_LIMIT
        wanted = max(BEYOND * robust_scale, SMALLEST_LIMIT)
        limit = () if low <= wanted <= high else ("--max-error", f"{wanted:.2g}")
    return Finding(
        kind="outliers",
        sentence=f"Outliers: {plural(int(far.sum()), 'observation')} "
        f"({number(100 * float(far.mean()))} %) have errors beyond {BEYOND:g} times the noise of "
        f"their surroundings ({measured.scale:.2g} px); {effect}.",
        command=measured.command.refine("--loss", "cauchy", "--rounds", "3", *limit),
        evidence={
            "num_outliers": int(far.sum()),
            "share": float(far.mean()),
            "cost_share": share,
            "scale": measured.scale,
            "rmse": rmse,
            "rmse_without": rest,
        },
    )
