"""Seeded pose graphs, and their errors over matrices by SciPy: nothing of bundle's mathematics."""

from __future__ import annotations

import numpy as np
from scipy.linalg import logm
from scipy.spatial.transform import Rotation

import bundle
from bundle import _core


def matrix(pose):
    if len(pose) == 3:
        c, s = np.cos(pose[2]), np.sin(pose[2])
        return np.array([[c, -s, pose[0]], [s, c, pose[1]], [0, 0, 1]])
    found = np.eye(4)
    found[:3, :3] = Rotation.from_quat(pose[:4]).as_matrix()
    found[:3, 3] = pose[4:]
    return found


def pose_of(found):
    if len(found) == 3:
        return np.array([found[0, 2], found[1, 2], np.arctan2(found[1, 0], found[0, 0])])
    return np.append(Rotation.from_matrix(found[:3, :3]).as_quat(), found[:3, 3])


def error_by_matrices(error, x_i, x_j, z):
    motion = np.linalg.inv(matrix(z)) @ np.linalg.inv(matrix(x_i)) @ matrix(x_j)
    if error == "log":
        algebra = logm(motion).real
        if len(motion) == 3:
            return np.array([algebra[0, 2], algebra[1, 2], algebra[1, 0]])
        return np.array([algebra[2, 1], algebra[0, 2], algebra[1, 0], *algebra[:3, 3]])
    if error == "ceres":
        between = np.linalg.inv(matrix(x_i)) @ matrix(x_j)
        if len(motion) == 3:
            angle = np.arctan2(motion[1, 0], motion[0, 0])
            return np.append(between[:2, 2] - z[:2], angle)
        apart = Rotation.from_quat(z[:4]) * Rotation.from_matrix(between[:3, :3]).inv()
        twice = 2 * apart.as_quat(canonical=True)[:3]
        return np.append(twice, between[:3, 3] - z[4:])
    if len(motion) == 3:
        return np.array([motion[0, 2], motion[1, 2], np.arctan2(motion[1, 0], motion[0, 0])])
    quaternion = Rotation.from_matrix(motion[:3, :3]).as_quat()
    return np.append(np.copysign(1, quaternion[3]) * quaternion[:3], motion[:3, 3])


def random_pose(rng, dimension, *, size=1.0, angle=1.0):
    if dimension == 2:
        return np.append(rng.normal(0, size, 2), rng.normal(0, angle))
    turn = Rotation.from_rotvec(rng.normal(0, angle, 3)).as_quat()
    return np.append(turn, rng.normal(0, size, 3))


def random_information(rng, d):
    root = rng.normal(size=(d, d)) + 3 * np.eye(d)
    return root @ root.T


def loop(dimension, *, seed=0, num_poses=12, num_closures=6, noise=0.02, start_noise=0.1):
    """Poses along a ring with odometry and random closures, and a disturbed start."""
    rng = np.random.default_rng(seed)
    d = 3 if dimension == 2 else 6
    truth = []
    for k in range(num_poses):
        turn = 2 * np.pi * k / num_poses
        place = [3 * np.cos(turn), 3 * np.sin(turn)]
        if dimension == 2:
            truth.append(np.array([*place, turn + np.pi / 2]))
        else:
            rotation = Rotation.from_rotvec([0.1 * np.sin(turn), 0.2, turn + np.pi / 2]).as_quat()
            truth.append(np.array([*rotation, *place, 0.2 * k]))
    edges = [(k, k + 1) for k in range(num_poses - 1)]
    while len(edges) < num_poses - 1 + num_closures:
        i, j = sorted(rng.choice(num_poses, 2, replace=False).tolist())
        if j - i > 1:
            edges.append((i, j))
    measurements = [
        pose_of(
            np.linalg.inv(matrix(truth[i]))
            @ matrix(truth[j])
            @ matrix(random_pose(rng, dimension, size=noise, angle=noise))
        )
        for i, j in edges
    ]
    poses = [truth[0]] + [
        pose_of(
            matrix(x) @ matrix(random_pose(rng, dimension, size=start_noise, angle=start_noise))
        )
        for x in truth[1:]
    ]
    return bundle.PoseGraph(
        poses=np.array(poses),
        edges=np.array(edges),
        measurements=np.array(measurements),
        information=np.array([random_information(rng, d) for _ in edges]),
    )


