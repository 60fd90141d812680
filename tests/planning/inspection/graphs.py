"""Graphs whose elimination everybody can do on paper, and larger ones with a seed."""

import numpy as np


def chain(num_variables):
    """0 - 1 - 2 - ..."""
    return [(i, i + 1) for i in range(num_variables - 1)]


def cycle(num_variables):
    """A chain closed end to end."""
    return [*chain(num_variables), (0, num_variables - 1)]


def star(num_leaves, hub):
    """Leaves, by the other numbers, that meet nobody but the hub."""
    return [(hub, leaf) for leaf in range(num_leaves + 1) if leaf != hub]


def random_graph(num_variables, num_edges, seed):
    """Edges between random variables; some more than once, in either direction."""
    rng = np.random.default_rng(seed)
    a = rng.integers(0, num_variables, num_edges)
    b = (a + rng.integers(1, num_variables, num_edges)) % num_variables
    return np.stack([a, b], 1)


def random_closures(num_poses, num_loops, seed):
    """A chain of poses and loops between random poses that are not neighbours."""
    rng = np.random.default_rng(seed)
    loops = set()
    while len(loops) < num_loops:
        a, b = sorted(rng.integers(0, num_poses, 2).tolist())
        if b > a + 1:
            loops.add((a, b))
    return chain(num_poses) + sorted(loops)


def revisited_aisles(num_poses, num_loops, lap, seed):
    """A chain of poses that comes by the same places every ``lap`` poses and notices at times."""
    rng = np.random.default_rng(seed)
    first = rng.choice(num_poses - lap, num_loops, replace=False).tolist()
    return chain(num_poses) + [(pose, pose + lap) for pose in first]


def adjacency(num_variables, edges):
    """(n, n) booleans: the graph with its diagonal."""
    matrix = np.eye(num_variables, dtype=bool)
    for a, b in edges:
        matrix[a, b] = matrix[b, a] = True
    return matrix


def eliminate_in_full(matrix, order):
    """Return the pattern of L of a permuted matrix, by elimination of a full array."""
    pattern = matrix[np.ix_(order, order)].copy()
    for k in range(len(pattern)):
        below = np.flatnonzero(pattern[k + 1 :, k]) + k + 1
        pattern[np.ix_(below, below)] = True
    return np.tril(pattern)
