"""Rolling shutters given by options, and observations as a global shutter would have read them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import pixels, plural
from bundle.errors import InputError
from bundle.interface.camera_edit_options import ShutterOptions
from bundle.interface.options import SolveOptions
from bundle.io.files import Source, as_problem
from bundle.model.problem import Problem
from bundle.model.rigid_motions import quaternion_rotate
from bundle.model.rolling_shutter import RollingShutter
from bundle.model.shutter_motion import moved, project_each, read_positions

ESTIMATE = "estimate"
FIRST_READOUT = 0.5  # start of an estimated readout that the input does not have


def with_shutters(
    problem: Problem, given: ShutterOptions, options: SolveOptions
) -> tuple[Problem, SolveOptions]:
    """Return the problem with the given rolling shutters, and options that refine the readout."""
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
        from bundle.io.rolling_shutter_file import read_frame_times  # only with a file of times

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


# Observations of a rolling shutter, moved to where a global shutter would have read them.
#
# Programs that know only global shutters need observations that belong to one pose per image. With
# the twist m of an image, its pose T (that of the middle row) and a point X, an observation z that
# was read at the time s (:mod:`bundle.model.shutter_motion`) moves by
#
#     z' = z + pi(T X) - pi(Exp(s m) T X).
#
# The residual of every observation stays: pi(T X) - z' = pi(Exp(s m) T X) - z, so the RMSE of the
# moved model under a global shutter is that of the model under its rolling shutter.
#
# Error to first order. Let d pi / ds be the image motion per readout, a its share of the height. A
# point that is displaced by e on the image, or a pose by its equivalent, changes the move by the
# derivative of the image motion along e, a small fraction of a e. A twist with the error dm moves
# the observation by an error
#
#     e' = -s (d pi / dm) dm,
#
# at most half of the motion's error during the readout, zero at the middle row. These errors are
# common to an image. The minimum without a rolling shutter differs from that with it by
#
#     dx = -H^-1 sum J_0^T r,    J_0 = J_s + O(a),    sum (C^-1 J_s)^T r = 0,    C = I - a e_y^T,
#
# with J_s the derivative at the time s, r the residuals, and H the normal equations. So dx is a
# times an ordinary error of estimation, at most: seeded walks, drives and flights with a from 0.015
# to 0.1 differ by 0.001 to 0.015 sigma. A covariance of the moved model holds the twists for known,
# and is too small by what their estimation costs.


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class GlobalShutterModel(Displayed):
    """A problem without a rolling shutter, and how far its observations were moved.

    Attributes:
        problem: the problem with moved observations.
        shift: (num_observations, 2) move of each observation [pixels]; zero for global shutters.
        num_moved: number of moved observations.
        num_left: number of observations of rolling shutters that stay, because their point has no
            projection.
        motion: rms image motion during the readout, as a share of the height (of the width, for
            columns).
    """

    problem: Problem
    shift: NDArray[np.float64]
    num_moved: int
    num_left: int
    motion: float

    @property
    def largest(self) -> float:
        """Largest move [pixels]."""
        return float(np.hypot(*self.shift.T).max(initial=0.0))

    @property
    def median(self) -> float:
        """Median move of the moved observations [pixels]; 0 without any."""
        lengths = np.hypot(*self.shift.T)
        return float(np.median(lengths[lengths > 0])) if (lengths > 0).any() else 0.0

    def _display(self) -> Display:
        facts = (
            ("moved", plural(self.num_moved, "observation")),
            ("median move", f"{pixels(self.median)} px"),
            ("largest move", f"{pixels(self.largest)} px"),
        )
        return Display(title="GlobalShutterModel", facts=facts)


def to_global_shutter(problem: Source) -> GlobalShutterModel:
    """Move the observations of rolling shutters to where a global shutter would have read them.

    Poses, points and cameras stay; residuals stay, too. Solve with the rolling shutter first: the
    moves are those of the present twists, poses and points.

    Args:
        problem: Problem, path of one, or pycolmap.Reconstruction; not modified.

    Raises:
        InputError: no camera has a rolling shutter.
        OSError: the path cannot be read.

    Example:
        >>> fixed = bundle.to_global_shutter("refined")
        >>> bundle.save(fixed.problem, "for_colmap")
    """
    problem = as_problem(problem)
    shutter = problem.rolling_shutter
    if shutter is None or not shutter.is_rolling.any():
        raise InputError(
            "problem: expected cameras with a rolling shutter (rolling_shutter.json), found global "
            "shutters only"
        )
    axis = shutter.axis[problem.image_camera].astype(np.int64)
    rows = np.flatnonzero(axis[problem.observation_image] > 0)
    image = problem.observation_image[rows]
    pose = problem.cam_from_world[image]
    unit = pose[:, :4] / np.linalg.norm(pose[:, :4], axis=1, keepdims=True)
    local = quaternion_rotate(unit, problem.points[problem.observation_point[rows]]) + pose[:, 4:]
    coordinate = 2 - axis[image]  # y for rows, x for columns
    read = _read(problem, shutter, rows, local, coordinate)
    still = project_each(problem, image, local)
    step = still - read
    known = np.isfinite(step).all(axis=1)
    shift = np.zeros((problem.num_observations, 2))
    shift[rows[known]] = step[known]
    return GlobalShutterModel(
        problem=problem.replace(
            observation_xy=problem.observation_xy + shift, rolling_shutter=None
        ),
        shift=shift,
        num_moved=int(known.sum()),
        num_left=int((~known).sum()),
        motion=_motion(problem, shutter, image[known], local[known], coordinate[known]),
    )


def _read(
    problem: Problem,
    shutter: RollingShutter,
    rows: NDArray[np.int64],
    local: NDArray[np.float64],
    coordinate: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Return where the shutter reads points, at the fixed point or at the observed row."""
    image = problem.observation_image[rows]
    twists = shutter.twist[image]
    if shutter.row_time != "observed":
        return read_positions(problem, image, local, twists, coordinate)[0]
    index = np.arange(len(rows))
    size = problem.camera_sizes[problem.image_camera[image]][index, coordinate]
    times = problem.observation_xy[rows][index, coordinate] / size - 0.5
    return project_each(problem, image, moved(twists, times, local))


def _motion(
    problem: Problem,
    shutter: RollingShutter,
    image: NDArray[np.int32],
    local: NDArray[np.float64],
    coordinate: NDArray[np.int64],
) -> float:
    """Return the rms image motion between the first and the last row, as a share of the height."""
    if not len(image):
        return 0.0
    half = np.full(len(image), 0.5)
    ends = [
        project_each(problem, image, moved(shutter.twist[image], sign * half, local))
        for sign in (1, -1)
    ]
    size = problem.camera_sizes[problem.image_camera[image]][np.arange(len(image)), coordinate]
    shares = np.hypot(*(ends[0] - ends[1]).T) / size
    return float(np.sqrt(np.nanmean(shares**2)))
