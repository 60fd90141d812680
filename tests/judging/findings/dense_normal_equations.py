"""Dense least squares of a problem in NumPy: an oracle for steps and covariances."""

import numpy as np

from bundle.model.cameras import param_kinds
from bundle.model.residuals import linearize


class Dense:
    """Jacobian J (rows x poses, cameras, points) and residual r of all observations.

    Attributes:
        explained: r^T J J^+ r.
        variance: squares that are left, per degree of freedom.
        num_parameters: rank of J.
        step: least-squares step of shortest length.
        inverse: pseudo-inverse of J^T J.
        columns: column of each camera parameter (camera, parameter).
    """

    def __init__(self, problem):
        found = linearize(problem)
        images, points, n = problem.num_images, problem.num_points, problem.num_observations
        rows = np.arange(n)
        free = [
            (camera, k)
            for camera, model in enumerate(problem.camera_models)
            for k, kind in enumerate(param_kinds(model))
            if kind in ("focal", "extra")
        ]
        self.columns = {key: 6 * images + place for place, key in enumerate(free)}
        first_point = 6 * images + len(free)
        jacobian = np.zeros((n, 2, first_point + 3 * points))
        for k in range(6):
            jacobian[rows, :, 6 * problem.observation_image + k] = found.d_pose[:, :, k]
        for k in range(3):
            column = first_point + 3 * problem.observation_point + k
            jacobian[rows, :, column] = found.d_point[:, :, k]
        camera = problem.image_camera[problem.observation_image]
        for (owner, k), column in self.columns.items():
            jacobian[camera == owner, :, column] = found.d_params[camera == owner][:, :, k]
        flat, r = jacobian.reshape(2 * n, -1), found.residual.reshape(-1)
        norm = np.linalg.norm(flat, axis=0)
        u, s, v = np.linalg.svd(flat / norm, full_matrices=False)
        rank = int((s > 1e-9 * s[0]).sum())
        u, s, v = u[:, :rank], s[:rank], v[:rank]
        projected = u.T @ r
        self.explained = float(projected @ projected)
        self.num_parameters = rank
        self.variance = float(r @ r - self.explained) / (2 * n - rank)
        self.step = -(v.T @ (projected / s)) / norm
        half = (v.T / s) / norm[:, None]
        self.inverse = half @ half.T
