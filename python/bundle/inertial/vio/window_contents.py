"""Contents of a sliding window, and their arrays for the core."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from bundle.inertial.vio.landmark_table import LandmarkTable
from bundle.inertial.vio.marginal_prior import MarginalPrior
from bundle.inertial.vio.window_frame import WindowFrame
from bundle.interface.window_options import WindowOptions
from bundle.model.sequence.calibration import ImuNoise

Array = np.ndarray[Any, Any]


class WindowContents(Protocol):
    """Protocol of the attributes of a :class:`bundle.SlidingWindow` that its parts use."""

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
        """States of the frames (n, 16)."""


def window_arrays(window: WindowContents, table: LandmarkTable, points: Array) -> dict[str, Any]:
    """Return the window in the core's format, without priors."""
    states = window.states
    first_estimates = window.options.jacobians == "first_estimate"
    anchored = [first_estimates and frame.anchor is not None for frame in window.frames]
    anchors = [frame.state if frame.anchor is None else frame.anchor for frame in window.frames]
    return {
        "states": states,
        "anchors": np.array(anchors),
        "anchored": np.array(anchored, np.uint8),
        "camera_from_imu": window.camera_from_imu,
        "time_offset": window.time_offset,
        "refine_camera": window.options.refine_extrinsics,
        "refine_time_offset": window.options.refine_time_offset,
        "points": points,
        "anchor_states": table.anchors,
        "anchor_xy": table.anchor_xy,
        "anchor_velocity": table.anchor_velocity,
        "landmarks": table.landmarks,
        "observers": table.observers,
        "xy": table.xy,
        "xy_velocity": table.velocity,
        "sigma": window.sigma,
        "loss": window.options.loss,
        "loss_scale": window.options.loss_scale,
        "gravity": window.gravity,
        "imu": [frame.inertia.core_motion() for frame in window.frames[1:] if frame.inertia],
    }
