"""Rolling shutters given by options, on the cameras of a problem."""

from __future__ import annotations

import math

import numpy as np

from bundle.errors import InputError
from bundle.interface.options import SolveOptions
from bundle.interface.rolling_shutter_options import ShutterOptions
from bundle.model.problem import Problem
from bundle.model.rolling_shutter import RollingShutter

ESTIMATE = "estimate"
FIRST_READOUT = 0.5
"""Start of an estimated readout that the input does not have."""


def with_shutters(
    problem: Problem, given: ShutterOptions, options: SolveOptions
) -> tuple[Problem, SolveOptions]:
    """Return the problem with the given rolling shutters, and the options with the readout refined.

    Raises:
        InputError: the readout is no share of a frame, an option has no rolling shutter to change,
            or the file of times is wrong.
        OSError: the file of times cannot be read.
    """
    if not given.changed():
        return problem, options
    shutter = _directed(problem, given)
    if shutter is None:
        changed = next(iter(given.changed()))
        if given.rolling_shutter == "global":
            return problem.replace(rolling_shutter=None), options
        raise InputError(
            f"{changed}: expected a rolling shutter (rolling_shutter: rows or columns)"
        )
    readout = np.where(shutter.is_rolling, shutter.readout, np.nan)
    if given.readout == ESTIMATE:
        options = options.replace(refine_readout=True)
        readout[shutter.is_rolling & np.isnan(readout)] = FIRST_READOUT
    elif given.readout is not None:
        readout[shutter.is_rolling] = _share(given.readout, given.frame_rate)
    shutter = shutter.replace(readout=readout, row_time=given.row_time)
    if given.frame_rate > 0:
        shutter = shutter.replace(frame_rate=given.frame_rate)
    if given.frames is not None:
        from bundle.io.frame_times import read_frame_times  # only with a file of times

        frames, neighbours = read_frame_times(given.frames, problem, given.frame_rate)
        shutter = shutter.replace(frames=frames, neighbours=neighbours)
    return problem.replace(rolling_shutter=shutter), options


def _directed(problem: Problem, given: ShutterOptions) -> RollingShutter | None:
    """Return the shutters with the given direction; twists of the same direction stay."""
    known = problem.rolling_shutter
    if given.rolling_shutter == "input":
        return known
    if given.rolling_shutter == "global":
        return None
    used = np.bincount(problem.image_camera, minlength=problem.num_cameras) > 0
    direction = tuple(given.rolling_shutter if one else "global" for one in used.tolist())
    if known is None:
        return RollingShutter(direction=direction, twist=np.zeros((problem.num_images, 6)))
    same = np.array(known.direction) == np.array(direction)
    twist = known.twist * same[problem.image_camera, None]
    return known.replace(direction=direction, twist=twist)


def _share(text: str, frame_rate: float) -> float:
    """Return a readout as a share of the time between two frames."""
    unit = "seconds" if frame_rate > 0 else "a share of the time between two frames"
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    share = value * frame_rate if frame_rate > 0 else value
    if not 0 < share <= 1:
        most = f"{1 / frame_rate:.6g} seconds, the time of a frame" if frame_rate > 0 else "1"
        raise InputError(
            f"readout: expected {unit} above 0 and at most {most}, or {ESTIMATE}, found {text}"
        )
    return share
