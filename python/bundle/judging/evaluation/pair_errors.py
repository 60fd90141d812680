"""Errors of relative poses over all pairs of images, and the area under their recall (AUC).

Of images i and j, with rotations R world_from_camera and centres c, the relative pose in the camera
of j is R_j^T R_i and R_j^T (c_i - c_j). Its errors are

    RRE: the angle between the rotations of estimate and reference,
    RTE: the angle between the directions of the translations,

which no similarity of the world changes: pairs need no alignment. The error e of a pair is the
larger of both. With r(x) the share of pairs with e <= x, all literature reports

    AUC(tau) = 1 / tau * integral of r(x) dx from 0 to tau,

but computes it in four ways:

    trapezoid  linear between the sorted errors, pairs i < j: SuperGlue (Sarlin et al. 2020)
    colmap     the same over ordered pairs, images missing in the estimate have 180 degrees: COLMAP
    histogram  steps of one degree, pairs i < j: PoseDiffusion, VGGSfM, VGGT
    integral   exact, the mean of max(0, 1 - e / tau), pairs i < j

The trapezoid needs no sorted errors: between the sorted errors e_k and e_k+1, linear interpolation
adds (e_k+1 - e_k) / (2 n) to the area under the steps. The sum telescopes, so that

    AUC_trapezoid(tau) = AUC_integral(tau) + max{e : e <= tau} / (2 n tau).

All definitions are therefore sums over pairs. They are accumulated over blocks of rows, in memory
that does not grow with the number of pairs. If there are more than 5,000 images, 5,000 of them,
evenly spaced in their order, are used.

RTE depends on the direction of a pair, because the camera that measures it changes; with i < j the
order of the images matters. Callers sort images by name or time. If the cameras of a pair have the
same centre in the reference, no direction exists, and RTE is 0; if they have it in the estimate
only, RTE is 180 degrees.

With g_i = r_i q_i^-1 for the unit quaternions r_i of the reference and q_i of the estimate, RRE is
the angle of g_j^-1 g_i, which is 4 asin(|g_i - g_j| / 2) after a choice of signs, accurate near 0.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.model.rigid_motions import quaternion_inverse, quaternion_multiply, rotation_matrices

Array = NDArray[np.float64]

THRESHOLDS = (1, 3, 5, 10, 30)
"""Thresholds of AUC, RRA and RTA in degrees."""

SAME_PLACE = 1e-9
"""Baseline relative to the extent of the centres below which it has no direction."""

MOST_IMAGES = 5000
"""Number of images whose pairs are computed."""

BLOCK = 100_000
"""Pairs that are computed at once."""

Table = dict[str, float]


@dataclass(frozen=True)
class PairErrors:
    """Accuracy of relative poses; tables have the thresholds in degrees as text, such as "5"."""

    num_pairs: int  # number of pairs i < j
    num_pairs_at_one_place: int  # pairs whose cameras have the same centre in the reference
    rotation_accuracy: Table  # RRA, share of pairs with a smaller RRE
    translation_accuracy: Table  # RTA, share of pairs with a smaller RTE
    auc: dict[str, Table]  # AUC by definition, then by threshold


class _Sums:
    """Sums over the errors of pairs."""

    def __init__(self) -> None:
        self.count = 0
        self.area = np.zeros(len(THRESHOLDS))
        self.largest = np.zeros(len(THRESHOLDS))
        self.below = np.zeros(max(THRESHOLDS) + 1)
        self.within = np.zeros(len(THRESHOLDS))

    def add(self, errors: Array) -> None:
        self.count += len(errors)
        near = errors[errors <= max(THRESHOLDS)]
        for k, limit in enumerate(THRESHOLDS):
            inside = near[near <= limit]
            if len(inside):
                self.area[k] += (1 - inside / limit).sum()
                self.largest[k] = max(self.largest[k], inside.max())
                self.within[k] += len(inside)
        self.below[1:] += np.cumsum(np.histogram(near, np.arange(max(THRESHOLDS) + 1))[0])

    def integral(self) -> Array:
        share: Array = self.area / max(self.count, 1)
        return share

    def trapezoid(self, missing: int = 0) -> Array:
        """Return the AUC of the trapezoid, with errors of 180 degrees for missing pairs."""
        count = max(self.count + missing, 1)
        area: Array = self.area / count + self.largest / (2 * count * np.array(THRESHOLDS))
        return area

    def histogram(self) -> Array:
        values = []
        for limit, within in zip(THRESHOLDS, self.within, strict=True):
            # The last bin of a histogram includes its upper edge.
            values.append((self.below[1:limit].sum() + within) / (limit * max(self.count, 1)))
        return np.array(values)


def pair_errors(estimate: Array, reference: Array, num_missing: int = 0) -> PairErrors:
    """Return the accuracy of relative poses over all pairs.

    Args:
        estimate: (n, 7) poses world_from_camera in any world, in the order of names or times.
        reference: (n, 7) poses of the reference.
        num_missing: number of further images of the reference that the estimate lacks.
    """
    if len(reference) > MOST_IMAGES:
        chosen = np.linspace(0, len(reference) - 1, MOST_IMAGES).round().astype(np.int64)
        num_missing = round(num_missing * MOST_IMAGES / len(reference))
        estimate, reference = estimate[chosen], reference[chosen]
    count = len(reference)
    turn = quaternion_multiply(reference[:, :4], quaternion_inverse(estimate[:, :4]))
    matrices = rotation_matrices(turn)
    here, there = _normalized(estimate[:, 4:]), _normalized(reference[:, 4:])
    forward, ordered = _Sums(), _Sums()
    rotation, translation = np.zeros(len(THRESHOLDS)), np.zeros(len(THRESHOLDS))
    at_one_place = 0
    step = max(BLOCK // max(count, 1), 1)
    for begin in range(0, count, step):
        rows = np.arange(begin, min(begin + step, count))
        angle = _rotation_errors(turn, rows)
        direction, alone = _direction_errors(here, there, matrices, rows)
        error = np.maximum(angle, direction)
        later = np.arange(count) > rows[:, None]
        ordered.add(error[np.arange(count) != rows[:, None]])
        forward.add(error[later])
        at_one_place += int((alone & later).sum())
        for k, limit in enumerate(THRESHOLDS):
            rotation[k] += (angle[later] < limit).sum()
            translation[k] += (direction[later] < limit).sum()
    whole = count + num_missing
    missing = whole * (whole - 1) - count * (count - 1)
    pairs = max(forward.count, 1)
    return PairErrors(
        num_pairs=forward.count,
        num_pairs_at_one_place=at_one_place,
        rotation_accuracy=_table(rotation / pairs),
        translation_accuracy=_table(translation / pairs),
        auc={
            "trapezoid": _table(forward.trapezoid()),
            "colmap": _table(ordered.trapezoid(missing)),
            "histogram": _table(forward.histogram()),
            "integral": _table(forward.integral()),
        },
    )


def _rotation_errors(turn: Array, rows: NDArray[np.int64]) -> Array:
    """Return RRE in degrees, (rows, n)."""
    both = [((turn[rows, None] + sign * turn) ** 2).sum(axis=-1) for sign in (-1.0, 1.0)]
    half = np.sqrt(np.minimum(*both)) / 2
    errors: Array = np.degrees(4 * np.arcsin(np.minimum(half, np.sqrt(0.5))))
    return errors


def _direction_errors(
    estimate: Array, reference: Array, matrices: Array, rows: NDArray[np.int64]
) -> tuple[Array, NDArray[np.bool_]]:
    """Return RTE in degrees, (rows, n), and the mask of pairs at one place in the reference."""
    here = estimate[rows, None] - estimate
    there = reference[rows, None] - reference
    turned = np.matmul(matrices, here[..., None])[..., 0]
    cross = np.linalg.norm(np.cross(turned, there), axis=-1)
    angle = np.degrees(np.arctan2(cross, (turned * there).sum(axis=-1)))
    short, alone = (np.linalg.norm(base, axis=-1) <= SAME_PLACE for base in (here, there))
    return np.where(alone, 0.0, np.where(short, 180.0, angle)), alone


def _normalized(centers: Array) -> Array:
    centered = centers - centers.mean(axis=0)
    extent = float(np.abs(centered).max())
    normalized: Array = centered / extent if extent > 0 else centered
    return normalized


def _table(values: Array) -> Table:
    return {
        str(limit): float(value) for limit, value in zip(THRESHOLDS, values.tolist(), strict=True)
    }
