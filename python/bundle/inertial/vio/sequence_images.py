"""Images of a sequence: stamps on the IMU's clock, tracks, and samples between them.

Coordinates are normalised once. IMU samples are interpolated at the stamps of images.

A gap is a time of 2.5 periods or more without a sample. Rate and force are interpolated linearly
over it, and their deviation is an additional uncertainty. Let s be the larger of their change and
of their standard deviation around the gap (twice its length on each side). A gap of T then adds an
uncertainty of s T to a rotation and of s T to a velocity.

Without its bad samples (:mod:`bundle.model.sequence.sequence_findings`) a sensor has a gap, too.
For a spike, s is at least its size: it may be an impact. Errors of clipped samples have one sign,
and their mean would remain in bias and scale. Waves around the end of the range have no curvature
there: a quintic with 0, slope and no curvature at both cuts continues them, its slopes those of
cubics on both sides. Of flights, it has 95 to 105 % of what runs below a second hide, and a cubic
four fifths. Longer runs have several peaks: none exceeds the extent of the other samples. Stretches
of more than two seconds are not changed, without an uncertainty unless they are clipped rates.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from bundle.errors import InputError
from bundle.inertial.vio.landmark_table import FrameTracks, sight_numbers
from bundle.inertial.vio.window_frame import ImuInterval
from bundle.model.sequence.sequence import Sequence
from bundle.model.sequence.sequence_findings import GAP, bad_stretches, is_bridged, runs_of

Array = np.ndarray[Any, Any]

AROUND = 2  # lengths of a gap on each side of it
LEAST_SIDE = 4  # samples on each side of a clipped run that determine three coefficients


class ImuSlices:
    """Intervals of a recording.

    Zero-order hold: a sample holds until the next one, so the first piece uses the sample at or
    before the begin of the interval. Midpoint: samples are interpolated at both ends of the
    interval.

    ``stamps`` ascend, in ns; ``rule`` is zero_order_hold or midpoint.
    """

    def __init__(self, stamps: Array, gyro: Array, accel: Array, rule: str) -> None:
        self.stamps, self.rule = stamps, rule
        steps = np.diff(stamps)
        self._gaps = np.flatnonzero(steps > GAP * np.median(steps)) if len(steps) else steps
        stretches = bad_stretches(gyro, accel)
        holes: list[tuple[int, int, int, float]] = []
        cleaned = []
        for sensor, values in enumerate((gyro, accel)):
            good = np.ones(len(stamps), bool)
            clipped = np.zeros(len(stamps), bool)
            ends = [(int(gap), int(gap) + 1, 0.0) for gap in self._gaps]
            for each in stretches:
                first, last = max(each.first - 1, 0), min(each.last + 1, len(stamps) - 1)
                if each.sensor == ("gyro", "accel")[sensor] and is_bridged(each, stamps):
                    ends.append((first, last, each.size))
                    good[each.first : each.last + 1] = not each.is_replaced
                    clipped[each.first : each.last + 1] = not each.is_replaced
            if not good.all() and good.any():
                columns = [np.interp(stamps, stamps[good], axis[good]) for axis in values.T]
                values = np.column_stack(columns)
            values = values + beyond_range(stamps, values, clipped)
            holes += [
                (int(stamps[first]), int(stamps[last]), sensor, self._variance(values, *each))
                for each in ends
                for first, last in [each[:2]]
            ]
            cleaned.append(values)
        self.gyro, self.accel = cleaned
        self._holes = holes

    def between(self, begin: int, end: int) -> ImuInterval:
        """Return the samples from one stamp to a later one."""
        if not (self.stamps[0] <= begin < end <= self.stamps[-1]):
            raise InputError(
                f"IMU: expected samples from {begin} to {end} ns, found {self.stamps[0]} to "
                f"{self.stamps[-1]}"
            )
        first = int(np.searchsorted(self.stamps, begin, "right")) - 1  # at or before the begin
        last = int(np.searchsorted(self.stamps, end, "left"))  # at or after the end
        edges = self.stamps[first : last + 1].copy()
        edges[0], edges[-1] = begin, end
        dt = 1e-9 * np.diff(edges)
        gaps = self._gaps[(self._gaps >= first) & (self._gaps < last)]
        doubt = self._doubt(begin, end)
        if self.rule == "zero_order_hold":
            gyro, accel = self.gyro[first:last], self.accel[first:last]
            if len(gaps):
                gyro, accel = gyro.copy(), accel.copy()
            for gap in gaps.tolist():
                middle = int(edges[gap - first] + edges[gap - first + 1]) // 2
                gyro[gap - first] = self._at(self.gyro, middle, gap)
                accel[gap - first] = self._at(self.accel, middle, gap)
            return ImuInterval(gyro, accel, dt, doubt)
        gyro, accel = self.gyro[first : last + 1].copy(), self.accel[first : last + 1].copy()
        for values, source in ((gyro, self.gyro), (accel, self.accel)):
            values[0] = self._at(source, begin, first)
            values[-1] = self._at(source, end, last - 1)
        return ImuInterval(gyro, accel, dt, doubt)

    def _variance(self, values: Array, first: int, last: int, size: float) -> float:
        """Return s^2 / 3 of a gap between two rows, per axis."""
        length = AROUND * (self.stamps[last] - self.stamps[first])
        near = slice(
            int(np.searchsorted(self.stamps, self.stamps[first] - length)),
            int(np.searchsorted(self.stamps, self.stamps[last] + length, "right")),
        )
        change = values[last] - values[first]
        spread = float(values[near].var(axis=0).sum())
        return max(float(change @ change), spread, size**2) / 3

    def _doubt(self, begin: int, end: int) -> tuple[float, float]:
        """Return the variances due to gaps within an interval."""
        variances = [0.0, 0.0]
        for first, last, sensors, variance in self._holes:
            part = 1e-9 * (min(last, end) - max(first, begin))
            if part > 0:
                variances[sensors] += variance * part**2
        return variances[0], variances[1]

    def _at(self, values: Array, stamp: int, before: int) -> Array:
        a, b = self.stamps[before], self.stamps[before + 1]
        share = float(stamp - a) / float(b - a)
        between: Array = (1 - share) * values[before] + share * values[before + 1]
        return between


def beyond_range(stamps: Array, values: Array, clipped: Array) -> Array:
    """Return the part of samples (n, 3) that the sensor cuts off, where rows are clipped."""
    hidden, seconds = np.zeros_like(values), 1e-9 * (stamps - stamps[0])
    for k, axis in enumerate(values.T):
        for most, sign in ((axis.min(), -1.0), (axis.max(), 1.0)):
            cut = (axis == most) & clipped
            for first, last in runs_of(cut).tolist():
                if first in (0, last) or last == len(axis) - 1:
                    continue
                cuts = (seconds[[first, last]] + seconds[[first - 1, last + 1]]) / 2
                near, curve = max((last - first) // 2, LEAST_SIDE), np.zeros(last + 1 - first)
                sides = range(max(first - near, 0), first), range(last + 1, last + 1 + near)
                for rows, begin, end in zip(sides, cuts, cuts[::-1], strict=True):
                    free = [row for row in rows if row < len(axis) and not cut[row]]
                    inwards = (seconds[free, None] - begin) / (end - begin)
                    cubic = np.linalg.lstsq(inwards ** [1, 2, 3], axis[free] - most, rcond=None)[0]
                    s = (seconds[first : last + 1] - begin) / (end - begin)
                    curve += cubic[0] * s * (1 - s) ** 3 * (1 + 3 * s)
                hidden[first : last + 1, k] = sign * np.clip(sign * curve, 0.0, np.ptp(axis))
    return hidden


class SequenceImages:
    """Images by their index in :meth:`Sequence.frames`.

    ``stamps``: (n,) ns on the IMU's clock; ``covered``: within the samples; ``begin``: (n + 1,)
    first observation of each; ``ids``, ``xy``: track numbers, by first appearance and ascending
    within an image, and normalised coordinates; ``track_ids``: ids of these tracks in the sequence.
    """

    def __init__(self, sequence: Sequence, rule: str = "zero_order_hold") -> None:
        self.sequence = sequence
        samples = sequence.imu_timestamps_ns
        self._slices = ImuSlices(samples, sequence.gyro, sequence.accel, rule)
        _, self.begin = sequence.frames()
        self.stamps = sequence.image_timestamps_ns[self.begin[:-1]]
        self.covered = (self.stamps >= samples[0]) & (self.stamps <= samples[-1])
        image = np.repeat(np.arange(len(self.stamps)), np.diff(self.begin))
        numbers = sight_numbers(image, sequence.track_ids, sequence.xy)
        order = np.lexsort((numbers, image))
        self.ids, self.track_ids = numbers[order], sequence.track_ids[order]
        self.xy = sequence.normalized()[order]

    def __len__(self) -> int:
        return len(self.stamps)

    def stamp(self, image: int) -> int:
        """Return the time of an image, ns."""
        return int(self.stamps[image])

    def rows(self, image: int) -> slice:
        """Return the observations of an image."""
        return slice(self.begin[image], self.begin[image + 1])

    def tracks(self, image: int, velocities: bool = False) -> FrameTracks:
        """Return the tracks of an image; velocities since the previous image if requested."""
        rows = self.rows(image)
        ids, xy = self.ids[rows], self.xy[rows]
        velocity = np.zeros_like(xy)
        if velocities and image > 0:
            before = self.rows(image - 1)
            _, a, b = np.intersect1d(ids, self.ids[before], assume_unique=True, return_indices=True)
            seconds = 1e-9 * float(self.stamps[image] - self.stamps[image - 1])
            velocity[a] = (xy[a] - self.xy[before][b]) / seconds
        return FrameTracks(ids, xy, velocity)

    def interval(self, since: int, image: int) -> ImuInterval:
        """Return the samples from a stamp to an image."""
        return self._slices.between(since, self.stamp(image))

    def intervals(self, images: list[int]) -> list[ImuInterval]:
        """Return the samples between consecutive images of a selection."""
        return [self.interval(self.stamp(first), second) for first, second in pairwise(images)]

    def after(self, image: int, rate: float) -> list[int]:
        """Return the images after an image, thinned out to at most `rate` per second."""
        chosen, last = [], self.stamps[image]
        for k in range(image + 1, len(self)):
            # Half a millisecond of tolerance for cameras with jittering stamps.
            if self.covered[k] and self.stamps[k] - last >= 1e9 / rate - 5e5:
                chosen.append(k)
                last = self.stamps[k]
        return chosen
