"""Filmed scenes with rolling shutters, and their residuals by matrix exponentials.

The oracle shares nothing with the core: the motion is the exponential of 4 x 4 matrices by its
power series, the row is found by repeated projection, lenses are those of ``tests.formulas``. It
also takes complex numbers, for derivatives by complex steps.
"""

import numpy as np
from scipy.spatial.transform import Rotation

import bundle
from tests import scenes

AXES = {"rows": 1, "columns": 0}


def hats(twists):
    """(N, 4, 4) matrices of (N, 6) twists (w, v)."""
    w, v = twists[:, :3], twists[:, 3:]
    result = np.zeros((len(twists), 4, 4), twists.dtype)
    for (i, j), k in {(2, 1): 0, (0, 2): 1, (1, 0): 2}.items():
        result[:, i, j] = w[:, k]
        result[:, j, i] = -w[:, k]
    result[:, :3, 3] = v
    return result


def exponentials(matrices):
    """(N, 4, 4) exponentials; ``scipy.linalg.expm`` takes a millisecond for each of them."""
    halvings = 4
    term = total = np.tile(np.eye(4), (len(matrices), 1, 1))
    for k in range(1, 20):
        term = term @ matrices / (k * 2**halvings)
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return total


class Rows:
    """Projections of a problem's observations at given row times."""

    def __init__(self, problem):
        self.problem = problem
        shutter = problem.rolling_shutter
        self.camera = problem.image_camera[problem.observation_image]
        self.size = np.array(
            [
                problem.camera_sizes[c][AXES[shutter.direction[c]]]
                if shutter.direction[c] != "global"
                else np.inf
                for c in self.camera
            ]
        )
        self.axis = np.array([AXES.get(shutter.direction[c], 1) for c in self.camera])
        self.rolls = np.isfinite(self.size)

    def time(self, xy):
        """Row times of pixels."""
        row = np.arange(len(xy))
        return np.where(self.rolls, xy[row, self.axis] / self.size - 0.5, 0)

    def project(self, s, *, poses=None, twists=None, params=None, points=None):
        """(N, 2) pixels at row times; poses are (num_images, 4, 4)."""
        problem = self.problem
        poses = matrices(problem) if poses is None else poses
        twists = problem.rolling_shutter.twist if twists is None else twists
        params = problem.camera_params if params is None else params
        points = problem.points if points is None else points
        image, point = problem.observation_image, problem.observation_point
        moved = exponentials(hats(s[:, None] * twists[image])) @ poses[image]
        in_camera = np.einsum("nij,nj->ni", moved[:, :3, :3], points[point]) + moved[:, :3, 3]
        xy = np.zeros((len(s), 2), in_camera.dtype)
        for c in np.unique(self.camera):
            of = self.camera == c
            xy[of] = scenes.project(problem.camera_models[c], params[c], in_camera[of])
        return xy

    def fixed_point(self, start=None, **values):
        """Row times at which points are seen where they are read."""
        s = self.time(self.problem.observation_xy) if start is None else start
        for _ in range(100):
            before, s = s, self.time(self.project(s, **values))
            if np.isrealobj(s) and np.abs(s - before).max(initial=0) < 1e-15:
                break
        return s


def matrices(problem):
    """(num_images, 4, 4) poses."""
    result = np.tile(np.eye(4), (problem.num_images, 1, 1))
    result[:, :3, :3] = Rotation.from_quat(problem.cam_from_world[:, :4]).as_matrix()
    result[:, :3, 3] = problem.cam_from_world[:, 4:]
    return result


def residuals(problem):
    """(N, 2) residuals at the fixed points of the rows, or at the measured rows."""
    rows = Rows(problem)
    if problem.rolling_shutter.row_time == "observed":
        return rows.project(rows.time(problem.observation_xy)) - problem.observation_xy
    return rows.project(rows.fixed_point()) - problem.observation_xy


def filmed(
    problem, *, direction="rows", rate=1.0, seed=0, noise=0.3, readout=0.8, ties=False, **of
):
    """A problem of ``scenes`` whose images were read while they moved.

    With ``ties``, twists are the readout times the motion per frame between the neighbours, which
    are five frames apart, plus noise.
    """
    rng = np.random.default_rng(seed)
    count = problem.num_images
    directions = (direction,) * problem.num_cameras if isinstance(direction, str) else direction
    twists = rate * rng.standard_normal((count, 6)) * np.repeat([0.03, 0.15], 3)
    fields = {"direction": directions, "readout": np.full(problem.num_cameras, readout)}
    if ties:
        fields["frames"] = 5.0 * np.arange(count)
        order = np.arange(count)
        fields["neighbours"] = np.stack(
            [np.maximum(order - 1, 0), np.minimum(order + 1, count - 1)], 1
        )
        twists = readout * motions(problem, fields["neighbours"], fields["frames"])
        twists += rate * rng.standard_normal((count, 6)) * np.repeat([0.002, 0.01], 3)
    rolls = np.array([one != "global" for one in directions])[problem.image_camera]
    twists[~rolls] = 0
    true = problem.replace(rolling_shutter=bundle.RollingShutter(twist=twists, **fields, **of))
    rows = Rows(true)
    xy = rows.project(rows.fixed_point())
    return true.replace(observation_xy=xy + noise * rng.standard_normal(xy.shape))


def motions(problem, neighbours, frames):
    """(num_images, 6) motion per frame between the neighbours: w, v of Exp(w, v) = (R, V(w) v)."""
    a, b = np.transpose(neighbours)
    poses = matrices(problem)
    moved = poses[b] @ np.linalg.inv(poses[a])
    w = Rotation.from_matrix(moved[:, :3, :3]).as_rotvec()
    result = np.zeros((problem.num_images, 6))
    for k, between in enumerate(frames[b] - frames[a]):
        units = hats(np.hstack([np.tile(w[k], (3, 1)), np.eye(3)]))
        v = np.linalg.solve(exponentials(units)[:, :3, 3].T, moved[k, :3, 3])
        result[k] = np.append(w[k], v) / between
    return result


def still(problem):
    """The problem with zero twists."""
    shutter = problem.rolling_shutter
    return problem.replace(rolling_shutter=shutter.replace(twist=np.zeros_like(shutter.twist)))
