r"""Faulty stretches of IMU samples: frozen, zero, clipped, and spikes.

Samples of a working sensor have noise. These patterns do not occur in it:

    frozen    the three axes of a sensor repeat their values in 10 rows or more, and in more rows
              than a sample and hold of a slower sensor explains (8 median runs). The value changes
              at an end of the run by at least a tenth of the median change elsewhere: simulated
              samples without noise that come to rest do not. A run from the first row on, as of a
              sensor at rest, ends in a change of 3 medians.
    zero      three forces of exactly 0: a vehicle is not in free fall.
    clipped   an axis has its largest (or smallest) value in 8 rows or more, 4 of these in a row,
              and 4 times as often as each of its next three values: a range ends there. The counts
              of a quantised sensor fall towards its extremes. Rows that repeat all axes, to a
              millionth of the median change, are not counted.
    spike     an axis differs from the median of 11 rows by more than 10 times the 98th percentile
              of such differences, 23 standard deviations of Gaussian noise, and by more than 3
              times the 98th percentile of differences from the median of all rows.

Rows with a fault measure nothing. Without them, a gap remains, whose uncertainty is known
(``ImuSlices``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.base.words import plural

__all__ = ["SampleFault", "faulty_rows", "sample_faults"]

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

FROZEN, HOLDS = 10, 8
CHANGE, FIRST_CHANGE = 0.1, 3.0
CLIPPED, CLIPPED_RUN, PILE, LEVELS = 8, 4, 4, 3
REPEATED = 1e-6
HALF, SPIKE, SWING, PERCENTILE = 5, 10.0, 3.0, 98.0

SENSORS = ("gyroscope", "accelerometer")
WORDS = {
    "frozen": "the {sensor} repeats one value in {count}",
    "zero": "the {sensor} measures exactly 0 in {count}",
    "clipped": "the {sensor} is at the end of its range in {count}",
    "spike": "the {sensor} jumps and returns in {count}",
}


@dataclass(frozen=True, eq=False)
class SampleFault:
    """A fault of one sensor.

    Attributes:
        kind: "frozen", "zero", "clipped" or "spike".
        sensor: "gyroscope" or "accelerometer".
        rows: rows of the samples with the fault, ascending.
    """

    kind: str
    sensor: str
    rows: Rows

    @property
    def first(self) -> int:
        """First row."""
        return int(self.rows[0])

    @property
    def last(self) -> int:
        """Last row."""
        return int(self.rows[-1])

    def sentence(self, stamps: NDArray[np.int64], place: Callable[[int], str]) -> str:
        """Describe the fault; ``place`` converts a row to text, times are since the first stamp."""
        begin, end = (1e-9 * float(stamps[row] - stamps[0]) for row in (self.first, self.last))
        words = WORDS[self.kind].format(sensor=self.sensor, count=plural(len(self.rows), "sample"))
        when = f"at {begin:.2f} s" if end - begin < 0.01 else f"from {begin:.2f} to {end:.2f} s"
        return f"{place(self.first)}: {words} ({when})"


def sample_faults(gyro: Array, accel: Array) -> tuple[SampleFault, ...]:
    """Return the faults of (n, 3) rates and (n, 3) forces, in the order of their first rows."""
    found: list[SampleFault] = []
    for sensor, values in zip(SENSORS, (np.asarray(gyro), np.asarray(accel)), strict=True):
        known = np.zeros(len(values), bool)
        for kind, runs in _KINDS.items():
            if kind == "zero" and sensor == "gyroscope":
                continue  # a quantised gyroscope at rest
            for rows in runs(values):
                if not known[rows].all():
                    found.append(SampleFault(kind, sensor, rows[~known[rows]]))
                    known[rows] = True
    return tuple(sorted(found, key=lambda fault: fault.first))


def faulty_rows(faults: Sequence[SampleFault], count: int) -> NDArray[np.bool_]:
    """Return (count,) True for rows with a fault."""
    faulty = np.zeros(count, bool)
    for fault in faults:
        faulty[fault.rows] = True
    return faulty


def _runs(rows: Rows) -> list[Rows]:
    """Return runs of consecutive rows."""
    return np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if len(rows) else []


def _zero(values: Array) -> list[Rows]:
    return _runs(np.flatnonzero((values == 0).all(axis=1)))


def _frozen(values: Array) -> Iterator[Rows]:
    changes = np.linalg.norm(np.diff(values, axis=0), axis=1)
    begin = np.r_[0, np.flatnonzero(changes) + 1]
    length = np.diff(np.r_[begin, len(values)])
    if len(begin) < 2:
        return
    typical = float(np.median(changes[changes > 0]))
    least = max(FROZEN, HOLDS * float(np.median(length)) + 1)
    for first, count in zip(begin.tolist(), length.tolist(), strict=True):
        last = first + count - 1
        before = changes[first - 1] if first else 0.0
        after = changes[last] if last < len(changes) else 0.0
        bound = CHANGE if first else FIRST_CHANGE
        if count >= least and max(before, after) >= bound * typical:
            yield np.arange(first, last + 1)


def _clipped(values: Array) -> Iterator[Rows]:
    changes = np.linalg.norm(np.diff(values, axis=0), axis=1)
    counted = np.r_[True, changes > REPEATED * np.median(changes)]
    clipped = np.zeros(len(values), bool)
    for axis in values.T:
        levels, counts = np.unique(axis[counted], return_counts=True)
        for limit, tally in ((levels[-1], counts[::-1]), (levels[0], counts)):
            if len(tally) <= LEVELS or tally[0] < max(CLIPPED, PILE * tally[1 : LEVELS + 1].max()):
                continue
            if max(map(len, _runs(np.flatnonzero(axis == limit)))) >= CLIPPED_RUN:
                clipped |= axis == limit
    if clipped.any():
        yield np.flatnonzero(clipped)


def _spikes(values: Array) -> Iterator[Rows]:
    padded = np.pad(values, ((HALF, HALF), (0, 0)), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * HALF + 1, axis=0)
    errors = np.abs(values - np.median(windows, axis=2))
    swings = np.abs(values - np.median(values, axis=0))
    bound = np.maximum(
        SPIKE * np.percentile(errors, PERCENTILE, axis=0),
        SWING * np.percentile(swings, PERCENTILE, axis=0),
    )
    at = np.flatnonzero(((errors > bound) & (bound > 0)).any(axis=1))
    if len(at):
        yield at


_KINDS = {"zero": _zero, "clipped": _clipped, "frozen": _frozen, "spike": _spikes}
