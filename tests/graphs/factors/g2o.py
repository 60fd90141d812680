"""A helper that makes factor graphs of the shared g2o files."""

import bz2
from pathlib import Path

import numpy as np

import bundle


def upper_triangle(numbers, size):
    matrix = np.zeros((size, size))
    matrix[np.triu_indices(size)] = numbers
    return np.triu(matrix) + np.triu(matrix, 1).T


def read(path: Path) -> bundle.FactorGraph:
    """Poses and edges of SE2 or SE3:QUAT, the first pose fixed."""
    graph = bundle.FactorGraph()
    edges = []
    for line in bz2.decompress(path.read_bytes()).decode().splitlines():
        kind, *numbers = line.split()
        if kind.startswith("VERTEX"):
            key, values = int(numbers[0]), np.array(numbers[1:], float)
            planar = kind == "VERTEX_SE2"
            graph.add_variable(
                key,
                values if planar else np.append(values[3:], values[:3]),
                "se2" if planar else "se3",
                fixed=not graph.keys,
            )
        elif kind.startswith("EDGE"):
            edges.append((int(numbers[0]), int(numbers[1]), np.array(numbers[2:], float)))
    for a, b, numbers in edges:
        if len(numbers) == 3 + 6:
            measurement, information = numbers[:3], upper_triangle(numbers[3:], 3)
        else:  # ours has the rotation first
            measurement = np.append(numbers[3:7], numbers[:3])
            order = [3, 4, 5, 0, 1, 2]
            information = upper_triangle(numbers[7:], 6)[np.ix_(order, order)]
        graph.add_factor(bundle.BetweenFactor(a, b, measurement, information))
    return graph
