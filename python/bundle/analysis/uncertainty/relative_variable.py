"""Covariance of a variable relative to another one.

A relative variable B = X_a^-1 X_b moves by B Exp(d_b - Ad d_a) with Ad = Ad(X_b^-1 X_a), the
identity on a Euclidean space, so that its covariance is

    C = G_bb - Ad G_ab - G_ab^T Ad^T + Ad G_aa Ad^T.

Poses that a factor uses as cam_from_world have the relative pose B = X_b X_a^-1 in its place, which
a motion of the world does not change. It moves by B Exp(Ad(X_a) (d_b - d_a)).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.graphs.factors.factor_graph import FactorGraph
from bundle.graphs.factors.factors import PositionFactor, RelativePoseFactor, ReprojectionFactor
from bundle.graphs.factors.variables import Key, Variable
from bundle.graphs.pose_graphs.lie_groups import adjoint_between, adjoints
from bundle.model.rotations import rotation_matrices

FROM_WORLD = (PositionFactor, RelativePoseFactor, ReprojectionFactor)
"""Factors whose poses are cam_from_world."""

Floats = NDArray[np.float64]


def relative_covariance(
    graph: FactorGraph, a: Key, b: Key, of_a: Floats, of_b: Floats, across: Floats
) -> Floats:
    """Return the covariance of a relative variable.

    Args:
        graph: graph with the values of both variables.
        a: key of the first variable.
        b: key of the second one.
        of_a: (t, t) covariance G_aa.
        of_b: (t, t) covariance G_bb.
        across: (t, t) covariance G_ab.
    """
    first, second = graph.variables[a], graph.variables[b]
    if _is_from_world(graph, a, b):
        difference = of_b - across - across.T + of_a
        adjoint = adjoints(first.value[None])[0]
        return np.asarray(adjoint @ difference @ adjoint.T)
    adjoint = _adjoint_between(first, second)
    moved = adjoint @ across
    return np.asarray(of_b - moved - moved.T + adjoint @ of_a @ adjoint.T)


def _is_from_world(graph: FactorGraph, a: Key, b: Key) -> bool:
    """Tell whether a factor uses one of two poses as cam_from_world."""
    if graph.variables[a].manifold != "se3":
        return False
    return any(
        key in (a, b)
        for factor in graph.factors
        if isinstance(factor, FROM_WORLD)
        for key in factor.keys
    )


def _adjoint_between(first: Variable, second: Variable) -> Floats:
    """Return Ad(X_b^-1 X_a)."""
    if first.manifold in ("se2", "se3"):
        return np.asarray(adjoint_between(second.value[None], first.value)[0])
    if first.manifold == "so3":
        rotations = rotation_matrices(np.stack([first.value, second.value]))
        return np.asarray(rotations[1].T @ rotations[0])
    return np.eye(len(first.coordinates))
