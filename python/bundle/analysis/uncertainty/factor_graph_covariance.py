"""Covariances of the variables of a factor graph; ``factor_graph_certainty.cpp`` derives them.

A graph of relative poses has those of the pose graph that it states, whose gauge is known without a
search for null directions.

A relative variable B = X_a^-1 X_b moves by B Exp(d_b - Ad d_a) with Ad = Ad(X_b^-1 X_a), the
identity on a Euclidean space, so that its covariance is

    C = G_bb - Ad G_ab - G_ab^T Ad^T + Ad G_aa Ad^T.

Poses that a factor uses as cam_from_world have the relative pose B = X_b X_a^-1 in its place, which
a motion of the world does not change. It moves by B Exp(Ad(X_a) (d_b - d_a)).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.analysis.uncertainty.covariance_result import (
    FactorGraphCovariance,
)
from bundle.analysis.uncertainty.graph_covariance import (
    GRAPH_GAUGES,
    GraphWords,
    graph_covariance,
    scaled,
    unconnected,
    undetermined,
)
from bundle.base.arrays import freeze
from bundle.base.words import plural
from bundle.errors import InputError, brief
from bundle.graphs.factors.factor_graph import FactorGraph
from bundle.graphs.factors.factors import PositionFactor, RelativePoseFactor, ReprojectionFactor
from bundle.graphs.factors.null_space import NullSpace, find_null_space
from bundle.graphs.factors.same_problem import AsPoseGraph, pose_graph_of
from bundle.graphs.factors.variables import Key, Variable, as_list, variable_name
from bundle.graphs.pose_graphs.lie_groups import adjoint_between, adjoints
from bundle.interface.analysis_options import SCALES, one_of
from bundle.model.rigid_motions import rotation_matrices

FROM_WORLD = (PositionFactor, RelativePoseFactor, ReprojectionFactor)
"""Factors whose poses are cam_from_world."""

VARIABLES = GraphWords(
    *("variable", "factor", "constant variable", "bundle.diagnose"),
    "hold another variable constant",
)

Floats = NDArray[np.float64]


def factor_graph_covariance(
    graph: FactorGraph,
    *,
    of: Iterable[Key] | None = None,
    relative: Iterable[tuple[Key, Key]] = (),
    gauge: str = "first",
    scale: str = "unit",
    num_threads: int = 0,
) -> FactorGraphCovariance:
    """Compute the covariances of the variables of a graph; see :func:`bundle.covariance`."""
    gauge, scale = one_of("gauge", gauge, GRAPH_GAUGES), one_of("scale", scale, SCALES)
    keys = graph.keys if of is None else _known(graph, "of", as_list("of", "keys", of))
    pairs = [_pair(graph, pair, k) for k, pair in enumerate(as_list("relative", "pairs", relative))]
    if (poses := pose_graph_of(graph)) is not None:
        graph.check_free()
        return _of_pose_graph(poses, keys, pairs, gauge=gauge, scale=scale, num_threads=num_threads)
    space = find_null_space(graph)
    _check_variables(graph, space, gauge, pairs)
    held = space.held()
    place = {key: k for k, key in enumerate(graph.keys)}
    rows = [(place[a], place[b]) for a, b in pairs]
    seed = np.where((held & ~space.constant)[:, None], space.directions, 0.0)
    threads = num_threads or _core.hardware_threads()
    out = _core.factor_graph_certainty(
        *graph.core(), held, rows, seed if gauge == "inner" else seed[:, :0], False, threads
    )
    if out["undetermined"] >= 0:
        raise undetermined(VARIABLES, [brief(graph.keys[int(out["undetermined"])])])
    weighted, num_residuals = _weighted_squares(graph)
    dof = num_residuals - int((~held).sum())
    sigma0, factor, notes = scaled(VARIABLES, out, weighted, dof, scale)
    blocks = [factor * block for block in out["variables"]]
    cross = {pair: freeze(factor * block) for pair, block in zip(pairs, out["across"], strict=True)}
    return FactorGraphCovariance(
        covariances={key: freeze(blocks[place[key]]) for key in keys},
        relative_covariances={
            (a, b): freeze(
                _relative_covariance(graph, a, b, blocks[place[a]], blocks[place[b]], cross[a, b])
            )
            for a, b in pairs
        },
        cross_covariances=cross,
        sigma0=sigma0,
        dof=dof,
        gauge=gauge,
        num_gauge_freedoms=space.gauge,
        scale=scale,
        notes=notes,
    )


def _of_pose_graph(
    poses: AsPoseGraph, keys: Iterable[Key], pairs: list[tuple[Key, Key]], **settings: Any
) -> FactorGraphCovariance:
    ids = dict(zip(poses.keys, poses.graph.ids.tolist(), strict=True))
    place = {key: k for k, key in enumerate(poses.keys)}
    found = graph_covariance(poses.graph, relative=[(ids[a], ids[b]) for a, b in pairs], **settings)
    return FactorGraphCovariance(
        covariances={key: freeze(found.pose_covariance[place[key]]) for key in keys},
        relative_covariances=dict(zip(pairs, found.relative_covariance, strict=True)),
        cross_covariances=dict(zip(pairs, found.cross_covariance, strict=True)),
        sigma0=found.sigma0,
        dof=found.dof,
        gauge=found.gauge,
        num_gauge_freedoms=poses.graph.tangent_size * len(found.held_pose_ids),
        scale=found.scale,
        notes=found.notes,
    )


def _check_variables(
    graph: FactorGraph, space: NullSpace, gauge: str, pairs: Iterable[tuple[Key, Key]]
) -> None:
    """Refuse undetermined directions, and pairs whose components move against each other."""
    if not space.is_exact:
        raise InputError(
            "graph: expected factors that determine all variables but for the gauge, found "
            f"{space.nullity} free directions; bundle.diagnose says more"
        )
    if space.others.shape[1]:
        moving = space.moving(space.others).tolist()
        raise undetermined(VARIABLES, [brief(graph.keys[k]) for k in moving])
    if gauge == "none" and space.nullity:
        raise InputError(
            f"gauge: none expects factors or constant variables that fix the gauge, found "
            f"{plural(space.nullity, 'free direction')}; first holds a variable"
        )
    label = dict(zip(graph.keys, space.labels.tolist(), strict=True))
    for a, b in pairs:
        if label[a] != label[b] and any(space.nullities.get(label[key]) for key in (a, b)):
            raise unconnected(VARIABLES, brief(a), brief(b))


def _known(graph: FactorGraph, argument: str, keys: Iterable[Any]) -> tuple[Key, ...]:
    found = tuple(keys)
    for key in found:
        graph.variable(argument, key)
    return found


def _pair(graph: FactorGraph, pair: Any, k: int) -> tuple[Key, Key]:
    if not isinstance(pair, tuple | list) or len(pair) != 2:
        raise InputError(f"relative: expected pairs of keys, found {brief(pair)} at [{k}]")
    a, b = _known(graph, "relative", pair)
    if a == b:
        raise InputError(f"relative: expected two different keys, found {brief(pair)} at [{k}]")
    first, second = graph.variables[a], graph.variables[b]
    if first.manifold != second.manifold or len(first.value) != len(second.value):
        raise InputError(
            f"relative: {variable_name(a)} and {variable_name(b)}: expected variables of one kind, "
            f"found {first.manifold} ({len(first.value)}) and {second.manifold} "
            f"({len(second.value)})"
        )
    return a, b


def _weighted_squares(graph: FactorGraph) -> tuple[float, int]:
    """Return the sum of rho' ||r||^2 over the factors, and the number of residuals."""
    _, squares, sizes = _core.factor_costs(*graph.core())
    weights = np.ones(len(squares))
    for k, factor in enumerate(graph.factors):
        if factor.loss != "trivial":
            weights[k] = _core.edge_loss(factor.loss, factor.loss_scale, float(squares[k]))[1]
    return float((weights * squares).sum()), int(sizes.sum())


def _relative_covariance(
    graph: FactorGraph, a: Key, b: Key, of_a: Floats, of_b: Floats, across: Floats
) -> Floats:
    """Return the covariance of a relative variable from G_aa, G_bb and G_ab, (t, t) each."""
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
    return graph.variables[a].manifold == "se3" and any(
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
