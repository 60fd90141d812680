"""Stretches of IMU samples that are no measurements: frozen, zero, clipped, or a spike.

frozen, zero
    A sensor repeats all three axes. Noise makes this improbable: with a share p of repeated
    samples elsewhere in n samples, a run of r repetitions is expected n p^r times.

saturated
    The largest or smallest value of an axis, if it occurs in runs and its distribution piles up
    there: the last value of a clipped axis is more frequent than the one before it. In an axis
    that is quantised, but not clipped, it is less frequent.

spike
    A sample far from the median of its neighbours. Distances are relative to the quartiles of these
    neighbours, which at most five spikes in a row do not move, and to the whole recording. Both
    are below 3 in vibrating and in smooth flights at 50 to 200 Hz.

The sensor did measure something else in this time, so that :class:`ImuSlices` treats a stretch as a
gap: its samples are replaced by interpolation, with a larger uncertainty.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

Array = np.ndarray[Any, Any]

LONGEST_BRIDGE = 2.0  # s; over a longer stretch, depths and with them the scale get lost
FROZEN_RUN = 5  # usual runs
FROZEN_EXPECTED = 1e-3  # number of such runs by chance
SATURATED_RUN = 4
PILE = 3  # samples at the last value for one at the value before it
NEIGHBOURS, QUARTILES = 21, (5, 10, 15)
SPIKE_SPREAD, SPIKE_USUAL = 6.0, 4.0  # quartile distances; 99th percentiles of the recording
LEAST_SPIKE = (0.05, 0.5)  # rad/s, m/s^2


class BadStretch(NamedTuple):
    """Rows ``first`` to ``last`` of a sensor ("gyro" or "accel"), and the size of their error."""

    kind: str
    sensor: str
    first: int
    last: int
    size: float = 0.0

    @property
    def is_replaced(self) -> bool:
        """True if interpolation is better than the samples themselves."""
        return self.kind != "saturated"


def bad_stretches(gyro: Array, accel: Array) -> tuple[BadStretch, ...]:
    """Return the bad stretches of samples (n, 3), sorted by row; those of a sensor are disjoint."""
    found: list[BadStretch] = []
    for sensor, values, least in zip(("gyro", "accel"), (gyro, accel), LEAST_SPIKE, strict=True):
        good = np.ones(len(values), bool)
        for first, last in _frozen(values):
            kind = "frozen" if values[first].any() else "zero"
            found.append(BadStretch(kind, sensor, first, last))
            good[first : last + 1] = False
        for first, last, size in _spikes(values, good, least):
            found.append(BadStretch("spike", sensor, first, last, size))
            good[first : last + 1] = False
        for first, last in _saturated(values, good):
            found.append(BadStretch("saturated", sensor, first, last))
    return tuple(sorted(found, key=lambda each: (each.first, each.sensor)))


def is_bridged(stretch: BadStretch, stamps: Array) -> bool:
    """Return True if a stretch is short enough to be bridged."""
    return float(stamps[stretch.last] - stamps[stretch.first]) <= 1e9 * LONGEST_BRIDGE


def _runs(flags: Array) -> Array:
    """Return the first and last index of each run of true flags (k, 2)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return edges.reshape(-1, 2) - [0, 1]


def _frozen(values: Array) -> list[tuple[int, int]]:
    runs = _runs((values[1:] == values[:-1]).all(axis=1))
    runs[:, 1] += 1  # of samples, not of steps
    length = runs[:, 1] - runs[:, 0] + 1
    others = len(values) - int(length.sum())  # samples that do not repeat
    usual = float(np.median(np.append(length, np.ones(others)))) if len(values) else 1.0
    long = length >= FROZEN_RUN * usual
    share = float((length[~long] - 1).sum()) / len(values)
    improbable = len(values) * share ** (length - 1.0) < FROZEN_EXPECTED
    return [(int(a), int(b)) for a, b in runs[long & improbable]]


def _saturated(values: Array, good: Array) -> list[tuple[int, int]]:
    clipped = np.zeros(len(values), bool)
    for axis in values.T:
        levels, counts = np.unique(axis[good], return_counts=True)
        if len(levels) < SATURATED_RUN:
            continue
        for end, before in ((-1, -2), (0, 1)):
            if counts[end] < max(SATURATED_RUN, PILE * counts[before]):
                continue
            there = (axis == levels[end]) & good
            if (np.diff(_runs(there)) + 1 >= SATURATED_RUN).any():
                clipped |= there
    return [(int(a), int(b)) for a, b in _runs(clipped)]


def _spikes(values: Array, good: Array, least: float) -> list[tuple[int, int, float]]:
    if len(values) < NEIGHBOURS:
        return []
    half = NEIGHBOURS // 2
    padded = np.pad(values, ((half, half), (0, 0)), mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, NEIGHBOURS, axis=0)
    low, middle, high = np.moveaxis(np.partition(windows, QUARTILES, axis=2)[..., QUARTILES], 2, 0)
    distance = np.linalg.norm(values - middle, axis=1)
    usual = float(np.quantile(distance, 0.99))
    bound = np.maximum(SPIKE_SPREAD * np.linalg.norm(high - low, axis=1), SPIKE_USUAL * usual)
    far = (distance > np.maximum(bound, least)) & good
    return [(int(a), int(b), float(distance[a : b + 1].max())) for a, b in _runs(far)]
