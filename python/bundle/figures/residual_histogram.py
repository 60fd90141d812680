"""Histograms of residuals: coordinates on a linear axis, lengths on a logarithmic one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.model.residuals import Residuals

BINS = 61
SHARE = 0.99
WIDEST = 4.0


@dataclass(frozen=True, eq=False, kw_only=True)
class ResidualHistogram:
    """Histograms of sets of residuals with labels such as "before" and "after".

    Attributes:
        edges: (bins + 1,) edges of coordinates [pixels], symmetric about 0.
        coordinates: (bins,) counts of x and y together, by label.
        share_outside: share of the coordinates beyond the edges, by label.
        length_edges: (bins + 1,) edges of lengths [pixels], with a constant ratio.
        lengths: (bins,) counts, by label; lengths below the first edge are in the first bin.
        sigma: robust spread of the coordinates by label [pixels], 1.4826 median |r_x|, |r_y|; for
            normally distributed residuals it is their standard deviation.
    """

    edges: NDArray[np.float64]
    coordinates: dict[str, NDArray[np.int64]]
    share_outside: dict[str, float]
    length_edges: NDArray[np.float64]
    lengths: dict[str, NDArray[np.int64]]
    sigma: dict[str, float]


def residual_histogram(sets: dict[str, Residuals]) -> ResidualHistogram | None:
    """Return histograms of counted residuals; None if no observation counts.

    The axis of coordinates covers 99 % of the last set. It covers up to 99 % of the others, but at
    most four times the range of the last set.
    """
    values = {label: found.xy[found.counted] for label, found in sets.items()}
    if not values or not all(len(part) for part in values.values()):
        return None
    widths = [float(np.quantile(np.abs(part), SHARE)) for part in values.values()]
    limit = max(min(max(widths), WIDEST * widths[-1]), 1e-12)
    edges = np.linspace(-limit, limit, BINS + 1)
    lengths = {label: np.hypot(part[:, 0], part[:, 1]) for label, part in values.items()}
    positive = np.concatenate([part[part > 0] for part in lengths.values()])
    low, high = np.quantile(positive, [0.001, 1.0]) if len(positive) else (0.1, 1.0)
    length_edges = np.geomspace(max(low, high * 1e-9), high * (1 + 1e-9), BINS + 1)
    return ResidualHistogram(
        edges=edges,
        coordinates={label: np.histogram(part, edges)[0] for label, part in values.items()},
        share_outside={
            label: float((np.abs(part) > limit).mean()) for label, part in values.items()
        },
        length_edges=length_edges,
        lengths={
            label: np.histogram(np.maximum(part, length_edges[0]), length_edges)[0]
            for label, part in lengths.items()
        },
        sigma={label: 1.4826 * float(np.median(np.abs(part))) for label, part in values.items()},
    )
