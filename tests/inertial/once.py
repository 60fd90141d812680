"""Rotations of tracks and linear starts, computed once for a flight that many tests ask for."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
import pytest

from bundle.inertial.tracking import relative_rotation, sequence_axes
from bundle.inertial.tracking.relative_rotation import APART, Turn
from bundle.inertial.vio.initialize import Span
from bundle.inertial.vio.sequence_images import SequenceImages

turns_of_tracks, start_of = relative_rotation.turns_of_tracks, sequence_axes._start
known: dict[Any, Any] = {}


def compute_once(patch: pytest.MonkeyPatch) -> None:
    """Let the tests of axes, rates and stamps compute nothing twice."""
    patch.setattr(sequence_axes, "_start", start_once)
    patch.setattr(sequence_axes, "turns_of_tracks", turns_once)


def digest(images: SequenceImages, *arrays: np.ndarray[Any, Any]) -> str:
    """Return a digest of tracks, rates, calibration and further arrays."""
    given = images.sequence
    found = hashlib.sha256(repr(given.calibration).encode())
    for array in (given.imu_timestamps_ns, given.gyro, given.track_timestamps_ns, given.track_ids):
        found.update(array.tobytes())
    for array in (given.xy, *arrays):
        found.update(array.tobytes())
    return found.hexdigest()


def turns_once(images: SequenceImages, most: int, apart: float = APART) -> list[Turn]:
    """Compute turns once: forces have no part in them."""
    key = digest(images), most, apart
    if key not in known:
        known[key] = turns_of_tracks(images, most, apart)
    return list(known[key])


def start_once(images: SequenceImages, span: Span) -> Any:
    """Compute the start of a span once for all flights with these samples."""
    key = digest(images, images.sequence.accel, span.images)
    if key not in known:
        known[key] = start_of(images, span)
    return known[key]
