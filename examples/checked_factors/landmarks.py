"""A robot in the plane that measures ranges and bearings of landmarks: factors of a project."""

from __future__ import annotations

import numpy as np

import bundle

SIGMAS = np.array([0.1, 0.02])
"""Standard deviations of a range [m] and a bearing [rad]."""


class RangeBearing:
    """Range and bearing of a landmark, seen from a pose (x, y, angle)."""

    def __init__(self, distance: float, bearing: float) -> None:
        self.measured = np.array([distance, bearing])

    def __call__(self, values):
        """Return the whitened residual and its Jacobians by pose ("se2") and landmark."""
        (x, y, angle), landmark = values
        c, s = np.cos(angle), np.sin(angle)
        forward, left = np.array([[c, s], [-s, c]]) @ (landmark - [x, y])
        square = forward**2 + left**2
        length = np.sqrt(square)
        error = np.array([length, np.arctan2(left, forward)]) - self.measured
        error[1] = np.arctan2(np.sin(error[1]), np.cos(error[1]))
        # By the landmark in the frame of the robot, which moves against the robot.
        by_seen = np.array([[forward / length, left / length], [-left / square, forward / square]])
        by_pose = by_seen @ np.array([[-1, 0, left], [0, -1, -forward]])
        by_landmark = by_seen @ [[c, s], [-s, c]]
        weights = 1 / SIGMAS[:, None]
        return error / SIGMAS, [weights * by_pose, weights * by_landmark]


def make_graph(seed: int = 0) -> bundle.FactorGraph:
    """Return a graph of five poses and four landmarks, with noise."""
    rng = np.random.default_rng(seed)
    landmarks = np.array([[0.0, 3.0], [4.0, 4.0], [5.0, -2.0], [1.0, -3.0]])
    poses = np.array([[0.8 * k, 0.2 * k, 0.1 * k] for k in range(5)])
    graph = bundle.FactorGraph()
    for k, landmark in enumerate(landmarks):
        graph.add_variable(f"l{k}", landmark + rng.normal(0, 0.2, 2))
    for k, (x, y, angle) in enumerate(poses):
        start = np.array([x, y, angle]) + rng.normal(0, 0.1, 3)
        graph.add_variable(f"x{k}", poses[k] if k == 0 else start, "se2", fixed=k == 0)
        for j, landmark in enumerate(landmarks):
            dx, dy = landmark - [x, y]
            distance = np.hypot(dx, dy) + rng.normal(0, SIGMAS[0])
            bearing = np.arctan2(dy, dx) - angle + rng.normal(0, SIGMAS[1])
            graph.add_factor(
                bundle.FunctionFactor([f"x{k}", f"l{j}"], RangeBearing(distance, bearing))
            )
    return graph
