"""What the parts of a sliding window see of it."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from bundle.inertial.vio.marginal_prior import MarginalPrior
from bundle.inertial.vio.window_frame import WindowFrame
from bundle.interface.window_options import WindowOptions
from bundle.model.sequence.imu_noise import ImuNoise

__all__ = ["WindowContents"]

Array = np.ndarray[Any, Any]


class WindowContents(Protocol):
    """A :class:`bundle.SlidingWindow`, whose attributes these are."""

    options: WindowOptions
    frames: list[WindowFrame]
    prior: MarginalPrior | None
    camera_from_imu: Array
    time_offset: float
    gravity: Array
    noise: ImuNoise
    sigma: float

    @property
    def states(self) -> Array:
        """Of the frames (n, 16)."""
