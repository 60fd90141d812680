"""Samples of an IMU between the images of a video, times of images, offset of their clocks."""

from __future__ import annotations

import math
import os
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bundle.base.paths import numbered_lines
from bundle.base.words import plural
from bundle.errors import InputError, brief, shown
from bundle.inertial.offline.imu_agreement import MOST, ClockErrors, ClockOffset, clock_offset
from bundle.inertial.offline.inertial_result import ImuSamples
from bundle.inertial.offline.inertial_start import gyro_bias, preintegrated
from bundle.inertial.preintegration.preintegration import Preintegration
from bundle.inertial.vio.sequence_images import ImuSlices
from bundle.inertial.vio.window_frame import ImuInterval
from bundle.model.problem import Problem
from bundle.model.rigid_motions import quaternion_from_matrix, vector_from_quaternion
from bundle.model.sequence.calibration import ImuNoise
from bundle.model.sequence.sequence import check_imu, other_unit

Array = NDArray[np.float64]

RULES = {"instant": "midpoint", "interval": "zero_order_hold"}
"""Rule of preintegration for samples at their stamps, and for means over the interval that follows:
taken for samples, these are late by half a period, and motions off by many sigmas."""
CLEAR = 8.0
"""Difference of log-likelihoods that determines the kind of samples, or an offset of the clocks."""
FAR, FAR_STEP = 60.0, 0.02  # s: offsets that are only named; most images must stay within samples
FAR_SHARE = 0.1  # share of the variance of rotations that such an offset may leave unexplained


class ImageIntervals:
    """Intervals between images, at any offset of the clocks.

    ``stamps``: (n,) times of images, ascending, within the samples; ``kind``: of the samples.
    """

    def __init__(
        self, samples: ImuSamples, stamps: NDArray[np.int64], kind: str = "instant"
    ) -> None:
        check_imu(*samples, lambda row: f"IMU sample {row}")
        first, last = int(samples.timestamps_ns[0]), int(samples.timestamps_ns[-1])
        outside = (stamps < first) | (stamps > last)
        if outside.any():
            found = int(stamps[np.flatnonzero(outside)[0]])
            count = int(outside.sum())
            how = f"{plural(count, 'image')} {'is' if count == 1 else 'are'}"
            how = "all images are" if outside.all() else how
            hint = other_unit(stamps, samples.timestamps_ns) or ": do both clocks agree?"
            raise InputError(
                f"imu: expected images between the samples ({first} to {last} ns), found {found}: "
                f"{how} outside{hint}"
            )
        steps = np.flatnonzero(np.diff(stamps) <= 0)
        if len(steps):
            raise InputError(
                f"imu: expected images at different times, found {int(stamps[steps[0]])} ns twice"
            )
        self.kind, self.rule = kind, RULES[kind]
        self._stamps = stamps
        self._slices = ImuSlices(*samples, self.rule)
        self._longer = ImuSlices(*_extended(samples), self.rule)

    def at(self, offset: float) -> list[ImuInterval]:
        """Return the samples between images at an offset [s]; the first and last are extended."""
        slices = self._slices if offset == 0 else self._longer
        return [slices.between(a, b) for a, b in pairwise(self._moved(offset).tolist())]

    def offset(self, between: Array, noise: ImuNoise) -> ClockOffset:
        """Return the offset of the clocks from the rotations (n - 1, 3, 3) between images."""

        def motions_at(offset: float, bias: Array) -> list[Preintegration]:
            return preintegrated(self.at(offset), noise, np.append(bias, np.zeros(3)), self.rule)

        return clock_offset(between, motions_at, self._rates_at)

    def far_offset(self, between: Array) -> str:
        """Return a sentence on an offset beyond MOST at which rotations (n - 1, 3, 3) agree."""
        stamps, gyro = self._slices.stamps, self._slices.gyro
        times, images = (1e-9 * (one - stamps[0]) for one in (stamps, self._stamps))
        angles = np.cumsum(np.gradient(times)[:, None] * gyro, axis=0)
        turns = vector_from_quaternion(quaternion_from_matrix(between))
        best = FAR_SHARE, 0.0
        for offset in np.arange(-FAR, FAR, FAR_STEP):
            at = images + offset
            inside = (at[:-1] >= 0) & (at[1:] <= times[-1])
            if 2 * inside.sum() > len(turns):
                turned = np.stack([np.interp(at, times, axis) for axis in angles.T], axis=1)
                errors = (turns - np.diff(turned, axis=0))[inside]
                left, whole = (float(one.var(axis=0).sum()) for one in (errors, turns[inside]))
                best = (left / whole, float(offset)) if left < best[0] * whole else best
        words = f"the clocks of camera and IMU differ by {best[1]:.2f} s: add it to time_offset"
        return words if abs(best[1]) > MOST else ""

    def clock_errors(self, between: Array, noise: ImuNoise, clock: ClockOffset) -> ClockErrors:
        """Return the errors of single times that remain with an offset of the clocks."""
        offset = clock.seconds if clock.is_clear else 0.0
        bias = gyro_bias(between, self.at(offset), noise, self.rule)
        motions = preintegrated(self.at(offset), noise, np.append(bias, np.zeros(3)), self.rule)
        deltas = np.array([motion.delta_rotation for motion in motions])
        errors = vector_from_quaternion(quaternion_from_matrix(np.swapaxes(deltas, 1, 2) @ between))
        times = 1e-9 * (self._stamps - self._stamps[0])
        return ClockErrors.of(errors, self._rates_at(offset) - bias, deltas, times)

    def _rates_at(self, offset: float) -> Array:
        slices = self._longer
        origin = int(slices.stamps[0])  # differences of times are exact in double precision
        places = (self._moved(offset) - origin).astype(np.float64)
        times = (slices.stamps - origin).astype(np.float64)
        return np.stack([np.interp(places, times, axis) for axis in slices.gyro.T], axis=1)

    def _moved(self, offset: float) -> NDArray[np.int64]:
        return self._stamps + round(1e9 * offset)


