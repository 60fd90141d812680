"""Sentences about undetermined and weak directions of a pose graph, with poses and edges."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.diagnosis.diagnosis_result import GraphComponent, GraphWeakMode
from bundle.base.words import named, number, plural, sorted_ids
from bundle.graphs.pose_graphs.joints import Joint, Joints
from bundle.model.pose_graph_arrays import PoseGraph

COORDINATES = {
    3: ("x", "y", "angle"),
    6: ("rotation x", "rotation y", "rotation z", "x", "y", "z"),
}
DOMINANT = 0.5
"""Share of the largest coordinate above which a sentence names a coordinate."""
MOST_EDGES = 4
MOST_MODES = 20
"""Largest number of findings per kind; the nullity counts all."""

Floats = NDArray[np.float64]


def component_modes_of_graph(
    graph: PoseGraph, components: tuple[GraphComponent, ...]
) -> list[GraphWeakMode]:
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
        free = "it is held by its fixed poses" if part.num_fixed else "it floats by itself"
        modes.append(
            GraphWeakMode(
                kind="component",
                sentence=f"{_named(graph, members)} ({plural(part.num_edges, 'edge')}): no "
                f"edge joins this component with the largest, of "
                f"{plural(len(components[0].pose_ids), 'pose')}; {free}. An edge between poses "
                f"{first} and {second}, the nearest by their ids, would join it to another.",
                pose_ids=part.pose_ids,
                edges=(),
                eigenvalue=0.0,
                dimension=0 if part.num_fixed else graph.tangent_size,
            )
        )
    return modes


def joint_modes(graph: PoseGraph, joints: Joints) -> list[GraphWeakMode]:
    """Return modes of clusters that edges connect with little or no information."""
    opened = [_open(graph, joint) for joint in joints.opened]
    weak = [_weak(graph, joint) for joint in joints.weak]
    by_themselves = sum(mode.dimension for mode in opened)
    if joints.is_exact and joints.num_open > by_themselves:
        opened.append(_together(graph, joints, joints.num_open - by_themselves))
    return opened[:MOST_MODES] + weak[:MOST_MODES]


def _open(graph: PoseGraph, joint: Joint) -> GraphWeakMode:
    count = joint.num_open
    edges = _edges(graph, joint.edges)
    what = _coordinates(graph, joint, joint.vectors[:, :count])
    return GraphWeakMode(
        kind="open_joint",
        sentence=f"{_named(graph, joint.poses)} against the others: {edges} "
        f"{'says' if len(joint.edges) == 1 else 'say'} nothing of {what}, which leaves "
        f"{plural(count, 'direction')} open. Give the information a value there, add an edge, or "
        "fix a pose among them.",
        pose_ids=_ids(graph, joint),
        edges=_pairs(graph, joint.edges),
        eigenvalue=0.0,
        dimension=count,
    )


def _weak(graph: PoseGraph, joint: Joint) -> GraphWeakMode:
    first = joint.num_open
    count = joint.num_weak
    lowest = float(joint.eigenvalues[first])
    what = _coordinates(graph, joint, joint.vectors[:, first : first + count])
    hangs = "hangs" if len(joint.poses) == 1 else "hang"
    return GraphWeakMode(
        kind="weak_joint",
        sentence=f"{_named(graph, joint.poses)} {hangs} on {_edges(graph, joint.edges)}, "
        f"which leaves a sigma of up to {number(1 / np.sqrt(lowest))} times that of a typical edge "
        f"in {what}. Add an edge, or check the information of this one.",
        pose_ids=_ids(graph, joint),
        edges=_pairs(graph, joint.edges),
        eigenvalue=lowest,
        dimension=count,
    )


def _together(graph: PoseGraph, joints: Joints, count: int) -> GraphWeakMode:
    moved = np.flatnonzero(
        joints.directions.reshape(graph.num_poses, -1).any(axis=1)
        if joints.directions.size
        else np.zeros(graph.num_poses, bool)
    )
    ids = sorted_ids(graph.ids, moved)
    return GraphWeakMode(
        kind="open_together",
        sentence=f"{_named(graph, moved)} against the others: edges without information in some "
        f"direction leave {plural(count, 'direction')} open together, beside what single groups of "
        "poses can do. Add an edge with full information among them.",
        pose_ids=ids,
        edges=(),
        eigenvalue=0.0,
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
    for edge in edges[:MOST_EDGES].tolist():
        first, second = graph.ends_of(edge)
        line = int(graph.edge_lines[edge])
        words.append(f"{first} {second}" + (f" (line {line})" if line else ""))
    more = f" and {len(edges) - MOST_EDGES} more" if len(edges) > MOST_EDGES else ""
    return f"{'edge' if len(edges) == 1 else 'edges'} {', '.join(words)}{more}"
