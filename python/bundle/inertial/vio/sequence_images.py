"""The images of a sequence: their stamps on the IMU's clock, their tracks, and the samples between.

Coordinates are normalised once.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from bundle.inertial.vio.imu_slices import ImuSlices
from bundle.inertial.vio.landmark_table import FrameTracks
from bundle.inertial.vio.track_numbers import sight_numbers
from bundle.inertial.vio.window_frame import ImuInterval
from bundle.model.sequence.sequence import Sequence

__all__ = ["SequenceImages"]

Array = np.ndarray[Any, Any]


class SequenceImages:
    """Images by their index, as :meth:`Sequence.frames` counts them.

    Args:
        sequence: IMU samples, tracks and calibration.
        rule: of preintegration, zero_order_hold or midpoint.

    Attributes:
        stamps: (n,) int64 ns on the IMU's clock.
        covered: (n,) whether samples reach the image.
        begin: (n + 1,) first observation of each.
        ids, xy: of all observations, xy normalised; ids are numbers in the order of first sight,
            ascending within an image.
        track_ids: the same tracks as the sequence names them.
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
        """Return what an image saw; velocities, since the image before, only if they are wanted."""
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
        """Return the samples between each two neighbours of some images."""
        return [self.interval(self.stamp(first), second) for first, second in pairwise(images)]

    def after(self, image: int, rate: float) -> list[int]:
        """Return the images beyond one, not closer in time than a rate in Hz allows."""
        chosen, last = [], self.stamps[image]
        for k in range(image + 1, len(self)):
            # Half a millisecond for cameras whose stamps jitter.
            if self.covered[k] and self.stamps[k] - last >= 1e9 / rate - 5e5:
                chosen.append(k)
                last = self.stamps[k]
        return chosen