def likely_kinds(instant: ClockOffset, interval: ClockOffset) -> tuple[str, ...]:
    """Return the likely kinds of samples, from the clock offset that each kind implies."""
    if instant.is_clear and interval.is_clear:
        return ("instant",)  # the offset takes the difference
    if not (math.isfinite(instant.sigma) and math.isfinite(interval.sigma)):
        return tuple(RULES)
    squares = [(one.seconds / one.sigma) ** 2 for one in (instant, interval)]
    if abs(squares[0] - squares[1]) < 2 * CLEAR:
        return tuple(RULES)
    return ("instant",) if squares[0] < squares[1] else ("interval",)


def _extended(samples: ImuSamples) -> ImuSamples:
    """Return the samples with copies of the first and the last one, MOST seconds further out."""
    stamps, reach = samples.timestamps_ns, round(1e9 * MOST) + 1
    return ImuSamples(
        np.concatenate([stamps[:1] - reach, stamps, stamps[-1:] + reach]),
        *(np.concatenate([rows[:1], rows, rows[-1:]]) for rows in (samples.gyro, samples.accel)),
    )


# Times of a reconstruction's images, from a file with a line for each frame of a video.
#
# Lines have the name of an image and its time in nanoseconds, between blanks, tabs or a comma;
# lines that begin with ``#`` and a header are ignored. The times ascend from line to line; images
# of a rig may have the same time. Frames that are not in the reconstruction are ignored.

LIMIT = 2**63


def read_image_times(path: str | os.PathLike[str], problem: Problem) -> NDArray[np.int64]:
    """Return the (n,) times of the problem's images in nanoseconds."""
    times: dict[str, int] = {}
    last: tuple[int, int] | None = None
    for number, line in numbered_lines(path):
        text = line.strip()
        if not text or text.startswith("#"):
            continue
        place = f"{shown(path)}: line {number}"
        name, _, word = text.replace(",", " ").replace("\t", " ").rpartition(" ")
        name = name.strip().strip('"')
        is_stamp = word.isascii() and word.lstrip("-").isdigit() and len(word) < 20
        if not is_stamp or not name or not -LIMIT < int(word) < LIMIT:
            if not times and last is None and not any(c.isdigit() for c in word):
                continue  # a header
            raise InputError(
                f"{place}: expected the name of an image and nanoseconds, found {brief(text)}"
            )
        stamp = int(word)
        if last is not None and stamp < last[1]:
            raise InputError(
                f"{place}: expected at least {last[1]} ns, the time in line {last[0]}, "
                f"found {stamp}"
            )
        if name in times:
            raise InputError(
                f"{place}: expected one line for each image, found {brief(name)} again"
            )
        times[name] = stamp
        last = number, stamp
    if not times:
        raise InputError(f"{shown(path)}: expected lines of name and nanoseconds, found 0")
    missing = [name for name in problem.image_names if name not in times]
    if missing:
        raise InputError(
            f"{shown(path)}: expected a time for each image of the model, found no time of "
            f"{plural(len(missing), 'image')} such as {brief(missing[0])}"
        )
    return np.array([times[name] for name in problem.image_names], np.int64)
