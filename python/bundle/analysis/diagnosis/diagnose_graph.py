"""Diagnosis of a pose graph: rank, conditioning, components, suspicious edges."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.analysis.diagnosis.diagnosis_result import (
    GraphComponent,
    GraphDiagnosis,
    GraphWeakMode,
    SuspiciousEdge,
)
from bundle.analysis.diagnosis.graph_findings import (
    about_conditioning,
    about_edges,
    about_minimum,
    about_noise,
    is_at_minimum,
    noise_scale,
    note,
    problem,
    worst_first,
)
from bundle.analysis.diagnosis.graph_modes import component_modes_of_graph, joint_modes
from bundle.base.arrays import freeze
from bundle.base.words import plural
from bundle.graphs.pose_graphs.edge_weights import WeightedGraph, weighted_graph
from bundle.graphs.pose_graphs.joints import Joints, find_joints
from bundle.interface.finding import Finding
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.model.pose_graph_arrays import PoseGraph


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
    is_minimum = is_at_minimum(decrease, cost)
    if not is_minimum:  # the test applies to errors of a fit only
        test = np.full(len(test), np.nan)
    scale = noise_scale(test, rank)
    suspicious, names = _suspicious(weighted, test, rank, scale)
    said = [
        *_about_modes(modes),
        *about_edges(suspicious, scale, names, "edge"),
        *about_conditioning(float(spectrum["condition_number"])),
        *(() if is_minimum else about_minimum(decrease, cost)),
        *_about_unchecked(graph, redundancy, rank),
        *_about_unjudged(weighted, redundancy, joints),
        *about_noise(scale),
        *_about_weights(weighted),
    ]
    return GraphDiagnosis(
        nullity=expected + joints.num_open,
        expected_nullity=expected,
        nullity_is_exact=joints.is_exact,
        components=components,
        weak_modes=tuple(modes),
        held_pose_ids=tuple(int(graph.ids[pose]) for pose in for_gauge),
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


def _suspicious(
    weighted: WeightedGraph,
    test: NDArray[np.float64],
    rank: NDArray[np.int64],
    scale: float,
) -> tuple[tuple[SuspiciousEdge, ...], list[str]]:
    """Return the suspicious edges and their names."""
    graph = weighted.given
    chi2 = np.full(graph.num_edges, np.nan)
    chi2[weighted.edges] = _core.edge_chi2(weighted.graph, weighted.options.error)
    found = []
    names = []
    for edge in worst_first(test, rank, scale):
        names.append(" ".join(graph.ends_of(edge)))
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
    return tuple(found), names


def _about_modes(modes: list[GraphWeakMode]) -> list[Finding]:
    return [problem(mode.kind, mode.sentence) for mode in modes]


def _about_unchecked(
    graph: PoseGraph, redundancy: NDArray[np.float64], rank: NDArray[np.int64]
) -> list[Finding]:
    unchecked = int((np.isfinite(redundancy) & (rank == 0)).sum())
    if not unchecked:
        return []
    whole = "all of them" if unchecked == graph.num_edges else plural(unchecked, "edge")
    return [
        note(
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
        note(
            "unjudged_edges",
            f"{plural(count, 'edge')} so far from held poses that rounding hides whether others "
            "contradict them: fix a pose near them, or cut the graph, to judge them.",
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
