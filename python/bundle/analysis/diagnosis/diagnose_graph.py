"""Diagnosis of a pose graph: rank, conditioning, components, suspicious edges."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.analysis.diagnosis.graph_diagnosis import (
    GraphComponent,
    GraphDiagnosis,
    GraphWeakMode,
    SuspiciousEdge,
)
from bundle.analysis.diagnosis.graph_modes import component_modes_of_graph, joint_modes
from bundle.base.arrays import freeze
from bundle.base.words import number, plural
from bundle.graphs.pose_graphs.chi2_quantiles import MEDIANS, ONE_IN_A_MILLION
from bundle.graphs.pose_graphs.edge_weights import WeightedGraph, weighted_graph
from bundle.graphs.pose_graphs.joints import Joints, find_joints
from bundle.interface.finding import Finding
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.model.pose_graph_arrays import PoseGraph

__all__ = ["diagnose_graph"]

AT_MINIMUM = 1e-4
"""Relative decrease of the cost by one more step, below which a state counts as a minimum."""

FEW_DIGITS = 4
"""Number of digits of a step below which the normal equations are a problem."""

MOST_NAMED = 5
"""Number of suspicious edges that a sentence names."""


def diagnose_graph(
    source: Any, options: PoseGraphOptions | None = None, **changes: Any
) -> GraphDiagnosis:
    """Diagnose a pose graph; see :func:`bundle.diagnose`.

    Raises:
        InputError: an option is wrong, or an edge has an invalid information matrix.
        OSError: the path cannot be read.
    """
    weighted = weighted_graph(source, options, changes, "diagnose")
    graph, error = weighted.graph, weighted.options.error
    threads = weighted.options.num_threads
    held, _, for_gauge = _core.hold_poses(graph)
    joints = find_joints(graph, held, error)
    components = _components(graph)
    expected = graph.tangent_size * len(for_gauge)
    modes = [*component_modes_of_graph(graph, components), *joint_modes(graph, joints)]
    spectrum: dict[str, Any] = {
        "condition_number": float("nan"),
        "condition_number_unscaled": float("nan"),
        "eigenvalues": np.zeros(0),
    }
    if not held.all():
        spectrum = _core.graph_spectrum(graph, held, error, joints.directions, threads)
    redundancy, test, rank, decrease = _tests(weighted, joints, threads)
    cost = 0.5 * float(_core.edge_chi2(graph, error).sum())
    is_minimum = not (decrease > AT_MINIMUM * cost and decrease > 1e-9)
    if not is_minimum:  # the test applies to errors of a fit only
        test = np.full(len(test), np.nan)
    scale = _noise_scale(test, rank)
    suspicious = _suspicious(weighted, test, rank, scale)
    said = [
        *_about_modes(modes),
        *_about_edges(suspicious, scale),
        *_about_conditioning(float(spectrum["condition_number"])),
        *(() if is_minimum else _about_minimum(decrease, cost)),
        *_about_unchecked(graph, redundancy, rank),
        *_about_unjudged(weighted, redundancy, joints),
        *_about_noise(scale),
        *_about_weights(weighted),
    ]
    return GraphDiagnosis(
        nullity=expected + joints.num_open,
        expected_nullity=expected,
        nullity_is_exact=joints.is_exact,
        components=components,
        weak_modes=tuple(modes),
        condition_number=float(spectrum["condition_number"]),
        condition_number_unscaled=float(spectrum["condition_number_unscaled"]),
        eigenvalues=freeze(np.array(spectrum["eigenvalues"])),
        suspicious_edges=suspicious,
        edge_redundancy=freeze(redundancy),
        edge_test=freeze(test),
        noise_scale=scale,
        findings=tuple(sorted(said, key=lambda finding: not finding.is_problem)),
    )


def _components(graph: PoseGraph) -> tuple[GraphComponent, ...]:
    label = np.asarray(_core.pose_components(graph.num_poses, graph.edges))
    order = np.argsort(label, kind="stable")
    names, starts = np.unique(label[order], return_index=True)
    edges = np.bincount(label[graph.edges[:, 0]], minlength=graph.num_poses)
    parts = [
        GraphComponent(
            pose_ids=tuple(sorted(graph.ids[poses].tolist())),
            num_edges=int(edges[name]),
            num_fixed=int(graph.fixed[poses].sum()),
        )
        for name, poses in zip(names, np.split(order, starts[1:]), strict=True)
    ]
    return tuple(sorted(parts, key=lambda part: -len(part.pose_ids)))


def _tests(
    weighted: WeightedGraph, joints: Joints, threads: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], float]:
    """Return redundancy, test and rank of the given edges, and the cost decrease of a step."""
    count = weighted.given.num_edges
    redundancy, test = np.full(count, np.nan), np.full(count, np.nan)
    rank = np.zeros(count, np.int64)
    if joints.num_open:
        return redundancy, test, rank, 0.0
    out = _core.graph_covariance(weighted.graph, weighted.options.error, False, True, [], threads)
    if out["undetermined_pose"] >= 0:
        return redundancy, test, rank, 0.0
    redundancy[weighted.edges] = out["edge_redundancy"]
    test[weighted.edges] = out["edge_test"]
    rank[weighted.edges] = out["edge_rank"]
    return redundancy, test, rank, float(out["predicted_decrease"])


def _noise_scale(test: NDArray[np.float64], rank: NDArray[np.int64]) -> float:
    """Return the ratio of actual to expected scatter of correct edges; half may be wrong."""
    checked = np.isfinite(test) & (rank > 0)
    if not checked.any():
        return 1.0
    medians = np.array([MEDIANS[degrees] for degrees in rank[checked].tolist()])
    return max(1.0, float(np.median(test[checked] / medians)))


def _suspicious(
    weighted: WeightedGraph,
    test: NDArray[np.float64],
    rank: NDArray[np.int64],
    scale: float,
) -> tuple[SuspiciousEdge, ...]:
    graph = weighted.given
    limit = np.array([ONE_IN_A_MILLION.get(degrees, np.inf) for degrees in rank.tolist()])
    ratio = np.where(np.isfinite(test) & (rank > 0), test, 0.0) / limit
    chi2 = np.full(graph.num_edges, np.nan)
    chi2[weighted.edges] = _core.edge_chi2(weighted.graph, weighted.options.error)
    found = []
    for edge in np.argsort(-ratio, kind="stable").tolist():
        if not ratio[edge] > scale:
            break
        first, second = graph.ids[graph.edges[edge]].tolist()
        found.append(
            SuspiciousEdge(
                edge=(first, second),
                line=int(graph.edge_lines[edge]) or None,
                chi2=float(chi2[edge]),
                test=float(test[edge]),
                degrees=int(rank[edge]),
            )
        )
    return tuple(found)


def _about_modes(modes: list[GraphWeakMode]) -> list[Finding]:
    return [_problem(mode.kind, mode.sentence) for mode in modes]


def _about_edges(suspicious: tuple[SuspiciousEdge, ...], scale: float) -> list[Finding]:
    if not suspicious:
        return []
    names = [
        f"{one.edge[0]} {one.edge[1]}{f' (line {one.line})' if one.line else ''}: "
        f"{number(one.test)} on {one.degrees}"
        for one in suspicious[:MOST_NAMED]
    ]
    more = f" and {len(suspicious) - MOST_NAMED} more" if len(suspicious) > MOST_NAMED else ""
    against = f" times {number(scale)}, the noise" if scale > 1 else ""
    return [
        _problem(
            "suspicious_edges",
            f"{plural(len(suspicious), 'edge')} with an error that one right edge in a million has "
            f"(chi2 of the test on degrees of freedom{against}): {'; '.join(names)}{more}. A wrong "
            "edge spoils its neighbours' errors, too: look at the first, or refine with a loss for "
            "wrong closures (dcs, gnc-tls).",
        )
    ]


def _about_conditioning(condition: float) -> list[Finding]:
    if not np.isfinite(condition):
        return []
    digits = 16 - np.log10(max(condition, 1.0))
    if digits >= FEW_DIGITS:
        return []
    return [
        _problem(
            "ill_conditioned",
            f"A step has about {max(0, round(digits))} digits by the normal equations (condition "
            f"number {number(condition)}).",
        )
    ]


def _about_minimum(decrease: float, cost: float) -> list[Finding]:
    return [
        _note(
            "no_minimum",
            f"This is no minimum: a step of a solve would lower the cost by about "
            f"{number(min(100.0, 100 * decrease / cost))} %. Which edges the others contradict is "
            "told at a minimum only: refine first.",
        )
    ]


def _about_unchecked(
    graph: PoseGraph, redundancy: NDArray[np.float64], rank: NDArray[np.int64]
) -> list[Finding]:
    unchecked = int((np.isfinite(redundancy) & (rank == 0)).sum())
    if not unchecked:
        return []
    whole = "all of them" if unchecked == graph.num_edges else plural(unchecked, "edge")
    return [
        _note(
            "unchecked_edges",
            f"No other edge checks {whole}: in no loop, an error would not show.",
        )
    ]


def _about_unjudged(
    weighted: WeightedGraph, redundancy: NDArray[np.float64], joints: Joints
) -> list[Finding]:
    count = int(np.isnan(redundancy[weighted.edges]).sum())
    if not count or joints.num_open:
        return []
    return [
        _note(
            "unjudged_edges",
            f"{plural(count, 'edge')} so far from held poses that rounding hides whether others "
            "contradict them: fix a pose near them, or cut the graph, to judge them.",
        )
    ]


def _about_noise(scale: float) -> list[Finding]:
    if scale < 2:
        return []
    return [
        _note(
            "optimistic_information",
            f"Errors scatter {number(float(np.sqrt(scale)))} times as much as the information "
            "says: it is optimistic, or many edges are wrong.",
        )
    ]


def _about_weights(weighted: WeightedGraph) -> list[Finding]:
    count = weighted.given.num_edges - len(weighted.edges)
    if not count:
        return []
    return [
        _note(
            "rejected_edges",
            f"{plural(count, 'edge')} of weight 0 left out (by the loss or the consistency check).",
        )
    ]


def _problem(kind: str, sentence: str) -> Finding:
    return Finding(kind=kind, is_problem=True, sentence=sentence)


def _note(kind: str, sentence: str) -> Finding:
    return Finding(kind=kind, is_problem=False, sentence=sentence)
