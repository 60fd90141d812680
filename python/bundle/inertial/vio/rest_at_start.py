"""How long a sequence rests at its begin, as its tracks and its samples say.

A vehicle is at rest as long as its tracks stay where they were first seen, to within their noise,
and the mean rate stays what it was. Samples alone do not tell: rotors that spin on the ground shake
an accelerometer by more than slow flight moves it.

Two positions of a track, each with noise s in both coordinates, are 1.7 s apart in the median.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bundle.inertial.vio.sequence_images import SequenceImages

__all__ = ["rest_at_start"]

REST_SIGMAS = 3.0  # median displacement of the tracks; noise alone gives 1.7
FEWEST_TRACKS = 4
REST_RATE = 0.03  # rad/s: change of the mean rate
REST_WINDOW = 0.5  # s, of that mean


def rest_at_start(images: SequenceImages) -> tuple[int, int]:
    """Return the last image at rest and how many samples at the begin are at rest.

    The image is the first one that samples cover, and there are no samples, where the sequence
    begins in motion.
    """
    sequence = images.sequence
    first = int(np.argmax(images.covered))
    last = _last_still_image(images, first)
    stamps, gyro = sequence.imu_timestamps_ns, sequence.gyro
    end = int(images.stamps[last])
    samples = int(np.searchsorted(stamps, end, side="right")) if last > first else 0
    size = int(np.searchsorted(stamps, stamps[0] + round(1e9 * REST_WINDOW)))
    if samples < size or size < 2:
        return first, 0
    means = gyro[: samples // size * size].reshape(-1, size, 3).mean(axis=1)
    turned = np.flatnonzero(np.abs(means - means[0]).max(axis=1) > REST_RATE)
    if len(turned):
        samples = int(turned[0]) * size
        still = np.flatnonzero(images.stamps <= stamps[samples - 1])
        last = max(first, int(still[-1])) if len(still) else first
    return last, samples


def _last_still_image(images: SequenceImages, first: int) -> int:
    calibration = images.sequence.calibration
    rows = slice(int(images.begin[first]), None)
    xy: Any = calibration.focal * images.xy[rows]
    _, seen, track = np.unique(images.ids[rows], return_index=True, return_inverse=True)
    moved = np.linalg.norm(xy - xy[seen[track]], axis=1)
    is_seen_again = seen[track] != np.arange(len(xy))
    begin = images.begin - images.begin[first]
    last = first
    for image in range(first + 1, len(images)):
        rows = slice(begin[image], begin[image + 1])
        again = is_seen_again[rows]
        if not images.covered[image] or again.sum() < FEWEST_TRACKS:
            break
        if np.median(moved[rows][again]) > REST_SIGMAS * calibration.pixel_sigma:
            break
        last = image
    return last
