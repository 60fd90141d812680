"""Motion of a camera while a rolling shutter reads an image, at NumPy level.

A rolling shutter reads row after row (or column after column). Relative to the pose T of the image,
which is that of its middle row, the camera has moved at the row y by a constant twist m = (w, v):

    x = Exp(s m) T X,    s = y / height - 1/2,

Exp is that of SE(3), and m is in the camera's frame per height of the image:

    Exp(s m) x = R x + V s v,    R = Exp(s w) = I + a K + b K^2,    V = I + b K + c K^2,
    K = [s w]x,  h = |s w|,  a = sin h / h,  b = (1 - cos h) / h^2,  c = (h - sin h) / h^3.

These are one-parameter subgroups: with another reference row r, T becomes Exp(r m) T and m stays.

The row of a point is itself a function of the motion, because the point is seen when its row is
read: s is the solution of the fixed-point equation

    s = pi_y(Exp(s m) T X) / height - 1/2.

Iteration converges linearly with the factor |d pi_y / ds| / height, the share of the height by
which the image moves during the readout: 10 iterations reduce an error of 5 % to 1e-13.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.base.arrays import refuse_row
from bundle.model.cameras import camera_models, project
from bundle.model.problem import Problem
from bundle.model.rigid_motions import dot, inverse_poses, log_of_poses, multiply_poses
from bundle.model.rolling_shutter import RollingShutter

Array = NDArray[np.float64]

MOST_ITERATIONS = 60
_CONVERGED = 1e-14  # of the height
_FARTHEST = 2.0  # heights from the centre: rows beyond are not in the image


def moved(twists: Array, times: Array, points: Array) -> Array:
    """Return Exp(s m) x (N, 3) for twists m (N, 6), times s (N,) and points x (N, 3)."""
    w, v = times[:, None] * twists[:, :3], times[:, None] * twists[:, 3:]
    a, b, c = (k[:, None] for k in _coefficients(dot(w, w)))
    wx, wv = np.cross(w, points), np.cross(w, v)
    found: Array = points + a * wx + b * np.cross(w, wx) + v + b * wv + c * np.cross(w, wv)
    return found


def project_each(problem: Problem, image: NDArray[np.integer], points: Array) -> Array:
    """Return pixels (N, 2) of points (N, 3) in the frames of cameras; NaN without a projection.

    ``image``: (N,) index of the image of each point. ``points``: (N, 3) coordinates in the frame of
    the camera at that time.
    """
    camera = problem.image_camera[image]
    order = np.argsort(camera, kind="stable")
    starts = np.searchsorted(camera[order], np.arange(problem.num_cameras + 1))
    xy = np.empty((len(points), 2))
    for index in np.flatnonzero(np.diff(starts)).tolist():
        rows = order[starts[index] : starts[index + 1]]
        model = problem.camera_models[index]
        params = problem.camera_params[index, : len(camera_models()[model])]
        xy[rows] = project(model, params, points[rows])[0]
    return xy


def read_positions(
    problem: Problem,
    image: NDArray[np.integer],
    points: Array,
    twists: Array,
    direction: NDArray[np.int64],
) -> tuple[Array, Array]:
    """Return where and when a rolling shutter reads points.

    Args:
        problem: the problem that has the cameras; their sizes must be known.
        image: (N,) index of the image of each point.
        points: (N, 3) coordinates T X, in the frame of the image's pose.
        twists: (N, 6) twist m of each point's image.
        direction: (N,) 1 for rows, 0 for columns: the coordinate that is read in order.

    Returns:
        Pixels (N, 2) and times s (N,) at the fixed point; NaN without a projection, or outside
        twice the height.
    """
    size = problem.camera_sizes[problem.image_camera[image]][np.arange(len(image)), direction]
    times = np.zeros(len(image))
    xy = np.empty((len(image), 2))
    active = np.arange(len(image))
    for _ in range(MOST_ITERATIONS):
        now = times[active]
        found = project_each(problem, image[active], moved(twists[active], now, points[active]))
        xy[active] = found
        read = found[np.arange(len(active)), direction[active]] / size[active] - 0.5
        read = np.where(np.abs(read) <= _FARTHEST, read, np.nan)
        times[active] = read
        active = active[np.abs(read - now) > _CONVERGED]
        if not len(active):
            break
    xy[np.isnan(times)] = np.nan
    return xy, times


def twists_between(a: Array, b: Array) -> Array:
    """Return Log(b a^-1) (N, 6), rotation first, of poses (N, 7) with unit quaternions."""
    return log_of_poses(multiply_poses(b, inverse_poses(a)))


def _coefficients(square: Array) -> tuple[Array, Array, Array]:
    """Return sin h / h, (1 - cos h) / h^2 and (h - sin h) / h^3 from h^2."""
    h = np.sqrt(square)
    a, b = np.sinc(h / np.pi), 0.5 * np.sinc(h / (2 * np.pi)) ** 2
    small = square < 1e-2  # the next term of the series is below 1e-16
    series = (1 - square / 20 * (1 - square / 42 * (1 - square / 72 * (1 - square / 110)))) / 6
    c = np.where(small, series, (1 - a) / np.where(small, 1.0, square))
    return a, b, c


def scaled(shutter: RollingShutter | None, scale: ArrayLike) -> RollingShutter | None:
    """Return the rolling shutters after a change of the length unit.

    A twist is in the frame of its camera: rotations and translations of the world do not change it.

    ``scale``: new per old lengths, one number or (num_images,).
    """
    if shutter is None:
        return None
    twist = shutter.twist.copy()
    twist[:, 3:] *= np.asarray(scale, float).reshape(-1, 1)
    return shutter.replace(twist=twist)


def shutter_of_cameras(
    shutter: RollingShutter | None, rows: NDArray[np.int64]
) -> RollingShutter | None:
    """Return the rolling shutters for other cameras: copies of the cameras ``rows``, by index."""
    if shutter is None:
        return None
    return shutter.replace(
        direction=tuple(shutter.direction[row] for row in rows.tolist()),
        readout=shutter.readout[rows],
    )


def can_roll(problem: Problem) -> bool:
    """Return True if rolling shutters can be added: known sizes, no rigs, no shutters so far."""
    sizes = problem.camera_sizes[problem.image_camera]
    shutter = problem.rolling_shutter
    is_global = shutter is None or not shutter.is_rolling.any()
    return bool(is_global and not problem.num_frames and sizes.size and (sizes > 0).all())


def check_same_shutter(problem: Problem, cameras: NDArray[np.int64]) -> None:
    """Check that cameras have the same direction and readout."""
    shutter = problem.rolling_shutter
    if shutter is None:
        return
    words = [
        f"{direction}, readout {readout:g}"
        for direction, readout in zip(shutter.direction, shutter.readout.tolist(), strict=True)
    ]
    first = int(cameras[0])
    refuse_row(
        [words[camera] != words[first] for camera in cameras.tolist()],
        lambda k: (
            f"camera {problem.camera_ids[cameras[k]]}: expected the shutter of camera "
            f"{problem.camera_ids[first]} ({words[first]}) to share it, found {words[cameras[k]]}"
        ),
    )
