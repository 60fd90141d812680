"""When a frame becomes a keyframe: each reason, and none without translation."""

from __future__ import annotations

import numpy as np
import pytest

from bundle.inertial.vio.keyframe_record import keyframe_reason
from bundle.inertial.vio.landmark_table import FrameTracks
from bundle.interface.window_options import WindowOptions

OPTIONS = WindowOptions(min_parallax=30.0, min_tracks=10, max_interval=0.5, min_translation=0.02)
FOCAL = 400.0


def tracks(count: int, shift: float = 0.0, first: int = 0) -> FrameTracks:
    ids = np.arange(first, first + count)
    xy = np.c_[0.01 * ids + shift, np.zeros(count)]
    return FrameTracks(ids, xy, np.zeros_like(xy))


@pytest.mark.parametrize(
    ("count", "pixels", "translation", "seconds", "reason"),
    [
        (20, 40.0, 0.1, 0.1, "parallax"),
        (20, 20.0, 0.1, 0.1, ""),
        (5, 20.0, 0.1, 0.1, "tracks"),
        (20, 20.0, 0.1, 0.6, "time"),
        (20, 40.0, 0.01, 0.6, ""),  # turned, not moved
        (0, 0.0, 0.1, 0.1, "tracks"),
    ],
)
def test_reasons(
    count: int, pixels: float, translation: float, seconds: float, reason: str
) -> None:
    found, parallax = keyframe_reason(
        tracks(count), tracks(count, pixels / FOCAL), FOCAL, translation, seconds, OPTIONS
    )
    assert found == reason
    assert parallax == pytest.approx(pixels)


def test_parallax_is_that_of_common_tracks() -> None:
    last, new = tracks(30), tracks(30, 0.25, first=15)
    assert keyframe_reason(last, new, FOCAL, 1.0, 0.1, OPTIONS) == ("parallax", 100.0)
