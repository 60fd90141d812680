"""Ceres' Levenberg-Marquardt on Jacobians that may lie, for traces that no honest solve leaves.

What Ceres does (trust_region_minimizer.cc, levenberg_marquardt_strategy.cc), on dense matrices:
Jacobi scaling by the first Jacobian, damping D = sqrt(clamped diag(J^T J) / radius), a step taken
where actual over predicted decrease exceeds 1e-3, radius / max(1/3, 1 - (2 rho - 1)^3) after it and
/ 2, 4, 8, ... after rejections. With the true Jacobian its trace is that of bundle.solve, which a
test checks.
"""

from typing import NamedTuple

import numpy as np

from bundle import Problem
from bundle.model.losses import evaluate_loss
from bundle.model.residuals import Linearization, linearize

SMALLEST_RADIUS, LARGEST_RADIUS = 1e-32, 1e16
SMALLEST_DIAGONAL, LARGEST_DIAGONAL = 1e-6, 1e32
SMALLEST_RELATIVE_DECREASE = 1e-3


class Chart:
    """Poses (w, t), the camera parameters but the principal point, and points, as one vector."""

    def __init__(self, problem, columns):
        self.problem = problem
        self.columns = columns  # of camera_params
        images, cameras, points = problem.num_images, problem.num_cameras, problem.num_points
        sizes = [6 * images, len(columns) * cameras, 3 * points]
        self.starts = np.concatenate([[0], np.cumsum(sizes)])

    def start(self):
        pose = np.hstack(
            [np.zeros((self.problem.num_images, 3)), self.problem.cam_from_world[:, 4:]]
        )
        params = self.problem.camera_params[:, self.columns]
        return np.concatenate([pose.ravel(), params.ravel(), self.problem.points.ravel()])

    def at(self, x):
        """The problem at x but for its rotations, and the w that they are turned by."""
        pose, params, points = np.split(x, self.starts[1:3])
        problem, pose = self.problem, pose.reshape(-1, 6)
        camera_params = problem.camera_params.copy()
        camera_params[:, self.columns] = params.reshape(-1, len(self.columns))
        moved = problem.replace(
            cam_from_world=np.hstack([problem.cam_from_world[:, :4], pose[:, 3:]]),
            camera_params=camera_params,
            points=points.reshape(-1, 3),
        )
        return moved, pose[:, :3].copy()

    def linearize(self, x):
        moved, rotation_offsets = self.at(x)
        return linearize(moved, "algebraic", rotation_offsets=rotation_offsets)

    def dense(self, parts):
        """The (2 N, P) Jacobian of a Linearization."""
        problem, n = self.problem, self.problem.num_observations
        jacobian = np.zeros((n, 2, self.starts[3]))
        camera = problem.image_camera[problem.observation_image]
        for start, block, index in (
            (self.starts[0], parts.d_pose, problem.observation_image),
            (self.starts[1], parts.d_params[..., self.columns], camera),
            (self.starts[2], parts.d_point, problem.observation_point),
        ):
            width = block.shape[2]
            where = start + width * index[:, None, None] + np.arange(width)
            np.put_along_axis(jacobian, np.broadcast_to(where, block.shape), block, axis=2)
        return jacobian.reshape(2 * n, -1)


class Minimum(NamedTuple):
    """Where a solve ended: see Chart.at for the last two."""

    iterations: list[dict]
    problem: Problem
    rotation_offsets: np.ndarray


def honest(parts: Linearization) -> Linearization:
    return parts


def solve(
    problem,
    lie=honest,
    *,
    columns,
    loss="trivial",
    loss_scale=1.0,
    max_num_iterations=100,
    function_tolerance=1e-6,
    gradient_tolerance=1e-10,
    parameter_tolerance=1e-8,
    initial_trust_region_radius=1e4,
):
    """Refine everything but principal points with the Jacobians that `lie` makes of the true ones.

    The iterations are one dict each, under Ceres' names.
    """
    chart = Chart(problem, columns)

    def evaluate(x, jacobian):
        parts = chart.linearize(x)
        rho = evaluate_loss(loss, loss_scale, (parts.residual**2).sum(axis=1))
        weight = np.repeat(np.sqrt(rho[:, 1]), 2)
        cost = 0.5 * rho[:, 0].sum()
        if not jacobian:
            return cost
        return cost, weight * parts.residual.ravel(), weight[:, None] * chart.dense(lie(parts))

    x = chart.start()
    cost, residual, jacobian = evaluate(x, True)
    scale = 1 / (1 + np.sqrt((jacobian**2).sum(axis=0)))
    radius, shrink = initial_trust_region_radius, 2.0

    def record(iteration, **changes):
        return {
            "iteration": iteration,
            "cost": cost,
            "cost_change": 0.0,
            "gradient_max_norm": float(np.abs(jacobian.T @ residual).max()),
            "step_norm": 0.0,
            "relative_decrease": 0.0,
            "trust_region_radius": radius,
            "linear_solver_iterations": 0,
            "step_is_successful": True,
            "iteration_time_in_seconds": 0.0,
            "cumulative_time_in_seconds": 0.0,
            **changes,
        }

    trace = [record(0)]
    for iteration in range(1, max_num_iterations + 1):
        scaled = jacobian * scale
        diagonal = np.clip((scaled**2).sum(axis=0), SMALLEST_DIAGONAL, LARGEST_DIAGONAL)
        normal = scaled.T @ scaled + np.diag(diagonal / radius)
        try:
            step = -scale * np.linalg.solve(normal, scaled.T @ residual)
        except np.linalg.LinAlgError:  # an invalid step
            radius /= shrink
            shrink *= 2
            trace.append(record(iteration, step_is_successful=False))
            continue
        change = jacobian @ step
        predicted = -change @ (residual + change / 2)
        step_norm = float(np.linalg.norm(step))
        with np.errstate(over="ignore", invalid="ignore"):
            candidate = evaluate(x + step, False)
        gained = cost - candidate
        quality = gained / predicted
        accepted = quality > SMALLEST_RELATIVE_DECREASE
        any_success = any(entry["step_is_successful"] for entry in trace[1:])
        if any_success and step_norm <= parameter_tolerance * (
            np.linalg.norm(x) + parameter_tolerance
        ):
            break
        if abs(gained) <= function_tolerance * cost:
            break
        changes = {
            "cost_change": gained,
            "step_norm": step_norm,
            "relative_decrease": quality,
            "step_is_successful": bool(accepted),
        }
        if accepted:
            x = x + step
            cost, residual, jacobian = evaluate(x, True)
            radius = min(radius / max(1 / 3, 1 - (2 * quality - 1) ** 3), LARGEST_RADIUS)
            shrink = 2.0
        else:
            radius /= shrink
            shrink *= 2
            changes["cost"] = candidate
        changes["trust_region_radius"] = radius
        trace.append(record(iteration, **changes))
        if accepted and trace[-1]["gradient_max_norm"] <= gradient_tolerance:
            break
        if radius < SMALLEST_RADIUS:
            break
    return Minimum(trace, *chart.at(x))
