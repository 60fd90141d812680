"""Decision between candidates from their held-out errors: a pure function of arrays.

A candidate's score is the RMS of its normalised held-out errors e, clipped at c sigmas:

    S = sqrt(sum min(e, c)^2 / n)

An observation without a projection counts as the clip. All candidates predict the same
observations, so their scores are paired. Errors within an image are correlated; the standard error
of a difference D of two scores therefore comes from the jackknife over the m images with held-out
observations. D_(i) is the difference without the observations of image i, D_(.) their mean:

    SE^2 = (m - 1) / m  sum_i (D_(i) - D_(.))^2

(Efron and Tibshirani 1993, "An introduction to the bootstrap", chapter 11.) A candidate is as good
as the best if its score is not significantly higher (D <= z SE), or not higher by a relevant amount
(D <= t S_best): with many observations, any difference is significant. A candidate with fewer
parameters and a lower score than such a candidate also is as good, although its smaller difference
may have a smaller error. The recommended candidate is the one of these with the fewest free
parameters, as in the one-standard-error rule of Breiman, Friedman, Olshen and Stone (1984). Among
equal numbers of parameters the lower score decides.

Two exceptions depend on the cameras. A significant difference of less than t to a smaller lens is
relevant if the cameras of both fits are farther apart than m = 1 times their standard deviation:
the block bends, and hardly any residual shows it. A best candidate whose positions are more than 3
times less certain than those of another must predict better by 3 t; otherwise the more certain one
is recommended.

``tests/campaigns/judge.py`` measures the numbers z and t on scenes of known truth. Lower limits
choose larger lenses: with z = 1.5 and t = 0.5 %, three times as many scenes get a larger lens than
the true one, and the noise-free error is not lower.

Vetoed candidates take no part. Their scores and differences are still computed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.base.records import dataclass
from bundle.errors import InputError

_Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class DecisionRule:
    """Numbers of the rule."""

    clip: float = 3.0  # largest normalised error that counts, in sigmas
    num_standard_errors: float = 2.0  # significance z of a difference, in standard errors
    threshold: float = 0.01  # relevant difference t, relative to the best score
    movement: float = 1.0  # relevant distance m of the cameras, in their standard deviations
    expensive: float = 3.0  # ratio of the standard deviations of positions that has its price
    price: float = 3.0  # relevant difference, in thresholds, of an expensive candidate


@dataclass(frozen=True, eq=False, kw_only=True)
class Cameras:
    """Cameras of the candidates; NaN if not known."""

    distances: _Floats  # (n, n) rms distances of the centres of two fits after a similarity
    sigmas: _Floats  # (n,) rms standard deviation of the centres, without a similarity
    certainties: _Floats  # (n,) median standard deviation of a position beside cameras and points


@dataclass(frozen=True, eq=False, kw_only=True)
class Decision:
    """Decision between candidates; arrays have one entry per candidate."""

    recommended: int  # index of the recommended candidate
    best: int  # index of the candidate with the lowest score that is not vetoed
    scores: _Floats  # RMS of normalised errors, clipped; NaN for a candidate without errors
    differences: _Floats  # score minus the score of the best candidate
    standard_errors: _Floats  # standard error of each difference over the images; 0 for the best
    is_equal: NDArray[np.bool_]  # True for a candidate as good as the best; False if vetoed
    by_price: NDArray[np.bool_]  # True: predicts worse, but costs less certainty than the best


def decide(
    errors: ArrayLike,
    image: ArrayLike,
    num_parameters: ArrayLike,
    vetoes: Sequence[str] | None = None,
    rule: DecisionRule | None = None,
    cameras: Cameras | None = None,
) -> Decision:
    """Return the recommended candidate.

    Args:
        errors: (num_candidates, num_held_out) normalised errors, in sigmas; NaN without a
            projection. A row of NaN alone is a candidate without a fit.
        image: (num_held_out,) image index of each held-out observation.
        num_parameters: (num_candidates,) number of free parameters.
        vetoes: reason why a candidate may not be recommended; "" if it may. None: no vetoes.
        rule: numbers of the rule; None: the defaults.
        cameras: positions of the fits; None: only the errors count.
    """
    rule = DecisionRule() if rule is None else rule
    values, of_image = np.asarray(errors, float), np.asarray(image)
    cost = np.asarray(num_parameters)
    has_fit = np.isfinite(values).any(axis=1)
    takes_part = has_fit & np.array([not veto for veto in vetoes or [""] * len(values)])
    if not takes_part.any():
        raise InputError("candidates: expected a candidate with a fit and without a veto, found 0")
    count = int(of_image.max(initial=-1)) + 1
    clipped = np.minimum(np.where(np.isfinite(values), values, rule.clip), rule.clip) ** 2
    sums = np.array([np.bincount(of_image, row, count) for row in clipped])
    counts = np.bincount(of_image, minlength=count).astype(float)
    scores = np.where(has_fit, np.sqrt(sums.sum(1) / counts.sum()), np.nan)
    best = int(np.argmin(np.where(takes_part, scores, np.inf)))
    spread = np.array([jackknife(row, sums[best], counts) for row in sums])
    spread[~has_fit] = np.nan
    above = scores - scores[best]
    limit = np.full(len(scores), rule.threshold * scores[best])
    if cameras is not None:  # comparisons with NaN are False
        is_cheaper = cameras.certainties[best] > rule.expensive * cameras.certainties
        limit[is_cheaper] *= rule.price
        moved = cameras.distances[:, best] > rule.movement * cameras.sigmas[best]
        limit[moved & ~is_cheaper & (cost < cost[best])] = 0.0
    is_equal = takes_part & ((above <= rule.num_standard_errors * spread) | (above <= limit))
    for k in np.flatnonzero(is_equal).tolist():
        is_equal |= takes_part & (cost < cost[k]) & (scores <= scores[k])
    order = np.lexsort((scores, cost))
    return Decision(
        recommended=int(order[is_equal[order]][0]),
        best=best,
        scores=scores,
        differences=above,
        standard_errors=spread,
        is_equal=is_equal,
        by_price=is_equal
        & (above > rule.num_standard_errors * spread)
        & (above > rule.threshold * scores[best]),
    )


def jackknife(sums: _Floats, others: _Floats, counts: _Floats) -> float:
    """Return the standard error of the difference of two RMS values from (num_images,) sums."""
    used = counts > 0
    if used.sum() < 2:
        return float("inf") if (sums != others).any() else 0.0
    sums, others, counts = sums[used], others[used], counts[used]
    left = counts.sum() - counts
    difference = np.sqrt((sums.sum() - sums).clip(0) / left)
    difference -= np.sqrt((others.sum() - others).clip(0) / left)
    count = len(counts)
    deviations = difference - difference.mean()
    return float(np.sqrt((count - 1) / count * (deviations @ deviations)))
