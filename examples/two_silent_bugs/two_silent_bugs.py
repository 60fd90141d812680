"""Two silent bugs of sliding windows, each with its cure.

1. A prior is linearised at old estimates, the other factors at newer ones. Each has a null space of
   three dimensions (position and yaw in the plane), but the two null spaces differ. Together they
   add spurious yaw information, and no residual shows it.
2. A prior is recomputed at each keyframe. In single precision its small eigenvalues become
   negative; the square root of the same prior stays positive semidefinite.
"""

from __future__ import annotations

import numpy as np

import bundle


def planar_window(landmark: tuple[float, float], prior: list[bundle.Factor]) -> bundle.FactorGraph:
    """Two poses and a landmark: odometry and the observation of the second pose."""
    graph = bundle.FactorGraph()
    graph.add_variable("x1", [0.0, 0.0, 0.0], "se2")
    graph.add_variable("x2", [2.0, 0.0, 0.0], "se2")
    graph.add_variable("f", list(landmark))
    graph.add_factor(bundle.BetweenFactor("x1", "x2", [2.0, 0.0, 0.0], np.eye(3)))
    graph.add_factor(bundle.FunctionFactor(("x2", "f"), lambda blocks: seen(blocks, (0.0, 1.0))))
    for factor in prior:
        graph.add_factor(factor)
    return graph


def seen(blocks: list[np.ndarray], measured: tuple[float, float]) -> tuple[np.ndarray, list]:
    """Landmark in the frame of the pose minus the measurement, with Jacobians in that frame."""
    (x, y, angle), point = blocks
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, s], [-s, c]])
    there = turn @ (point - [x, y])
    by_pose = np.array([[-1.0, 0.0, there[1]], [0.0, -1.0, -there[0]]])
    return there - measured, [by_pose, turn]


def nullity(graph: bundle.FactorGraph) -> int:
    """Dimension of the null space of the graph."""
    information, _ = graph.information()
    values = np.linalg.eigvalsh(information)
    return int(np.sum(values < 1e-12 * values[-1]))


def first_bug() -> dict[str, int]:
    """Nullity at the prior's own estimates, and after the landmark has moved 5 cm."""
    _, jacobians = seen([np.zeros(3), np.array([2.0, 1.0])], (2.0, 1.0))
    rows = np.hstack(jacobians)  # what the first pose saw, linearised when it left
    prior = bundle.LinearPrior(
        rows.T @ rows, np.zeros(5), {"x1": [0, 0, 0], "f": [2.0, 1.0]}, ("x1", "f"),
        manifolds={"x1": "se2"},
    )  # fmt: skip
    return {
        "first estimates": nullity(planar_window((2.0, 1.0), [prior])),
        "newer estimate of the landmark": nullity(planar_window((2.0, 1.05), [prior])),
    }


def second_bug(seconds: float = 12.0) -> dict[str, tuple[float, int]]:
    """Smallest / largest eigenvalue of the last prior, and the number of alarms."""
    flight = bundle.synthesize_flight(duration=seconds, seed=1)
    found = {}
    for form in ("information", "square_root"):
        for precision in ("double", "single"):
            result = bundle.run_odometry(
                flight.sequence, prior_form=form, precision=precision, imu_noise_scale=1.0
            )
            definite = [k.prior_definiteness for k in result.keyframes if k.prior_definiteness]
            alarms = sum("prior" in " ".join(k.alarms) for k in result.keyframes)
            found[f"{form}, {precision} precision"] = (min(definite), alarms)
    return found


if __name__ == "__main__":
    for what, count in first_bug().items():
        print(f"linearised at the {what}: {count} directions unknown")
    for what, (definite, alarms) in second_bug().items():
        print(f"prior as {what}: least eigenvalue {definite:.0e} of the largest, {alarms} alarms")
