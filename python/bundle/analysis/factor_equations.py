"""Normal equations of a factor graph, by its Jacobian; ``factor_graph_certainty.cpp`` derives them.

The gauge and the undetermined directions are those of ``graphs/factors/null_space.py``.

A weak mode has an eigenvalue below ``WEAK``, and the next one is ``GAP`` times as large. The
eigenvalues of a long chain grow by the squares of the whole numbers and have no such gap. A gauge
that only a prior with a large sigma holds has such a gap. Condition numbers are those with the
gauge held. Factors are tested against all others as edges of a pose graph are.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.analysis.diagnosis.diagnose_graph import (
    MOST_MODES,
    MOST_NAMED,
    graph_diagnosis,
    tests_of,
)
from bundle.analysis.diagnosis.diagnosis_result import Component, Diagnosis, WeakMode
from bundle.analysis.normal_equations import Floats, Pairs, SelectedInverse, TermTests, Words
from bundle.base.words import named, number, plural
from bundle.errors import brief
from bundle.graphs.factors.contents import factor_name
from bundle.graphs.factors.factor_graph import FactorGraph
from bundle.graphs.factors.null_space import NullSpace, find_null_space
from bundle.graphs.factors.same_problem import AsPoseGraph

WEAK, GAP = 1e-6, 1e3

SHARE = 0.1  # share of the largest motion above which a sentence names a variable or a coordinate

VARIABLES = Words(
    *("variable", "factor", "constant variable", "bundle.diagnose"),
    *("keep another variable constant", "solve with a loss on it"),
)


class FactorEquations:
    """Normal equations of a factor graph; :class:`NormalEquations`."""

    words = VARIABLES
    num_floating = 0

    def __init__(self, graph: FactorGraph, num_threads: int = 0) -> None:
        self.graph, self._threads = graph, num_threads or _core.hardware_threads()
        self.space = find_null_space(graph)
        self.held = self.space.held()
        self.num_gauge = self.space.gauge
        self._core = graph.core()
        self.costs, self.squares, sizes = _core.factor_costs(*self._core)
        self.cost = float(self.costs.sum())
        weights = np.ones(len(self.squares))
        for k, factor in enumerate(graph.factors):
            if factor.loss != "trivial":
                square = float(self.squares[k])
                weights[k] = _core.edge_loss(factor.loss, factor.loss_scale, square)[1]
        self.weighted_squares = float((weights * self.squares).sum())
        self.dof = int(sizes.sum()) - int((~self.held).sum())

    def name(self, block: int) -> str:
        """Return the name of a block."""
        return brief(self.graph.keys[block])

    def open_blocks(self) -> list[int]:
        """Return the blocks that null directions beyond the gauge move, or may move."""
        if not self.space.is_exact:
            return list(range(len(self.graph.keys)))
        others = self.space.others
        return self.space.moving(others).tolist() if others.shape[1] else []

    def separated(self, pairs: Pairs) -> tuple[int, int] | None:
        """Return the first pair whose components move against each other."""
        labels = self.space.labels.tolist()
        for a, b in pairs:
            if labels[a] != labels[b] and any(self.space.nullities.get(labels[k]) for k in (a, b)):
                return a, b
        return None

    def selected_inverse(
        self, is_inner: bool = False, pairs: Pairs = (), with_tests: bool = False
    ) -> SelectedInverse:
        """Return blocks of the inverse."""
        space = self.space
        seed = np.where((self.held & ~space.constant)[:, None], space.directions, 0.0)
        out = _core.factor_graph_certainty(
            *self._core,
            self.held,
            list(pairs),
            seed if is_inner else seed[:, :0],
            with_tests,
            self._threads,
        )
        redundancy, test, rank = (np.array(out[name]) for name in ("redundancy", "test", "rank"))
        tests = TermTests(redundancy, test, rank, float(out["predicted_decrease"]))
        found = (int(out["undetermined"]), float(out["inflation"]), tests)
        return SelectedInverse(out["variables"], (), out["across"], *found)

    @cached_property
    def spectrum(self) -> dict[str, Any] | None:
        """Spectrum of the determined part; None if directions are not known."""
        if not self.space.is_exact:
            return None
        return _core.factor_graph_spectrum(*self._core, self.held, 0, self._threads)


def diagnose_factor_graph(graph: FactorGraph, num_threads: int = 0) -> Diagnosis:
    """Diagnose a factor graph by its Jacobian; see :func:`bundle.diagnose`."""
    equations = FactorEquations(graph, num_threads)
    space = equations.space
    components = _components(graph, space)

    def factor(k: int) -> tuple[tuple[Any, ...], None, str]:
        return graph.factors[k].keys, None, factor_name(k, graph.factors[k])

    return graph_diagnosis(
        equations,
        tests_of(equations, len(graph.factors)),
        equations.squares,
        factor,
        {
            "nullity": space.nullity,
            "nullity_is_exact": space.is_exact,
            "components": components,
            "weak_modes": (
                *_component_modes(graph, components, space),
                *_open_modes(graph, space),
                *_weak_modes(graph, space, equations.spectrum),
            ),
            "held_pose_ids": _held_keys(graph, space, equations.held),
        },
    )


def with_keys(found: Diagnosis, poses: AsPoseGraph) -> Diagnosis:
    """Return the diagnosis of a pose graph with the keys of its factor graph in place of ids."""
    key_of = dict(zip(poses.graph.ids.tolist(), poses.keys, strict=True))

    def edge(ends: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(key_of[end] for end in ends)

    return replace(
        found,
        components=tuple(replace(part, pose_ids=edge(part.pose_ids)) for part in found.components),
        held_pose_ids=edge(found.held_pose_ids),
        weak_modes=tuple(
            replace(mode, pose_ids=edge(mode.pose_ids), edges=tuple(map(edge, mode.edges)))
            for mode in found.weak_modes
        ),
        suspicious_edges=tuple(replace(one, edge=edge(one.edge)) for one in found.suspicious_edges),
    )


def _held_keys(graph: FactorGraph, space: NullSpace, held: NDArray[np.bool_]) -> tuple[Any, ...]:
    """Return the variables with coordinates that are held for the gauge."""
    for_gauge = np.logical_or.reduceat(held & ~space.constant, space.begin[:-1])
    return tuple(key for key, flag in zip(graph.keys, for_gauge, strict=True) if flag)


def _components(graph: FactorGraph, space: NullSpace) -> tuple[Component, ...]:
    """Return the components of free variables, the largest first."""
    keys = graph.keys
    is_free = ~np.logical_and.reduceat(space.constant, space.begin[:-1])
    label = dict(zip(keys, space.labels.tolist(), strict=True))
    free = {key for key, flag in zip(keys, is_free, strict=True) if flag}
    counts: Counter[int] = Counter()
    fixed: dict[int, set[Any]] = {}
    for factor in graph.factors:
        of = next((label[key] for key in factor.keys if key in free), None)
        if of is not None:
            counts[of] += 1
            fixed.setdefault(of, set()).update(key for key in factor.keys if key not in free)
    members: dict[int, list[Any]] = {}
    for key in keys:
        if key in free:
            members.setdefault(label[key], []).append(key)
    parts = [
        Component(pose_ids=tuple(part), num_edges=counts[of], num_fixed=len(fixed.get(of, ())))
        for of, part in members.items()
    ]
    return tuple(sorted(parts, key=lambda part: -len(part.pose_ids)))


def _component_modes(
    graph: FactorGraph, components: tuple[Component, ...], space: NullSpace
) -> list[WeakMode]:
    """Return the components but the largest; those that float by themselves are a problem."""
    label = dict(zip(graph.keys, space.labels.tolist(), strict=True))
    modes = []
    for part in components[1 : 1 + MOST_MODES]:
        free = space.nullities.get(label[part.pose_ids[0]], 0)
        state = f"it has {plural(free, 'null direction')}" if free else "its own factors hold it"
        modes.append(
            WeakMode(
                kind="component",
                sentence=f"{_named(part.pose_ids)} ({plural(part.num_edges, 'factor')}): no factor "
                f"joins this component with the largest, of "
                f"{plural(len(components[0].pose_ids), 'variable')}; {state}.",
                pose_ids=part.pose_ids,
                dimension=free,
            )
        )
    return modes


def _open_modes(graph: FactorGraph, space: NullSpace) -> list[WeakMode]:
    """Return the directions that no factor determines, apart from the gauge."""
    modes = []
    for direction in space.others.T[:MOST_MODES]:
        keys = _moving(graph, space, direction)
        modes.append(
            WeakMode(
                kind="open_direction",
                sentence=f"{_named(keys)}: no factor determines {_motion(graph, space, direction)}"
                ". Add a factor with information there, or hold it constant.",
                pose_ids=keys,
                edges=_factors_of(graph, keys),
            )
        )
    return modes


def _weak_modes(
    graph: FactorGraph, space: NullSpace, spectrum: dict[str, Any] | None
) -> list[WeakMode]:
    """Return the modes below the last gap of the eigenvalues."""
    if spectrum is None:
        return []
    values: Floats = np.asarray(spectrum["eigenvalues"])
    gaps = np.flatnonzero((values[:-1] < WEAK) & (values[1:] > GAP * values[:-1]))
    modes = []
    for k in range(int(gaps[-1]) + 1 if len(gaps) else 0):
        direction = spectrum["directions"][:, k]
        keys = _moving(graph, space, direction)
        inflation = number(float(1 / np.sqrt(max(values[k], 1e-300))))
        modes.append(
            WeakMode(
                kind="weak_direction",
                sentence=f"{_named(keys)}: the factors determine "
                f"{_motion(graph, space, direction)} weakly: the sigma is {inflation} times that "
                "with all other coordinates known. Add a factor, or check their information.",
                pose_ids=keys,
                edges=_factors_of(graph, keys),
                eigenvalue=float(values[k]),
            )
        )
    return modes


def _moving(graph: FactorGraph, space: NullSpace, direction: Floats) -> tuple[Any, ...]:
    """Return the keys that a direction moves, those that move most first."""
    largest = np.maximum.reduceat(np.abs(direction), space.begin[:-1])
    order = np.argsort(-largest, kind="stable")
    return tuple(graph.keys[k] for k in order if largest[k] >= SHARE * largest.max())


def _motion(graph: FactorGraph, space: NullSpace, direction: Floats) -> str:
    """Return the coordinates of the variable that moves most, such as "x, angle of 'x7'"."""
    position = int(np.argmax(np.maximum.reduceat(np.abs(direction), space.begin[:-1])))
    variable = graph.variables[graph.keys[position]]
    part = np.abs(direction[space.begin[position] : space.begin[position + 1]])
    chosen = [
        name
        for name, size in zip(variable.coordinates, part, strict=True)
        if size >= SHARE * part.max()
    ]
    return f"{', '.join(chosen)} of {brief(variable.key)}"


def _factors_of(graph: FactorGraph, keys: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return the keys of the factors that join moving variables with others."""
    moving = set(keys)
    return tuple(
        factor.keys
        for factor in graph.factors
        if not moving.isdisjoint(factor.keys) and not moving.issuperset(factor.keys)
    )[:MOST_NAMED]


def _named(keys: tuple[Any, ...]) -> str:
    return named("Variable", [brief(key) for key in keys])