def manhattan_world(seed):
    """A walk on a grid with right turns and closures at places seen before; poses by odometry.

    The errors of rotations, up to 0.4 rad, give its cost many minima.
    """
    rng = np.random.default_rng(seed)
    size, turn = int(rng.integers(100, 800)), rng.choice([0.1, 0.2, 0.3, 0.4])
    shift, share = rng.choice([0.05, 0.15]), rng.choice([0.1, 0.3, 1])
    walk = [np.zeros(3)]
    for _ in range(size - 1):
        x, y, a = walk[-1]
        if rng.random() < 0.3:
            a += rng.choice([-1, 1]) * np.pi / 2
        walk.append(np.array([round(x + np.cos(a)), round(y + np.sin(a)), a]))
    edges = [(k, k + 1) for k in range(size - 1)]
    seen: dict[tuple[int, int], list[int]] = {}
    for i, pose in enumerate(walk):
        here = seen.setdefault((int(pose[0]), int(pose[1])), [])
        edges += [(j, i) for j in here if i - j > 5 and rng.random() < share]
        here.append(i)
    measurements = []
    for i, j in edges:
        c, s = np.cos(walk[i][2]), np.sin(walk[i][2])
        between = np.array([[c, s], [-s, c]]) @ (walk[j][:2] - walk[i][:2])
        angle = (walk[j][2] - walk[i][2] + np.pi) % (2 * np.pi) - np.pi
        noise = np.append(rng.normal(0, shift, 2), rng.normal(0, turn))
        measurements.append(np.append(between, angle) + noise)
    weights = np.diag([shift**-2, shift**-2, turn**-2])
    graph = bundle.PoseGraph(
        poses=np.zeros((size, 3)),
        edges=np.array(edges),
        measurements=np.array(measurements),
        information=np.tile(weights, (len(edges), 1, 1)),
    )
    return graph.replace(poses=bundle.initial_poses(graph, "odometry"))


def chi2_by_matrices(graph, error="log"):
    total = []
    for (i, j), z, omega in zip(graph.edges, graph.measurements, graph.information, strict=True):
        r = error_by_matrices(error, graph.poses[i], graph.poses[j], z)
        total.append(r @ omega @ r)
    return np.array(total)


def write(path, *lines):
    path.write_text("\n".join(lines) + "\n")
    return path


def dense_jacobian(graph, error="log"):
    """J (d m, d n) and r of whitened errors, by central differences of errors of matrices."""
    d = graph.tangent_size
    manifold = "se2" if graph.dimension == 2 else "se3"
    jacobian = np.zeros((d * graph.num_edges, d * graph.num_poses))
    residual = np.zeros(d * graph.num_edges)
    for k, (i, j) in enumerate(graph.edges):
        values, vectors = np.linalg.eigh(graph.information[k])
        root = np.sqrt(np.maximum(values, 0))[:, None] * vectors.T
        rows = slice(d * k, d * k + d)

        def edge(x_i, x_j, k=k, root=root):
            return root @ error_by_matrices(error, x_i, x_j, graph.measurements[k])

        ends = [graph.poses[i], graph.poses[j]]
        residual[rows] = edge(*ends)
        for side, pose in enumerate((i, j)):
            for c in range(d):
                found = []
                for sign in (1, -1):
                    moved = list(ends)
                    moved[side] = _core.retract(manifold, ends[side], sign * 1e-6 * np.eye(d)[c])
                    found.append(edge(*moved))
                jacobian[rows, d * pose + c] = (found[0] - found[1]) / 2e-6
    return jacobian, residual


def blocks(matrix, d):
    """The diagonal blocks of a matrix."""
    return np.array([matrix[k : k + d, k : k + d] for k in range(0, len(matrix), d)])
