"""Chordal cost and certificate matrix by dense NumPy: nothing of bundle's mathematics."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

import bundle


def split(pose):
    if len(pose) == 3:
        c, s = np.cos(pose[2]), np.sin(pose[2])
        return np.array([[c, -s], [s, c]]), np.asarray(pose[:2])
    return Rotation.from_quat(pose[:4]).as_matrix(), np.asarray(pose[4:])


def join(rotation, translation):
    if len(translation) == 2:
        return np.append(translation, np.arctan2(rotation[1, 0], rotation[0, 0]))
    return np.append(Rotation.from_matrix(rotation).as_quat(), translation)


def chordal_cost(graph, kappa, tau, poses=None):
    at = [split(pose) for pose in (graph.poses if poses is None else poses)]
    cost = 0.0
    for (i, j), z, k, u in zip(graph.edges, graph.measurements, kappa, tau, strict=True):
        (r_i, t_i), (r_j, t_j), (r, t) = at[i], at[j], split(z)
        cost += k * ((r_j - r_i @ r) ** 2).sum() + u * ((t_j - t_i - r_i @ t) ** 2).sum()
    return cost


def certificate_eigenvalues(graph, kappa, tau):
    """Return the eigenvalues of S at the poses: translations eliminated, and of S itself."""
    at = [split(pose) for pose in graph.poses]
    d, n = graph.dimension, graph.num_poses
    b, columns = d + 1, []
    for (i, j), z, k, u in zip(graph.edges, graph.measurements, kappa, tau, strict=True):
        r, t = split(z)
        for q in range(d):
            column = np.zeros(b * n)
            column[b * j + q] = np.sqrt(k)
            column[b * i : b * i + d] = -np.sqrt(k) * r[:, q]
            columns.append(column)
        column = np.zeros(b * n)
        column[b * j + d], column[b * i + d] = np.sqrt(u), -np.sqrt(u)
        column[b * i : b * i + d] = -np.sqrt(u) * t
        columns.append(column)
    m = np.array(columns).T
    x = np.hstack([np.column_stack([r, t]) for r, t in at])
    y = (x @ m) @ m.T
    s = m @ m.T
    for i in range(n):
        rows = slice(b * i, b * i + d)
        half = x[:, rows].T @ y[:, rows]
        s[rows, rows] -= (half + half.T) / 2
    translations = np.arange(d, b * n, b)[1:]
    rotations = np.setdiff1d(np.arange(b * n), np.arange(d, b * n, b))
    s_tt = s[np.ix_(translations, translations)]
    s_tr = s[np.ix_(translations, rotations)]
    eliminated = s[np.ix_(rotations, rotations)] - s_tr.T @ np.linalg.solve(s_tt, s_tr)
    return np.linalg.eigvalsh(eliminated), np.linalg.eigvalsh(s)


def ring(rng, size, dimension, *, kappa=50.0, tau=100.0, noise=0.02, turns=0, chords=0):
    """Return a ring of poses with true edges, wound by more turns: a minimum of its own."""
    angle = 2 * np.pi * np.arange(size) / size
    radius = size / (2 * np.pi)
    true = []
    for a in angle:
        pose = np.array([radius * np.sin(a), radius * (1 - np.cos(a)), a])
        r, t = split(pose)
        if dimension == 3:
            r = np.block([[r, np.zeros((2, 1))], [np.zeros((1, 2)), np.ones((1, 1))]])
            t = np.append(t, 0.0)
        true.append((r, t))
    pairs = [(i, (i + 1) % size) for i in range(size)]
    pairs += [(int(i), int((i + size // 2) % size)) for i in rng.permutation(size)[:chords]]
    measured = []
    for i, j in pairs:
        (r_i, t_i), (r_j, t_j) = true[i], true[j]
        turn = rng.normal(0, noise, 1 if dimension == 2 else 3)
        error = (
            split(np.append(np.zeros(2), turn))[0]
            if dimension == 2
            else Rotation.from_rotvec(turn).as_matrix()
        )
        measured.append(
            join(r_i.T @ r_j @ error, r_i.T @ (t_j - t_i) + rng.normal(0, noise, dimension))
        )
    start = []
    for a, (r, t) in zip(angle, true, strict=True):
        more = split(np.array([0, 0, turns * a]))[0]
        if dimension == 3:
            more = np.block([[more, np.zeros((2, 1))], [np.zeros((1, 2)), np.ones((1, 1))]])
        start.append(join(r @ more, t))
    weights = [tau, tau, 2 * kappa] if dimension == 2 else [2 * kappa] * 3 + [tau] * 3
    return bundle.PoseGraph(
        poses=np.array(start),
        edges=np.array(pairs, np.int32),
        measurements=np.array(measured),
        information=np.tile(np.diag(weights), (len(pairs), 1, 1)),
    )
