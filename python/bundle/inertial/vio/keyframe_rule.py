"""When a frame becomes a keyframe, and why.

Depth is known to sigma_z / z = sigma_d / d for a parallax d: at f = 460 px and sigma_d = 0.5 px,
10 px are 5 %. A frame that adds less only costs time, unless tracks run out or the IMU is
integrated for too long. Without translation there is no parallax, whatever the image does: nothing
is added.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bundle.inertial.vio.landmark_table import FrameTracks
from bundle.interface.window_options import WindowOptions

__all__ = ["keyframe_reason"]

Array = np.ndarray[Any, Any]


def keyframe_reason(
    last: FrameTracks,
    new: FrameTracks,
    focal: float,
    translation: float,
    seconds: float,
    options: WindowOptions,
) -> tuple[str, float]:
    """Return why the new frame is a keyframe, "" if it is none, and the median parallax in pixels.

    Args:
        last: tracks of the last keyframe.
        new: tracks of the frame.
        focal: pixels per unit of normalised coordinates.
        translation: distance between both, metres.
        seconds: time between both.
        options: the bounds.
    """
    _, a, b = np.intersect1d(last.ids, new.ids, assume_unique=True, return_indices=True)
    parallax = 0.0
    if len(a):
        parallax = focal * float(np.median(np.linalg.norm(new.xy[b] - last.xy[a], axis=1)))
    if translation < options.min_translation:
        return "", parallax
    if parallax > options.min_parallax:
        return "parallax", parallax
    if len(a) < options.min_tracks:
        return "tracks", parallax
    if seconds > options.max_interval:
        return "time", parallax
    return "", parallax
