"""Rolling shutters of a result, and their gain over the input with global ones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bundle.model.reprojection import reprojection_error
from bundle.model.rolling_shutter import RollingShutter

if TYPE_CHECKING:
    from bundle.model.problem import Problem
    from bundle.solving.measured_result import MeasuredResult as Result

__all__ = ["ShutterGain", "refined_shutter", "shutter_gain"]


class ShutterGain(NamedTuple):
    """RMSE before and after, and the size of the twists.

    Attributes:
        rmse_global: RMSE of the input if all shutters were global, pixels.
        rmse: RMSE of the result, pixels.
        turn: root mean square rotation of a twist, degrees per frame height.
        shift: root mean square translation of a twist, in the length unit.
    """

    rmse_global: float
    rmse: float
    turn: float
    shift: float


def shutter_gain(result: Result) -> ShutterGain | None:
    """Return the gain of a result; None without rolling shutters."""
    shutter = result.problem.rolling_shutter
    if shutter is None or not shutter.is_rolling.any():
        return None
    cheirality = result.options.cheirality
    before = result.initial_problem.replace(rolling_shutter=None)
    twist = shutter.twist[shutter.is_rolling[result.problem.image_camera]]
    squares = (twist**2).reshape(-1, 2, 3).sum(axis=2).mean(axis=0) if len(twist) else (0.0, 0.0)
    return ShutterGain(
        reprojection_error(before, cheirality).rmse,
        result.reprojection_error_after.rmse,
        float(np.degrees(np.sqrt(squares[0]))),
        float(np.sqrt(squares[1])),
    )


def refined_shutter(before: Problem, output: Mapping[str, Any]) -> tuple[RollingShutter, str]:
    """Return the rolling shutter of the core's output, and a warning or "".

    A readout that no camera can have is unknown (NaN) in the result.
    """
    shutter = before.rolling_shutter
    assert shutter is not None
    readout = np.array(output["readout"])
    outside = ~np.isnan(readout) & ~((readout > 0) & (readout <= 1))
    warning = ""
    if outside.any():
        camera = int(np.argmax(outside))
        warning = (
            f"The readout of camera {before.camera_ids[camera]} ended at {readout[camera]:.4g} of "
            "a frame, outside of 0 to 1: the images and ties do not determine it, or ties or times "
            "are wrong."
        )
        readout[outside] = np.nan
    return shutter.replace(twist=output["twist"], readout=readout), warning
