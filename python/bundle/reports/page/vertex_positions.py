"""Layout of a small graph, with distances in the plane close to distances in the graph.

Stress majorisation (Gansner, Koren and North 2004) reduces the sum over pairs of
(distance in the plane / distance in the graph - 1)^2 in every round. The graph determines the
start, so the same graph always has the same layout. Cycles become circles, and chains
become lines.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

ROUNDS = 300


def place(num_vertices: int, edges: Sequence[tuple[int, int]]) -> NDArray[np.float64]:
    """Return (num_vertices, 2) positions within the unit square."""
    if num_vertices < 3:
        return np.stack([np.linspace(0, 1, num_vertices), np.full(num_vertices, 0.5)], axis=1)
    distance = _distances(num_vertices, edges)
    positions = _classical_scaling(distance)
    np.fill_diagonal(distance, 1.0)
    weight = distance**-2.0
    np.fill_diagonal(weight, 0.0)
    # Weighted Laplacian without its last row and column: a common shift has no effect.
    laplacian = (np.diag(weight.sum(1)) - weight)[:-1, :-1]
    for _ in range(ROUNDS):
        offset = positions[:, None] - positions[None]
        apart = np.linalg.norm(offset, axis=2)
        np.fill_diagonal(apart, 1.0)
        pull = weight * distance / np.maximum(apart, 1e-9)
        target = (pull[..., None] * offset).sum(1)
        positions = np.vstack([np.linalg.solve(laplacian, target[:-1]), [0.0, 0.0]])
    low, high = positions.min(0), positions.max(0)
    centred: NDArray[np.float64] = (positions - (low + high) / 2) / max((high - low).max(), 1e-9)
    return centred + 0.5


def _distances(num_vertices: int, edges: Sequence[tuple[int, int]]) -> NDArray[np.float64]:
    """Return graph distances; between components, 0.75 times the largest distance plus 1.5."""
    distance = np.full((num_vertices, num_vertices), np.inf)
    for a, b in edges:
        distance[a, b] = distance[b, a] = 1.0
    np.fill_diagonal(distance, 0.0)
    for middle in range(num_vertices):
        through = distance[:, [middle]] + distance[[middle]]
        np.minimum(distance, through, out=distance)
    reached = distance[np.isfinite(distance)].max()
    distance[np.isinf(distance)] = 0.75 * reached + 1.5
    return distance


def _classical_scaling(distance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the start by classical scaling (Torgerson 1952), the best plane for the distances.

    Vertices at the same position, such as leaves of a star, are moved slightly apart.
    """
    size = len(distance)
    centring = np.eye(size) - 1.0 / size
    values, vectors = np.linalg.eigh(-0.5 * centring @ distance**2 @ centring)
    start = vectors[:, -2:] * np.sqrt(np.maximum(values[-2:], 0.0))
    angle = 2.0 * np.pi * np.arange(size) / size
    return np.stack([start[:, 1], start[:, 0]], axis=1) + 0.2 * np.stack(
        [np.cos(angle), np.sin(angle)], axis=1
    )
