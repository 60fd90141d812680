"""Helpers of the solver tests: costs and minima computed without the code under test."""

import numpy as np
from scipy.optimize import least_squares

from tests import scenes

# rho(s) for s = ||r||^2, scale a in pixels: the formulas of Ceres' documentation, where the scale
# of arctan is a squared one.
LOSSES = {
    "trivial": lambda s, _: s,
    "huber": lambda s, a: np.where(s <= a * a, s, 2 * a * np.sqrt(s) - a * a),
    "soft_l1": lambda s, a: 2 * a * a * (np.sqrt(1 + s / (a * a)) - 1),
    "cauchy": lambda s, a: a * a * np.log1p(s / (a * a)),
    "arctan": lambda s, a: a * a * np.arctan(s / (a * a)),
    "tukey": lambda s, a: np.where(s <= a * a, a * a / 3 * (1 - (1 - s / (a * a)) ** 3), a * a / 3),
}


# What the fused backend knows; it refuses the others.
FUSED_SOLVERS = ("auto", "dense_schur", "sparse_schur", "iterative_schur")


def cost(problem, loss="trivial", scale=1.0):
    """1/2 sum rho(||r||^2) by formulas."""
    squared = (scenes.residuals(problem) ** 2).sum(axis=1)
    return 0.5 * LOSSES[loss](squared, scale).sum()


def minimum_by_scipy(problem, *, pose=True, points=True, params=(0, 3)):
    """The minimal cost over poses, points and the named parameters of every camera, by SciPy."""
    shapes = {}
    if pose:
        shapes["w"] = np.zeros((problem.num_images, 3))
        shapes["t"] = problem.cam_from_world[:, 4:]
    if points:
        shapes["points"] = problem.points
    start = np.concatenate(
        [array.ravel() for array in shapes.values()]
        + [problem.camera_params[:, list(params)].ravel()]
    )

    def function(x):
        arguments, offset = {}, 0
        for name, array in shapes.items():
            arguments[name] = x[offset : offset + array.size].reshape(array.shape)
            offset += array.size
        camera_params = problem.camera_params.copy()
        camera_params[:, list(params)] = x[offset:].reshape(problem.num_cameras, len(params))
        return scenes.residuals(problem, params=camera_params, **arguments).ravel()

    return least_squares(function, start, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14).cost
