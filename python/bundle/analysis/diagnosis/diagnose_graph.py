"""Diagnosis of a pose graph: rank, conditioning, components, suspicious edges."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.analysis.diagnosis.diagnosis_result import (
    Component,
    Diagnosis,
    SuspiciousEdge,
    WeakMode,
)
from bundle.analysis.normal_equations import NormalEquations, PoseEquations, TermTests, Words
from bundle.base.arrays import freeze
from bundle.base.tails import chi2_limit, chi2_median
from bundle.base.words import few, named, noun, number, plural, sorted_ids
from bundle.graphs.pose_graphs.edge_weights import WeightedGraph, weighted_graph
from bundle.graphs.pose_graphs.joints import Joint, Joints
from bundle.interface.finding import Finding
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.model.pose_graph_arrays import PoseGraph

NO_MINIMUM = "no_minimum"  # kind of the note on values that are no minimum

FEW_DIGITS = 4  # number of digits of a step below which the normal equations are a problem

MOST_NAMED = 5  # number of suspicious edges that a sentence names

COORDINATES = {
    3: ("x", "y", "angle"),
    6: ("rotation x", "rotation y", "rotation z", "x", "y", "z"),
}
DOMINANT = 0.5  # share of the largest coordinate above which a sentence names a coordinate
MOST_EDGES = 4
MOST_MODES = 20  # largest number of findings per kind; the nullity counts all

Floats = NDArray[np.float64]


def diagnose_graph(
    source: Any, options: PoseGraphOptions | None = None, **changes: Any
) -> Diagnosis:
    """Diagnose a pose graph; see :func:`bundle.diagnose`."""
    weighted = weighted_graph(source, options, changes, "diagnose")
    equations = PoseEquations(weighted)
    graph, given, joints = weighted.graph, weighted.given, equations.joints
    components = _components(graph)
    tests = tests_of(equations, given.num_edges, weighted.edges)
    chi2 = np.full(given.num_edges, np.nan)
    chi2[weighted.edges] = equations.squares

    def edge(k: int) -> tuple[tuple[int, ...], int | None, str]:
        ends = tuple(given.ids[given.edges[k]].tolist())
        return ends, int(given.edge_lines[k]) or None, " ".join(given.ends_of(k))

    return graph_diagnosis(
        equations,
        tests,
        chi2,
        edge,
        {
            "nullity": equations.num_gauge + joints.num_open,
            "nullity_is_exact": joints.is_exact,
            "components": components,
            "weak_modes": (*_component_modes(graph, components), *joint_modes(graph, joints)),
            "held_pose_ids": equations.held_ids,
        },
        notes=_about_unjudged(weighted, tests.redundancy, joints),
        last=_about_weights(weighted),
    )


def tests_of(
    equations: NormalEquations, num_terms: int, terms: NDArray[np.int64] | slice = slice(None)
) -> TermTests:
    """Return the tests of all given terms; unknown for terms of weight 0.

    ``terms``: positions of the terms of the equations.
    """
    tests = TermTests(
        np.full(num_terms, np.nan), np.full(num_terms, np.nan), np.zeros(num_terms, np.int64)
    )
    if equations.open_blocks():
        return tests
    found = equations.selected_inverse(with_tests=True)
    if found.undetermined >= 0:
        return tests
    for all_terms, some in zip(tests[:3], found.tests[:3], strict=True):
        all_terms[terms] = some
    return tests._replace(decrease=found.tests.decrease)


def graph_diagnosis(
    equations: NormalEquations,
    tests: TermTests,
    chi2: Floats,
    edge: Callable[[int], tuple[tuple[Any, ...], int | None, str]],
    fields: dict[str, Any],
    *,
    notes: Iterable[Finding] = (),
    last: Iterable[Finding] = (),
) -> Diagnosis:
    """Return the diagnosis of a graph of either kind.

    For a factor graph, modes without a dimension are notes. ``chi2``: (m,) chi2 of the given terms.
    ``edge`` returns the keys of a term, its line in a file, and its name.
    """
    words, cost = equations.words, equations.cost
    at_minimum = tests.is_at_minimum(cost)
    # The test applies to errors of a fit only.
    test = tests.test if at_minimum else np.full(len(tests.test), np.nan)
    scale = noise_scale(test, tests.rank)
    suspicious, names = [], []
    for k in worst_first(test, tests.rank, scale):
        ends, line, name = edge(k)
        numbers: dict[str, Any] = {
            "chi2": float(chi2[k]),
            "test": float(test[k]),
            "degrees": int(tests.rank[k]),
        }
        suspicious.append(SuspiciousEdge(edge=ends, line=line, **numbers))
        names.append(name)
    values = equations.spectrum or {}
    condition = float(values.get("condition_number", np.nan))
    said = [
        *(
            (fault if mode.dimension or words.term == "edge" else note)(mode.kind, mode.sentence)
            for mode in fields["weak_modes"]
        ),
        *_about_edges(suspicious, scale, names, words),
        *_about_conditioning(condition),
        *(() if at_minimum else _about_minimum(tests.decrease, cost)),
        *_about_unchecked(tests, words.term),
        *notes,
        *_about_noise(scale),
        *last,
    ]
    return Diagnosis(
        **fields,
        expected_nullity=equations.num_gauge,
        condition_number=condition,
        condition_number_unscaled=float(values.get("condition_number_unscaled", np.nan)),
        eigenvalues=freeze(np.array(values.get("eigenvalues", np.zeros(0)))),
        suspicious_edges=tuple(suspicious),
        edge_redundancy=freeze(tests.redundancy),
        edge_test=freeze(test),
        noise_scale=scale,
        findings=tuple(sorted(said, key=lambda finding: not finding.is_problem)),
    )


def _components(graph: PoseGraph) -> tuple[Component, ...]:
    label = np.asarray(_core.pose_components(graph.num_poses, graph.edges))
    order = np.argsort(label, kind="stable")
    names, starts = np.unique(label[order], return_index=True)
    edges = np.bincount(label[graph.edges[:, 0]], minlength=graph.num_poses)
    parts = [
        Component(
            pose_ids=tuple(sorted(graph.ids[poses].tolist())),
            num_edges=int(edges[name]),
            num_fixed=int(graph.fixed[poses].sum()),
        )
        for name, poses in zip(names, np.split(order, starts[1:]), strict=True)
    ]
    return tuple(sorted(parts, key=lambda part: -len(part.pose_ids)))


def worst_first(test: NDArray[np.float64], rank: NDArray[np.int64], scale: float) -> list[int]:
    """Return the positions of edges that others contradict, the worst first."""
    limit = np.array([chi2_limit(degrees) for degrees in rank.tolist()])
    ratio = np.where(np.isfinite(test) & (rank > 0), test, 0.0) / limit
    order = np.argsort(-ratio, kind="stable")
    return [int(edge) for edge in order[ratio[order] > scale]]


def noise_scale(test: NDArray[np.float64], rank: NDArray[np.int64]) -> float:
    """Return the ratio of actual to expected scatter of correct edges; half may be wrong."""
    checked = np.isfinite(test) & (rank > 0)
    if not checked.any():
        return 1.0
    medians = np.array([chi2_median(degrees) for degrees in rank[checked].tolist()])
    return max(1.0, float(np.median(test[checked] / medians)))


def _about_edges(
    suspicious: Sequence[SuspiciousEdge], scale: float, names: Sequence[str], words: Words
) -> list[Finding]:
    """Return the finding about edges or factors, the worst first, that the others contradict."""
    if not suspicious:
        return []
    noun = words.term
    listed = [
        f"{name}{f' (line {one.line})' if one.line else ''}: {number(one.test)} on {one.degrees}"
        for name, one in zip(names[:MOST_NAMED], suspicious, strict=False)
    ]
    more = f" and {len(suspicious) - MOST_NAMED} more" if len(suspicious) > MOST_NAMED else ""
    against = f" times {number(scale)}, the noise" if scale > 1 else ""
    return [
        fault(
            "suspicious_edges",
            f"{plural(len(suspicious), noun)} whose error only one correct {noun} in a million "
            f"exceeds (chi2 of the test on degrees of freedom{against}): "
            f"{'; '.join(listed)}{more}. A wrong {noun} also raises the errors of its neighbours: "
            "check the first one, or "
            f"{words.doubt}.",
        )
    ]


def _about_conditioning(condition: float) -> list[Finding]:
    """Return the finding about a condition number that leaves few digits."""
    if not np.isfinite(condition):
        return []
    digits = 16 - np.log10(max(condition, 1.0))
    if digits >= FEW_DIGITS:
        return []
    return [
        fault(
            "ill_conditioned",
            f"A step has about {max(0, round(digits))} digits by the normal equations (condition "
            f"number {number(condition)}).",
        )
    ]


def _about_minimum(decrease: float, cost: float) -> list[Finding]:
    """Return the note on values that are not at a minimum."""
    return [
        note(
            NO_MINIMUM,
            f"Not at a minimum: one more step would lower the cost by about "
            f"{number(min(100.0, 100 * decrease / cost))} %. Wrong edges can be identified only at "
            "a minimum: refine first. If the graph was refined with a loss (--loss), give it here.",
        )
    ]


def _about_noise(scale: float) -> list[Finding]:
    """Return the note on information that is too optimistic."""
    if scale < 2:
        return []
    return [
        note(
            "optimistic_information",
            f"Errors are {number(float(np.sqrt(scale)))} times as large as the information "
            "states: the information is too optimistic, or many edges are wrong.",
        )
    ]


def _about_unchecked(tests: TermTests, noun: str) -> list[Finding]:
    unchecked = int((np.isfinite(tests.redundancy) & (tests.rank == 0)).sum())
    if not unchecked:
        return []
    whole = "any of them" if unchecked == len(tests.rank) else plural(unchecked, noun)
    return [
        note(
            "unchecked_edges",
            f"No other {noun} checks {whole}, because they are in no loop.",
        )
    ]


def _about_unjudged(
    weighted: WeightedGraph, redundancy: NDArray[np.float64], joints: Joints
) -> list[Finding]:
    count = int(np.isnan(redundancy[weighted.edges]).sum())
    if not count or joints.num_open:
        return []
    return [
        note(
            "unjudged_edges",
            f"{plural(count, 'edge')} cannot be tested: too far from fixed poses, so that rounding "
            "dominates. Fix a pose near them, or cut the graph.",
        )
    ]


def _about_weights(weighted: WeightedGraph) -> list[Finding]:
    count = weighted.given.num_edges - len(weighted.edges)
    if not count:
        return []
    return [
        note(
            "rejected_edges",
            f"{plural(count, 'edge')} of weight 0 left out (by the loss or the consistency check).",
        )
    ]


def fault(kind: str, sentence: str) -> Finding:
    """Return a finding that makes a diagnosis not ok."""
    return Finding(kind=kind, is_problem=True, sentence=sentence)


def note(kind: str, sentence: str) -> Finding:
    """Return a finding that leaves a diagnosis ok."""
    return Finding(kind=kind, is_problem=False, sentence=sentence)


def _component_modes(graph: PoseGraph, components: tuple[Component, ...]) -> list[WeakMode]:
    """Return a mode for each component but the largest, with advice on connecting it."""
    order = np.argsort(graph.ids, kind="stable")
    ids = graph.ids[order]
    modes = []
    for part in components[1 : 1 + MOST_MODES]:
        inside = np.isin(ids, part.pose_ids)
        ends = np.flatnonzero(inside[1:] != inside[:-1])
        near = ends[np.argmin(ids[ends + 1] - ids[ends])]
        first, second = (graph.pose_name(int(order[k])) for k in (near, near + 1))
        members = order[inside]
        free = "its fixed poses determine it" if part.num_fixed else "it floats by itself"
        modes.append(
            WeakMode(
                kind="component",
                sentence=f"{_named(graph, members)} ({plural(part.num_edges, 'edge')}): no "
                f"edge joins this component to the largest one "
                f"({plural(len(components[0].pose_ids), 'pose')}); {free}. An edge between poses "
                f"{first} and {second}, the nearest by their ids, would join two components.",
                pose_ids=part.pose_ids,
                dimension=0 if part.num_fixed else graph.tangent_size,
            )
        )
    return modes


def joint_modes(graph: PoseGraph, joints: Joints) -> list[WeakMode]:
    """Return modes of clusters that edges connect with little or no information."""
    opened = [_open(graph, joint) for joint in joints.opened]
    weak = [_weak(graph, joint) for joint in joints.weak]
    by_themselves = sum(mode.dimension for mode in opened)
    if joints.is_exact and joints.num_open > by_themselves:
        opened.append(_together(graph, joints, joints.num_open - by_themselves))
    return opened[:MOST_MODES] + weak[:MOST_MODES]


def _open(graph: PoseGraph, joint: Joint) -> WeakMode:
    count = joint.num_open
    edges = _edges(graph, joint.edges)
    what = _coordinates(graph, joint, joint.vectors[:, :count])
    return WeakMode(
        kind="open_joint",
        sentence=f"{_named(graph, joint.poses)} relative to the others: {edges} "
        f"{'has' if len(joint.edges) == 1 else 'have'} no information on {what}: "
        f"{plural(count, 'direction')} undetermined. Add this information, add an edge, or "
        "fix one of these poses.",
        pose_ids=_ids(graph, joint),
        edges=_pairs(graph, joint.edges),
        dimension=count,
    )


def _weak(graph: PoseGraph, joint: Joint) -> WeakMode:
    first = joint.num_open
    count = joint.num_weak
    lowest = float(joint.eigenvalues[first])
    what = _coordinates(graph, joint, joint.vectors[:, first : first + count])
    depend = "depends" if len(joint.poses) == 1 else "depend"
    return WeakMode(
        kind="weak_joint",
        sentence=f"{_named(graph, joint.poses)} {depend} on {_edges(graph, joint.edges)} alone: "
        f"the sigma of {what} is up to {number(1 / np.sqrt(lowest))} times that of a typical edge. "
        f"Add an edge, or check the information of this one.",
        pose_ids=_ids(graph, joint),
        edges=_pairs(graph, joint.edges),
        eigenvalue=lowest,
        dimension=count,
    )


def _together(graph: PoseGraph, joints: Joints, count: int) -> WeakMode:
    moved = np.flatnonzero(
        joints.directions.reshape(graph.num_poses, -1).any(axis=1)
        if joints.directions.size
        else np.zeros(graph.num_poses, bool)
    )
    ids = sorted_ids(graph.ids, moved)
    return WeakMode(
        kind="open_together",
        sentence=f"{_named(graph, moved)} relative to the others: several edges with singular "
        f"information together leave {plural(count, 'more direction')} undetermined. Add an edge "
        "with full information among them.",
        pose_ids=ids,
        dimension=count,
    )


def _coordinates(graph: PoseGraph, joint: Joint, vectors: Floats) -> str:
    """Return the coordinates, in the frame of the reference pose, that directions change."""
    names = COORDINATES[graph.tangent_size]
    frame = f" in the frame of pose {graph.pose_name(int(joint.poses[0]))}"
    if vectors.shape[1] == len(names):
        return "their whole relative pose"
    shares = (vectors**2).sum(axis=1)
    chosen = [names[k] for k in np.flatnonzero(shares >= DOMINANT * shares.max())]
    return ", ".join(chosen) + frame


def _named(graph: PoseGraph, poses: NDArray[np.int64]) -> str:
    """Return the names of poses in the order of their ids."""
    ordered = poses[np.argsort(graph.ids[poses], kind="stable")]
    return named("Pose", [graph.pose_name(pose) for pose in ordered.tolist()])


def _ids(graph: PoseGraph, joint: Joint) -> tuple[int, ...]:
    return sorted_ids(graph.ids, joint.poses)


def _pairs(graph: PoseGraph, edges: Iterable[int]) -> tuple[tuple[int, int], ...]:
    pairs = (graph.ids[graph.edges[edge]].tolist() for edge in edges)
    return tuple((first, second) for first, second in pairs)


def _edges(graph: PoseGraph, edges: NDArray[np.int64]) -> str:
    words = []
    for edge in edges.tolist():
        first, second = graph.ends_of(edge)
        line = int(graph.edge_lines[edge])
        words.append(f"{first} {second}" + (f" (line {line})" if line else ""))
    return f"{noun(len(words), 'edge', 'edges')} {few(words, MOST_EDGES)}"
