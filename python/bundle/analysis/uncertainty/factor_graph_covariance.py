"""Covariances of the variables of a factor graph; ``factor_graph_certainty.cpp`` derives them.

A graph of relative poses has those of the pose graph that it states (``graph_covariance.cpp``),
whose gauge is known without a search for null directions.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.analysis.uncertainty.graph_covariance import graph_covariance
from bundle.analysis.uncertainty.relative_variable import relative_covariance
from bundle.base.arrays import FrozenArrays, freeze
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import not_converged, number, plural
from bundle.errors import InputError, brief
from bundle.graphs.factors.factor_graph import FactorGraph
from bundle.graphs.factors.null_space import NullSpace, find_null_space
from bundle.graphs.factors.same_problem import AsPoseGraph, pose_graph_of
from bundle.graphs.factors.variables import Key, as_list, variable_name
from bundle.interface.covariance_options import SCALES, one_of
from bundle.interface.tabular import Tabular
from bundle.io.atomic import atomic_write as atomic

GAUGES = ("first", "inner", "none")

AT_MINIMUM = 1e-4
"""Relative decrease of the cost by one more step, below which a state counts as a minimum."""

LOST = 1e10
"""Inflation above which the variances have fewer than six digits."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class FactorGraphCovariance(FrozenArrays, Displayed, Tabular):
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

    def save(self, path: str | Path) -> None:
        """Write an .npz file: ``keys`` as text, ``covariance_<position>``, ``relative_keys``, ...

        A failed write leaves no partial file.

        Raises:
            OSError: the file cannot be written.
        """
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
        with atomic.replace_file(Path(path)) as temporary, temporary.open("wb") as stream:
            np.savez(stream, **arrays)

    def _display(self) -> Display:
        facts = (
            ("of", plural(len(self.covariances), "variable")),
            ("gauge", self.gauge),
            ("scale", self.scale),
            ("sigma0", f"{number(self.sigma0)} ({plural(self.dof, 'degree')} of freedom)"),
        )
        return Display(title="FactorGraphCovariance", facts=facts)


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

    Raises:
        InputError: an argument is wrong, a key does not exist, all coordinates are constant, the
            gauge or the factors leave directions free, or sigma0 has no degrees of freedom.
    """
    gauge, scale = one_of("gauge", gauge, GAUGES), one_of("scale", scale, SCALES)
    keys = graph.keys if of is None else _known(graph, "of", as_list("of", "keys", of))
    pairs = [_pair(graph, pair, k) for k, pair in enumerate(as_list("relative", "pairs", relative))]
    if (poses := pose_graph_of(graph)) is not None:
        graph.check_free()
        return _of_pose_graph(poses, keys, pairs, gauge=gauge, scale=scale, num_threads=num_threads)
    space = find_null_space(graph)
    _check_determined(graph, space, gauge)
    _check_connected(graph, space, pairs)
    held = space.held()
    place = {key: k for k, key in enumerate(graph.keys)}
    rows = [(place[a], place[b]) for a, b in pairs]
    seed = np.where((held & ~space.constant)[:, None], space.directions, 0.0)
    threads = num_threads or _core.hardware_threads()
    out = _core.factor_graph_certainty(
        *graph.core(), held, rows, seed if gauge == "inner" else seed[:, :0], False, threads
    )
    if out["undetermined"] >= 0:
        raise _undetermined(graph, [int(out["undetermined"])])
    if not np.isfinite(out["inflation"]):
        raise InputError(
            "graph: expected well-conditioned normal equations, found variances that are only "
            "rounding errors; hold another variable constant"
        )
    weighted, num_residuals = _weighted_squares(graph)
    dof = num_residuals - int((~held).sum())
    sigma0 = float(np.sqrt(weighted / dof)) if dof > 0 else float("nan")
    if scale == "sigma0" and not dof > 0:
        raise InputError(
            f"scale: expected degrees of freedom to estimate sigma0 from, found {dof}; use unit"
        )
    factor = sigma0 * sigma0 if scale == "sigma0" else 1.0
    blocks = [factor * block for block in out["variables"]]
    cross = {pair: freeze(factor * block) for pair, block in zip(pairs, out["across"], strict=True)}
    return FactorGraphCovariance(
        covariances={key: freeze(blocks[place[key]]) for key in keys},
        relative_covariances={
            (a, b): freeze(
                relative_covariance(graph, a, b, blocks[place[a]], blocks[place[b]], cross[a, b])
            )
            for a, b in pairs
        },
        cross_covariances=cross,
        sigma0=sigma0,
        dof=dof,
        gauge=gauge,
        num_gauge_freedoms=space.gauge,
        scale=scale,
        notes=_notes(out, weighted),
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


def _notes(out: dict[str, Any], weighted: float) -> tuple[str, ...]:
    notes = []
    decrease = float(out["predicted_decrease"])
    if decrease > AT_MINIMUM * 0.5 * weighted and decrease > 1e-9:
        notes.append(not_converged(200 * decrease / weighted, without_loss=False))
    if out["inflation"] > LOST:
        digits = max(0, round(16 - np.log10(out["inflation"])))
        notes.append(
            f"Some variable is {number(float(np.sqrt(out['inflation'])))} times less certain than "
            f"with all others known: its covariance has about {plural(digits, 'digit')}."
        )
    return tuple(notes)


def _weighted_squares(graph: FactorGraph) -> tuple[float, int]:
    """Return the sum of rho' ||r||^2 over the factors, and the number of residuals."""
    _, squares, sizes = _core.factor_costs(*graph.core())
    weights = np.ones(len(squares))
    for k, factor in enumerate(graph.factors):
        if factor.loss != "trivial":
            weights[k] = _core.edge_loss(factor.loss, factor.loss_scale, float(squares[k]))[1]
    return float((weights * squares).sum()), int(sizes.sum())


def _check_determined(graph: FactorGraph, space: NullSpace, gauge: str) -> None:
    if not space.is_exact:
        raise InputError(
            "graph: expected factors that determine all variables but for the gauge, found "
            f"{space.nullity} free directions; bundle.diagnose says more"
        )
    if space.others.shape[1]:
        raise _undetermined(graph, space.moving(space.others).tolist())
    if gauge == "none" and space.nullity:
        raise InputError(
            f"gauge: none expects factors or constant variables that fix the gauge, found "
            f"{plural(space.nullity, 'free direction')}; first holds a variable"
        )


def _check_connected(graph: FactorGraph, space: NullSpace, pairs: Iterable[Any]) -> None:
    """Refuse relative variables whose components move against each other."""
    label = dict(zip(graph.keys, space.labels.tolist(), strict=True))
    for a, b in pairs:
        if label[a] != label[b] and any(space.nullities.get(label[key]) for key in (a, b)):
            raise InputError(
                "relative: expected variables that factors or constant variables connect, found "
                f"{brief(a)} and {brief(b)}"
            )


def _undetermined(graph: FactorGraph, positions: list[int]) -> InputError:
    names = ", ".join(brief(graph.keys[k]) for k in positions[:3])
    more = f" and {len(positions) - 3} more" if len(positions) > 3 else ""
    noun = "variable" if len(positions) == 1 else "variables"
    return InputError(
        f"graph: expected factors that determine all variables but for the gauge, found {noun} "
        f"{names}{more} with a direction open; bundle.diagnose says which"
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
