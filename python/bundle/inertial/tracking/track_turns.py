"""Rotations of the camera by the tracks of a sequence, without the IMU.

A rotation is the Gauss-Newton optimum of :func:`refined_rotation`. Its initial value ignores the
translation: the rotation that takes the rays of one image to those of the other (Kabsch), with
robust weights. The initial direction of the translation is perpendicular to the normals of the
planes through corresponding rays.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bundle.inertial.tracking.feature_tracker import Turn
from bundle.inertial.tracking.relative_rotation import refined_rotation
from bundle.inertial.tracking.rotation_check import kabsch
from bundle.inertial.vio.sequence_images import SequenceImages

Array = np.ndarray[Any, Any]

APART = 0.25  # s between the images of a pair
FEWEST = 12  # common tracks


def turns_of_tracks(images: SequenceImages, most: int, apart: float = APART) -> list[Turn]:
    """Return rotations between images that are some seconds apart, as of a recording's images."""
    stamps, covered = images.stamps, np.flatnonzero(images.covered)
    sigma = images.sequence.calibration.pixel_sigma / images.sequence.calibration.focal
    earlier = covered
    if len(earlier) > most:
        earlier = earlier[np.linspace(0, len(earlier) - 1, most).round().astype(int)]
    turns = []
    for first in earlier.tolist():
        second = int(np.searchsorted(stamps, stamps[first] + round(1e9 * apart)))
        if second > covered[-1]:
            break
        one, other = images.tracks(first), images.tracks(second)
        _, a, b = np.intersect1d(one.ids, other.ids, assume_unique=True, return_indices=True)
        if len(a) < FEWEST or stamps[second] - stamps[first] > 2e9 * apart:
            continue
        rays = [np.column_stack([xy, np.ones(len(xy))]) for xy in (one.xy[a], other.xy[b])]
        x, y = (each / np.linalg.norm(each, axis=1, keepdims=True) for each in rays)
        rotation = kabsch(y, x)
        normals = np.cross(y, x @ rotation.T)
        direction = np.linalg.svd(normals)[2][2]
        rotation = refined_rotation(one.xy[a], other.xy[b], rotation, direction, sigma)
        turns.append(Turn(first - int(covered[0]), second - int(covered[0]), rotation))
    return turns
