"""Compare a filter, which linearises each measurement once, with a smoother.

The script prints three comparisons. With a path it also draws them:
``python filter_or_smoother.py figure.png`` (needs Matplotlib).

1. One range of 5 m to a landmark 3 m beside a straight line; the robot is at 4 m. An extended
   Kalman filter (EKF) takes one Gauss-Newton step from its prior estimate and reports the
   covariance there.
2. Fill-in: after one lap, the covariance of a filter is dense over all landmarks. The graph of the
   same measurements is sparse.
3. EKF-SLAM on a loop: the Jacobians of one landmark are taken at different estimates, between which
   the map has rotated. The null space loses the yaw direction, and the filter seems to know its
   yaw. The normalised estimation error squared (NEES, 3 for a consistent filter) grows.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import bundle

# 1. The range.
ASIDE, RANGE, SIGMA = 3.0, 5.0, 0.2


def range_and_slope(x: float) -> tuple[float, float]:
    """Return the predicted range at x metres along the line, and its derivative."""
    distance = np.hypot(x, ASIDE)
    return distance, x / distance


def filter_range(x: float) -> tuple[float, float]:
    """Return estimate and sigma after the one update of a filter without prior information."""
    predicted, slope = range_and_slope(x)
    return x + (RANGE - predicted) / slope, SIGMA / abs(slope)


def smooth_range(x: float, steps: int = 4) -> tuple[list[float], float]:
    """Return the estimates of Gauss-Newton steps on the same measurement, and the last sigma."""

    def residual(values: list[np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
        predicted, slope = range_and_slope(values[0][0])
        return np.array([predicted - RANGE]) / SIGMA, [np.array([[slope / SIGMA]])]

    graph = bundle.FactorGraph()
    graph.add_variable("x", [x])
    graph.add_factor(bundle.FunctionFactor(["x"], residual))
    found = []
    for _ in range(steps):
        matrix, vector = graph.information()
        graph = graph.with_values({"x": graph.values["x"] + vector / matrix[0]})
        found.append(float(graph.values["x"][0]))
    return found, float(graph.information()[0][0, 0] ** -0.5)


# 3. The loop. 2. is counted on it.
RADIUS, LANDMARKS, LAP, LAPS, SIGHT = 12.0, 12, 24, 2, 7.0
ODOMETRY = np.array([0.1, 0.1, np.radians(10.0)])  # sigmas a step: m, m, rad
SEEN = 0.3  # sigma of a landmark's position in the frame of the robot, m


def turn(angle: float) -> np.ndarray:
    """Return the rotation matrix of an angle."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


QUARTER = turn(np.pi / 2)


