"""Covariances of the poses of a pose graph, and of the variables of a factor graph.

Both are blocks of the inverse of normal equations with named blocks (``normal_equations.py``).

A relative variable B = X_a^-1 X_b moves by B Exp(d_b - Ad d_a) with Ad = Ad(X_b^-1 X_a), the
identity on a Euclidean space, so that its covariance is

    C = G_bb - Ad G_ab - G_ab^T Ad^T + Ad G_aa Ad^T.

Poses that a factor uses as cam_from_world have the relative pose B = X_b X_a^-1 in its place, which
a motion of the world does not change. It moves by B Exp(Ad(X_a) (d_b - d_a)).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from bundle.analysis.factor_equations import FactorEquations
from bundle.analysis.normal_equations import (
    Floats,
    NormalEquations,
    Pairs,
    PoseEquations,
    SelectedInverse,
)
from bundle.analysis.uncertainty.covariance_result import Covariance, SavedBlocks, rows_of
from bundle.base.arrays import freeze
from bundle.base.display import Display
from bundle.base.records import dataclass
from bundle.base.words import few, not_converged, number, plural
from bundle.errors import InputError, brief
from bundle.graphs.factors.factor_graph import FactorGraph
from bundle.graphs.factors.factors import PositionFactor, RelativePoseFactor, ReprojectionFactor
from bundle.graphs.factors.same_problem import AsPoseGraph, pose_graph_of
from bundle.graphs.factors.variables import Key, as_list, variable_name
from bundle.graphs.pose_graphs.edge_weights import check_edges_exist, weighted_graph
from bundle.graphs.pose_graphs.lie_groups import adjoint_between, adjoints
from bundle.interface.analysis_options import SCALES
from bundle.interface.option_fields import choice
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.interface.tabular import Tabular
from bundle.model.rigid_motions import rotation_matrices

GRAPH_GAUGES = ("first", "inner", "none")

LOST = 1e10  # inflation above which the variances have fewer than six digits

FROM_WORLD = (PositionFactor, RelativePoseFactor, ReprojectionFactor)
"""Factors whose poses are cam_from_world."""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class FactorGraphCovariance(SavedBlocks, Tabular):
    """Marginal covariances of the variables of a graph, each with all others estimated as well.

    A covariance is that of the tangent coordinates d in X Exp(d), in the order that
    :class:`bundle.FactorGraph` lists. Constant coordinates have covariance 0.

    Attributes:
        covariances: (t, t) covariance of each variable by key.
        relative_covariances: by pair (a, b) of keys the covariance of X_a^-1 X_b; of X_b X_a^-1 if
            a factor uses one of the poses as cam_from_world. Independent of the gauge, apart from a
            free scale.
        cross_covariances: by pair (a, b) the covariance of d_a with d_b.
        sigma0: root of the weighted squares over the degrees of freedom; 1 if the information of
            the factors is right. NaN without degrees of freedom.
        dof: residuals, minus free coordinates under the gauge.
        gauge: "first", "inner" or "none".
        num_gauge_freedoms: directions of the gauge that the factors leave free.
        scale: "unit": from the information of the factors; "sigma0": multiplied by sigma0^2.
        notes: sentences with remarks on the covariance.
    """

    covariances: Mapping[Key, Floats]
    relative_covariances: Mapping[tuple[Key, Key], Floats]
    cross_covariances: Mapping[tuple[Key, Key], Floats]
    sigma0: float
    dof: int
    gauge: str
    num_gauge_freedoms: int
    scale: str
    notes: tuple[str, ...] = ()

    def _tables(self) -> dict[str, Mapping[str, Any]]:
        """Return standard deviations, one row per coordinate of a variable."""
        rows = [
            (key, coordinate, sigma)
            for key, covariance in self.covariances.items()
            for coordinate, sigma in enumerate(np.sqrt(np.diag(covariance)).tolist())
        ]
        names = ("key", "coordinate", "sigma")
        return {"variables": {name: [row[k] for row in rows] for k, name in enumerate(names)}}

    def variable(self, key: Key) -> Floats:
        """Return the covariance of a variable.

        Raises:
            InputError: the variable does not exist, or was not requested.
        """
        if key not in self.covariances:
            count = plural(len(self.covariances), "variable")
            raise InputError(f"key: expected the key of one of {count}, found {brief(key)}")
        return self.covariances[key]

    def relative(self, key_a: Key, key_b: Key) -> Floats:
        """Return the covariance of a relative variable.

        Raises:
            InputError: the pair was not requested.
        """
        pair = (key_a, key_b)
        if pair not in self.relative_covariances:
            raise InputError(
                f"relative: expected a pair of {[*self.relative_covariances]}, found {brief(pair)}"
            )
        return self.relative_covariances[pair]

    def _arrays(self) -> dict[str, Any]:
        """Return ``keys`` as text, ``covariance_<position>``, ``relative_keys`` and so on."""
        arrays: dict[str, Any] = {
            "keys": np.array([str(key) for key in self.covariances]),
            "relative_keys": np.array(
                [[str(a), str(b)] for a, b in self.relative_covariances]
            ).reshape(-1, 2),
        }
        for name, blocks in (
            ("covariance", self.covariances),
            ("relative_covariance", self.relative_covariances),
            ("cross_covariance", self.cross_covariances),
        ):
            arrays |= {f"{name}_{k}": block for k, block in enumerate(blocks.values())}
        for name in ("sigma0", "dof", "gauge", "scale", "notes"):
            arrays[name] = np.asarray(getattr(self, name))
        return arrays

    def _display(self) -> Display:
        facts = (
            ("of", plural(len(self.covariances), "variable")),
            ("gauge", self.gauge),
            ("scale", self.scale),
            ("sigma0", f"{number(self.sigma0)} ({plural(self.dof, 'degree')} of freedom)"),
        )
        return Display(title="FactorGraphCovariance", facts=facts)


def graph_covariance(
    graph: Any,
    options: PoseGraphOptions | None = None,
    *,
    relative: Iterable[tuple[int, int]] = (),
    gauge: str = "first",
    scale: str = "unit",
    **changes: Any,
) -> Covariance:
    """Compute the covariances of the poses of a graph; see :func:`bundle.covariance`."""
    gauge, scale = choice("gauge", gauge, GRAPH_GAUGES), choice("scale", scale, SCALES)
    weighted = weighted_graph(graph, options, changes, "covariance")
    used = weighted.graph
    if used.num_poses > 1:
        check_edges_exist(used)
    pairs = list(relative)
    rows = rows_of(used.ids, pairs, "pose")
    for k, (a, b) in enumerate(rows):
        if a == b:
            raise InputError(
                f"relative: expected two different poses, found {brief(pairs[k])} at [{k}]"
            )
    equations = PoseEquations(weighted)
    if gauge == "none" and equations.for_gauge:
        raise InputError(
            "gauge: expected a fixed pose in each component for 'none', found "
            f"{plural(equations.num_floating, 'component')} without; 'first' fixes one in each"
        )
    is_plain = weighted.options.loss == "trivial"
    found, factor, facts = selected_covariance(equations, rows, gauge, scale, is_plain)
    return Covariance(
        pose_ids=used.ids,
        pose_covariance=freeze(factor * found.blocks),
        relative_ids=freeze(np.array(pairs, np.int64).reshape(-1, 2)),
        relative_covariance=freeze(factor * found.relative),
        cross_covariance=freeze(factor * found.across),
        held_pose_ids=equations.held_ids,
        **facts,
    )


def selected_covariance(
    equations: NormalEquations, pairs: Pairs, gauge: str, scale: str, without_loss: bool = False
) -> tuple[SelectedInverse, float, dict[str, Any]]:
    """Return blocks of the inverse, the factor of all covariances, and fields of the result.

    Undetermined directions, pairs without a relative position and rounding errors are refused.
    """
    words, squares, dof = equations.words, equations.weighted_squares, equations.dof
    if moving := equations.open_blocks():
        raise _undetermined(equations, moving)
    if apart := equations.separated(pairs):
        raise InputError(
            f"relative: expected {words.block}s that {words.term}s or {words.held}s connect, found "
            f"{equations.name(apart[0])} and {equations.name(apart[1])}"
        )
    found = equations.selected_inverse(gauge == "inner", pairs)
    if found.undetermined >= 0:
        raise _undetermined(equations, [found.undetermined])
    if not np.isfinite(found.inflation):
        raise InputError(
            "graph: expected well-conditioned normal equations, found variances that are only "
            f"rounding errors; {words.shorten}"
        )
    sigma0 = float(np.sqrt(squares / dof)) if dof > 0 else float("nan")
    if scale == "sigma0" and not dof > 0:
        raise InputError(
            f"scale: expected degrees of freedom to estimate sigma0 from, found {dof}; use unit"
        )
    notes = []
    if not found.tests.is_at_minimum(0.5 * squares):
        notes.append(not_converged(200 * found.tests.decrease / squares, without_loss))
    if equations.num_floating > 1:
        notes.append(
            f"{plural(equations.num_floating, 'component')} without a fixed pose: covariances "
            "are relative to the component."
        )
    if found.inflation > LOST:
        digits = plural(max(0, round(16 - np.log10(found.inflation))), "digit")
        notes.append(
            f"Some {words.block} is {number(float(np.sqrt(found.inflation)))} times less certain "
            f"than with all others known: its covariance has about {digits}."
        )
    facts = {"sigma0": sigma0, "dof": dof, "gauge": gauge, "scale": scale, "notes": tuple(notes)}
    return found, sigma0 * sigma0 if scale == "sigma0" else 1.0, facts


def _undetermined(equations: NormalEquations, blocks: Sequence[int]) -> InputError:
    words, names = equations.words, [equations.name(block) for block in blocks]
    return InputError(
        f"graph: expected {words.term}s that determine all {words.block}s but for the gauge, found "
        f"{words.block if len(names) == 1 else words.block + 's'} {few(names)} "
        f"with an undetermined direction; {words.command} names it"
    )


def factor_graph_covariance(
    graph: FactorGraph,
    *,
    of: Iterable[Key] | None = None,
    relative: Iterable[tuple[Key, Key]] = (),
    gauge: str = "first",
    scale: str = "unit",
    num_threads: int = 0,
) -> FactorGraphCovariance:
    """Compute the covariances of the variables of a graph; see :func:`bundle.covariance`.

    A graph of relative poses has those of the pose graph that it represents, whose gauge is known
    without a search for null directions.
    """
    gauge, scale = choice("gauge", gauge, GRAPH_GAUGES), choice("scale", scale, SCALES)
    keys = graph.keys if of is None else _known(graph, "of", as_list("of", "keys", of))
    pairs = [_pair(graph, pair, k) for k, pair in enumerate(as_list("relative", "pairs", relative))]
    if (poses := pose_graph_of(graph)) is not None:
        graph.check_free()
        return _of_pose_graph(poses, keys, pairs, gauge=gauge, scale=scale, num_threads=num_threads)
    equations = FactorEquations(graph, num_threads)
    space = equations.space
    if not space.is_exact:
        raise InputError(
            "graph: expected factors that determine all variables but for the gauge, found "
            f"{space.nullity} free directions; bundle.diagnose says more"
        )
    if gauge == "none" and space.nullity and not space.others.shape[1]:
        raise InputError(
            f"gauge: expected factors or constant variables that fix it for 'none', found "
            f"{plural(space.nullity, 'free direction')}; 'first' fixes a variable"
        )
    place = {key: k for k, key in enumerate(graph.keys)}
    rows = [(place[a], place[b]) for a, b in pairs]
    found, factor, facts = selected_covariance(equations, rows, gauge, scale)
    blocks = [factor * block for block in found.blocks]
    cross = [freeze(factor * block) for block in found.across]
    relative_blocks = [
        freeze(_relative_covariance(graph, pair, blocks[a], blocks[b], across))
        for pair, (a, b), across in zip(pairs, rows, cross, strict=True)
    ]
    return FactorGraphCovariance(
        covariances={key: freeze(blocks[place[key]]) for key in keys},
        relative_covariances=dict(zip(pairs, relative_blocks, strict=True)),
        cross_covariances=dict(zip(pairs, cross, strict=True)),
        num_gauge_freedoms=space.gauge,
        **facts,
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
        num_gauge_freedoms=poses.graph.tangent_size * len(found.held_pose_ids or ()),
        **{name: getattr(found, name) for name in ("sigma0", "dof", "gauge", "scale", "notes")},
    )


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


def _relative_covariance(
    graph: FactorGraph, pair: tuple[Key, Key], of_a: Floats, of_b: Floats, across: Floats
) -> Floats:
    """Return the covariance of a relative variable from G_aa, G_bb and G_ab, (t, t) each."""
    first, second = (graph.variables[key] for key in pair)
    if first.manifold == "se3" and any(
        isinstance(factor, FROM_WORLD) and not set(pair).isdisjoint(factor.keys)
        for factor in graph.factors
    ):
        adjoint = adjoints(first.value[None])[0]
        return np.asarray(adjoint @ (of_b - across - across.T + of_a) @ adjoint.T)
    if first.manifold in ("se2", "se3"):
        adjoint = adjoint_between(second.value[None], first.value)[0]
    elif first.manifold == "so3":
        rotations = rotation_matrices(np.stack([first.value, second.value]))
        adjoint = rotations[1].T @ rotations[0]
    else:
        adjoint = np.eye(len(first.coordinates))
    moved = adjoint @ across
    return np.asarray(of_b - moved - moved.T + adjoint @ of_a @ adjoint.T)
