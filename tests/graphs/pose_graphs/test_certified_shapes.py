"""Verdicts on grids, chains with loops, hubs and joined rings, from true and planted starts."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from tests.graphs.pose_graphs.chordal_oracle import join, split
from tests.graphs.pose_graphs.graphs import random_pose

SHAPES = ("grid", "chain", "hub", "rings")
SPANS = (0, 2, 6)
"""Powers of ten between the weights of edges."""


def edges_of(shape, rng):
    if shape == "grid":
        at = np.arange(np.prod(size := rng.integers(2, 6, 2))).reshape(size)
        along = np.stack([at[:, :-1].ravel(), at[:, 1:].ravel()], axis=1)
        return np.vstack([along, np.stack([at[:-1].ravel(), at[1:].ravel()], axis=1)])
    if shape == "chain":
        size = int(rng.integers(6, 40))
        loops = np.sort([rng.choice(size, 2, replace=False) for _ in range(rng.integers(1, 8))])
        return np.vstack([[(k, k + 1) for k in range(size - 1)], loops[np.ptp(loops, axis=1) > 1]])
    if shape == "hub":
        size = int(rng.integers(4, 16))
        spokes = [(0, k) for k in range(1, size)]
        return np.array([*spokes, *((k, k % (size - 1) + 1) for k in range(1, size, 2))])
    one, two = rng.integers(6, 16, 2)  # rings that share their first pose
    other = [0, *range(one, one + two - 1), 0]
    ring = [(k, (k + 1) % one) for k in range(one)]
    return np.array([*ring, *itertools.pairwise(other)])


def made(seed):
    """A graph at its true poses, with errors of 3 % of the sigmas."""
    rng = np.random.default_rng(seed)
    dimension = 2 + seed % 2
    edges = np.unique(edges_of(SHAPES[seed // 2 % 4], rng), axis=0)
    true = [split(random_pose(rng, dimension, size=3.0)) for _ in range(edges.max() + 1)]
    kappa, tau = 10 ** rng.uniform(0, rng.choice(SPANS), (2, len(edges)))
    measured, information = [], []
    for (i, j), k, t in zip(edges.tolist(), kappa, tau, strict=True):
        (r_i, t_i), (r_j, t_j) = true[i], true[j]
        turn, shift = split(
            random_pose(rng, dimension, angle=0.03 / np.sqrt(k), size=0.03 / np.sqrt(t))
        )
        measured.append(join(r_i.T @ r_j @ turn, r_i.T @ (t_j - t_i) + shift))
        information.append(np.diag([t, t, 2 * k] if dimension == 2 else [2 * k] * 3 + [t] * 3))
    return bundle.PoseGraph(
        poses=np.array([join(*pose) for pose in true]),
        edges=edges.astype(np.int32),
        measurements=np.array(measured),
        information=np.array(information),
    )


def starts(graph, rng):
    """The true poses; the widest loop wound once more, both ways; half of the poses turned over."""
    yield graph
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    first, last = graph.edges[np.argmax(np.ptp(graph.edges, axis=1))]
    share = np.clip((np.arange(graph.num_poses) - first) / (last - first + 1), 0, 1)
    for angles in (2 * np.pi * share, -2 * np.pi * share, np.pi * (share >= 0.5)):
        poses = []
        for (r, t), angle in zip(map(split, graph.poses), angles, strict=True):
            flat = split(np.array([0, 0, angle]))[0]
            more = flat if graph.dimension == 2 else Rotation.from_rotvec(angle * axis).as_matrix()
            poses.append(join(r @ more, t))
        yield graph.replace(poses=np.array(poses))


def certificates(seed):
    return [
        bundle.certify(bundle.solve(start, init="file", max_num_iterations=500), max_rank=0)
        for start in starts(made(seed), np.random.default_rng(seed))
    ]


@pytest.mark.parametrize("seed", range(50))
def test_optima_are_certified_and_no_other_minimum(seed):
    found = certificates(seed)
    best = min(one.cost for one in found)
    assert found[0].verdict == "certified"
    assert found[0].cost == pytest.approx(best, rel=1e-6)
    for one in found:
        assert one.lower_bound <= best * (1 + 1e-9)
        if one.cost > best * (1 + 1e-5):
            assert one.verdict != "certified"
        else:
            assert one.verdict != "not-certified"


def test_some_starts_end_in_planted_minima():
    """So that the test above has something to refuse."""
    verdicts = [one.verdict for seed in range(50) for one in certificates(seed)]
    assert verdicts.count("not-certified") >= 10