def moved(pose: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Return a pose (x, y, heading) after a step in its own frame."""
    return np.r_[pose[:2] + turn(pose[2]) @ step[:2], pose[2] + step[2]]


def angle_of(difference: float) -> float:
    """Return a difference of angles within half a turn."""
    return (difference + np.pi) % (2 * np.pi) - np.pi


@dataclass
class Loop:
    """Two laps: true poses, measured steps, and observations: (step, landmark) to position."""

    truth: np.ndarray
    landmarks: np.ndarray
    steps: np.ndarray
    seen: list[dict[int, np.ndarray]]


def drive(seed: int) -> Loop:
    """Simulate a robot that circles between landmarks on both sides of its path."""
    rng = np.random.default_rng(seed)
    around = 2 * np.pi * np.arange(LANDMARKS) / LANDMARKS
    distance = RADIUS + np.where(np.arange(LANDMARKS) % 2, 2.5, -2.5)
    landmarks = distance[:, None] * np.c_[np.cos(around), np.sin(around)]
    a_step = 2 * np.pi / LAP
    true_step = np.r_[turn(a_step / 2) @ [2 * RADIUS * np.sin(a_step / 2), 0.0], a_step]
    truth, steps, seen = [np.array([RADIUS, 0.0, np.pi / 2])], [], []
    for k in range(LAPS * LAP + 1):
        if k:
            truth.append(moved(truth[-1], true_step))
            steps.append(true_step + rng.normal(size=3) * ODOMETRY)
        in_frame = (landmarks - truth[-1][:2]) @ turn(truth[-1][2])
        near = np.flatnonzero(np.linalg.norm(in_frame, axis=1) < SIGHT)
        seen.append({int(j): in_frame[j] + rng.normal(size=2) * SEEN for j in near})
    return Loop(np.array(truth), landmarks, np.array(steps), seen)


def step_jacobians(pose: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives of a moved pose by the pose and by the step."""
    by_pose = np.eye(3)
    by_pose[:2, 2] = QUARTER @ turn(pose[2]) @ step[:2]
    by_step = np.eye(3)
    by_step[:2, :2] = turn(pose[2])
    return by_pose, by_step


def sight_jacobians(pose: np.ndarray, landmark: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives of a landmark's position in the robot's frame by pose and landmark."""
    back = turn(pose[2]).T
    by_heading = -QUARTER @ back @ (landmark - pose[:2])
    return np.c_[-back, by_heading], back


@dataclass
class Filtered:
    """Result of EKF-SLAM: estimates by step, the last covariance, and the Jacobians used."""

    poses: np.ndarray
    covariances: np.ndarray
    covariance: np.ndarray
    rows: list[list[tuple[int | str, np.ndarray]]]


def run_filter(loop: Loop) -> Filtered:
    """Run EKF-SLAM from a known first pose; a landmark is added at its first observation."""
    mean, covariance = loop.truth[0].copy(), np.zeros((3, 3))
    place: dict[int, int] = {}
    poses, covariances, rows = [], [], []
    for k, seen in enumerate(loop.seen):
        if k:
            by_pose, by_step = step_jacobians(mean[:3], loop.steps[k - 1])
            rows.append([(f"p{k - 1}", -by_pose), (f"p{k}", np.eye(3))])
            mean[:3] = moved(mean[:3], loop.steps[k - 1])
            covariance[:3, 3:] = by_pose @ covariance[:3, 3:]
            covariance[3:, :3] = covariance[:3, 3:].T
            noise = by_step @ np.diag(ODOMETRY**2) @ by_step.T
            covariance[:3, :3] = by_pose @ covariance[:3, :3] @ by_pose.T + noise
        for j, measured in seen.items():
            n = len(mean)
            if j not in place:
                place[j] = n
                landmark = mean[:2] + turn(mean[2]) @ measured
                of_pose, of_landmark = sight_jacobians(mean[:3], landmark)
                gain = -of_landmark.T @ of_pose  # of the landmark by the pose
                cross = gain @ covariance[:3]
                own = gain @ covariance[:3, :3] @ gain.T + SEEN**2 * np.eye(2)
                covariance = np.block([[covariance, cross.T], [cross, own]])
                mean = np.r_[mean, landmark]
            else:
                at = place[j]
                landmark = mean[at : at + 2]
                of_pose, of_landmark = sight_jacobians(mean[:3], landmark)
                jacobian = np.zeros((2, n))
                jacobian[:, :3], jacobian[:, at : at + 2] = of_pose, of_landmark
                predicted = turn(mean[2]).T @ (landmark - mean[:2])
                innovation = jacobian @ covariance @ jacobian.T + SEEN**2 * np.eye(2)
                gain = np.linalg.solve(innovation, jacobian @ covariance).T
                mean = mean + gain @ (measured - predicted)
                left = np.eye(n) - gain @ jacobian  # Joseph's form
                covariance = left @ covariance @ left.T + SEEN**2 * gain @ gain.T
            rows.append([(f"p{k}", of_pose), (j, of_landmark)])
        poses.append(mean[:3].copy())
        covariances.append(covariance[:3, :3].copy())
    return Filtered(np.array(poses), np.array(covariances), covariance, rows)


class Sight:
    """Whitened residual of all landmarks observed from one pose."""

    def __init__(self, measured: np.ndarray) -> None:
        self.measured = measured

    def __call__(self, values: list[np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return residual and Jacobians by the pose (right perturbation) and each landmark."""
        pose, landmarks = values[0], np.array(values[1:])
        in_frame = (landmarks - pose[:2]) @ turn(pose[2])
        by_pose = np.zeros((len(landmarks), 2, 3))
        by_pose[:, :, :2] = -np.eye(2)
        by_pose[:, :, 2] = -in_frame @ QUARTER.T
        by_landmarks = []
        for i in range(len(landmarks)):
            block = np.zeros((2 * len(landmarks), 2))
            block[2 * i : 2 * i + 2] = turn(pose[2]).T / SEEN
            by_landmarks.append(block)
        residual = (in_frame - self.measured).ravel() / SEEN
        return residual, [by_pose.reshape(-1, 3) / SEEN, *by_landmarks]


def smoother(loop: Loop, start: Filtered) -> bundle.FactorGraph:
    """Return the graph of all measurements at its optimum, from the filter's poses."""
    graph = bundle.FactorGraph()
    for k, pose in enumerate(start.poses):
        graph.add_variable(("pose", k), pose, "se2", fixed=k == 0)
    for k, step in enumerate(loop.steps):
        a, b = ("pose", k), ("pose", k + 1)
        graph.add_factor(bundle.BetweenFactor(a, b, step, np.diag(ODOMETRY**-2.0)))
    for k, seen in enumerate(loop.seen):
        pose = start.poses[k]
        for j, measured in seen.items():
            if ("landmark", j) not in graph.keys:
                graph.add_variable(("landmark", j), pose[:2] + turn(pose[2]) @ measured)
        keys = [("pose", k), *(("landmark", j) for j in seen)]
        graph.add_factor(bundle.FunctionFactor(keys, Sight(np.array(list(seen.values())))))
    return graph.with_values(graph.solve(num_threads=1).values)


def nees_of_filter(filtered: Filtered, loop: Loop) -> np.ndarray:
    """Return the squared error of each pose after the first, normalised by the covariance."""
    errors = filtered.poses - loop.truth
    errors[:, 2] = angle_of(errors[:, 2])
    return np.array([
        e @ np.linalg.solve(c, e)
        for e, c in zip(errors[1:], filtered.covariances[1:], strict=True)
    ])  # fmt: skip


def nees_of_smoother(graph: bundle.FactorGraph, loop: Loop) -> float:
    """Return the squared error of the last pose, normalised by its marginal information."""
    last = ("pose", len(loop.truth) - 1)
    matrix, _ = graph.information([last])
    found = graph.values[last]
    inside = turn(found[2]).T @ (loop.truth[-1][:2] - found[:2])
    error = np.r_[inside, angle_of(loop.truth[-1][2] - found[2])]
    return float(error @ matrix @ error)


def nullity(rows: list[list[tuple[int | str, np.ndarray]]]) -> int:
    """Return the dimension of the null space of the Jacobians over poses and landmarks."""
    sizes = {name: block.shape[1] for row in rows for name, block in row}
    begin = dict(zip(sizes, np.cumsum([0, *sizes.values()])[:-1], strict=True))
    stacked = []
    for row in rows:
        line = np.zeros((len(row[0][1]), sum(sizes.values())))
        for name, block in row:
            line[:, begin[name] : begin[name] + block.shape[1]] = block
        stacked.append(line)
    values = np.linalg.svd(np.vstack(stacked), compute_uv=False)
    return int((values < values[0] * max(sum(map(len, stacked)), len(values)) * 2.2e-16).sum())


def rows_at_one_point(loop: Loop) -> list[list[tuple[int | str, np.ndarray]]]:
    """Return the Jacobians of the same measurements at one estimate, as in a smoother."""
    rows = []
    for k, seen in enumerate(loop.seen):
        if k:
            step = turn(loop.truth[k - 1][2]).T @ (loop.truth[k] - loop.truth[k - 1])[:2]
            by_pose, _ = step_jacobians(loop.truth[k - 1], np.r_[step, 0.0])
            rows.append([(f"p{k - 1}", -by_pose), (f"p{k}", np.eye(3))])
        for j in seen:
            of_pose, of_landmark = sight_jacobians(loop.truth[k], loop.landmarks[j])
            rows.append([(f"p{k}", of_pose), (j, of_landmark)])
    return rows


def consistency(runs: int) -> dict[str, np.ndarray]:
    """Return NEES of both, yaw errors and reported yaw sigmas, over seeded runs."""
    filter_nees, smoother_nees, errors, sigmas = [], [], [], []
    for seed in range(runs):
        loop = drive(seed)
        filtered = run_filter(loop)
        filter_nees.append(nees_of_filter(filtered, loop))
        smoother_nees.append(nees_of_smoother(smoother(loop, filtered), loop))
        errors.append(angle_of(filtered.poses[:, 2] - loop.truth[:, 2]))
        sigmas.append(np.sqrt(filtered.covariances[:, 2, 2]))
    return {
        "filter": np.array(filter_nees),
        "smoother": np.array(smoother_nees),
        "yaw_error": np.array(errors),
        "yaw_sigma": np.array(sigmas),
    }


def fill() -> dict[str, int]:
    """Count the nonzeros of a filter's covariance and of the graph's information, free poses."""
    loop = drive(0)
    filtered = run_filter(loop)
    graph = smoother(loop, filtered)
    matrix, _ = graph.information()
    corner = filtered.covariance[3:, 3:]
    blocks = corner.reshape(LANDMARKS, 2, LANDMARKS, 2).any(axis=(1, 3))
    return {
        "pairs": int(np.triu(blocks, 1).sum()),
        "covariance": int(np.count_nonzero(filtered.covariance)),
        "information": int(np.count_nonzero(np.abs(matrix) > 1e-12)),
        "size": len(matrix),
    }


def memory_of_filter(landmarks: int) -> tuple[int, int, int]:
    """Return the number of landmark pairs, their covariance entries, and its bytes."""
    pairs = landmarks * (landmarks - 1) // 2
    return pairs, 2 * 4 * pairs, 8 * (3 + 2 * landmarks) ** 2


def draw(found: dict[str, np.ndarray], path: Path) -> None:
    """Draw the range example, the reported and the true yaw error, and both NEES."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 3.6), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    starts = np.linspace(0.6, 9, 200)
    estimates = np.array([filter_range(x) for x in starts])
    left.plot(starts, estimates[:, 0], color="C1", label="filter, one step")
    band = (estimates[:, 0] - 3 * estimates[:, 1], estimates[:, 0] + 3 * estimates[:, 1])
    left.fill_between(starts, *band, color="C1", alpha=0.2, label="its 3 sigma")
    left.axhline(smooth_range(1.0, 6)[0][-1], color="C0", label="smoother = truth, 4 m")
    left.set(xlabel="believed place [m]", ylabel="estimate [m]", title="One range", ylim=(0, 12))
    steps = np.arange(found["yaw_error"].shape[1])
    rms = np.sqrt((found["yaw_error"] ** 2).mean(axis=0))
    middle.plot(steps, np.degrees(rms), color="C3", label="true error, rms")
    reported = np.degrees(found["yaw_sigma"].mean(axis=0))
    middle.plot(steps, reported, color="C1", label="sigma that the filter reports")
    middle.set(xlabel="step", ylabel="yaw [degrees]", title="EKF-SLAM's lost yaw")
    runs = len(found["filter"])
    right.semilogy(steps[1:], found["filter"].mean(axis=0), color="C1", label="filter")
    right.semilogy(steps[-1:], [found["smoother"].mean()], "o", color="C0", label="smoother")
    right.axhline(3, color="k", lw=1, ls=":", label="consistent: 3")
    right.set_yticks([3, 5, 10, 20, 40], ["3", "5", "10", "20", "40"])
    right.minorticks_off()
    right.set(xlabel="step", ylabel="NEES of the pose", title=f"Mean of {runs} runs")
    for axis in (left, middle, right):
        axis.grid(visible=True, alpha=0.3)
        axis.legend(fontsize=8)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    for x in (1.0, 0.7, 0.3, 8.0, 9.0):
        estimate, sigma = filter_range(x)
        print(f"from {x:3}: filter {estimate:.6f} m, sigma {sigma:.3f}")
    steps, sigma = smooth_range(1.0)
    print("smoother  :", ", ".join(f"{x:.6f}" for x in steps), f"m, sigma {sigma:.2f}")
    print("fill      :", fill())
    for landmarks in (50, 500, 5000):
        pairs, entries, size = memory_of_filter(landmarks)
        print(f"{landmarks:4} landmarks: {pairs} pairs, {entries} entries, {size / 1e6:.3g} MB")
    loop = drive(0)
    counts = nullity(run_filter(loop).rows), nullity(rows_at_one_point(loop))
    print(f"nullity   : filter {counts[0]}, smoother {counts[1]}")
    found = consistency(50)
    last = found["filter"][:, -1].mean(), found["smoother"].mean()
    print(
        f"NEES, 50 runs, last pose, 3 if consistent: filter {last[0]:.2f}, smoother {last[1]:.2f}"
    )
    if len(sys.argv) > 1:
        draw(found, Path(sys.argv[1]))
