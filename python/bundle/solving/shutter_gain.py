"""Rolling shutters of a result, and their gain over the input with global ones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from bundle.model.problem import Problem
    from bundle.solving.measured_result import MeasuredResult as Result


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
    twist = shutter.twist[shutter.is_rolling[result.problem.image_camera]]
    squares = (twist**2).reshape(-1, 2, 3).sum(axis=2).mean(axis=0) if len(twist) else (0.0, 0.0)
    return ShutterGain(
        result.rmse_global_shutters,
        result.reprojection_error_after.rmse,
        float(np.degrees(np.sqrt(squares[0]))),
        float(np.sqrt(squares[1])),
    )


def known_readouts(before: Problem, output: Mapping[str, Any]) -> tuple[Mapping[str, Any], str]:
    """Return the core's output without readouts that no camera can have, and a warning or "".

    Such a readout becomes unknown (NaN).
    """
    if "readout" not in output:
        return output, ""
    readout = np.array(output["readout"])
    outside = ~np.isnan(readout) & ~((readout > 0) & (readout <= 1))
    if not outside.any():
        return output, ""
    camera = int(np.argmax(outside))
    warning = (
        f"The readout of camera {before.camera_ids[camera]} ended at {readout[camera]:.4g} of "
        "a frame, outside of 0 to 1: the images and ties do not determine it, or ties or times "
        "are wrong."
    )
    readout[outside] = np.nan
    return {**output, "readout": readout}, warning
