"""Directions that the edges of a pose graph leave undetermined, exact for graphs of any length.

The normal equations of a long chain have valid eigenvalues near 1e-16, so that their spectrum does
not reveal undetermined directions. The information of the edges does. An edge of full rank fixes
its two poses relative to each other. Poses connected by such edges, and fixed poses, form one rigid
cluster. Usually a component is one cluster, and all directions are determined. Weak joints are
found in the same way. Their clusters are connected by edges whose information has eigenvalues of at
least ``WEAK`` in units of typical sigmas (medians over the edges, one for rotations and one for
translations).

If a component has several clusters, a cluster moves by d_c, the right perturbation of one of its
poses, X_c. A pose X of the cluster moves by Ad(X^-1 X_c) d_c. An edge between clusters a and b
measures

    r + sqrt(Omega) E (Ad(X_j^-1 X_b) d_b - Ad(X_j^-1 X_a) d_a),    E as in ``relative_pose.h``,

because a cluster moves as a rigid body. The rows of these edges form a small problem per component.
The cluster of the gauge or of a fixed pose has no columns. The null space of this problem contains
exactly the directions that the edges leave undetermined. To name these directions, a cluster with
one neighbour is compared with this neighbour and then merged into it, repeatedly, like leaves of a
tree. In the remaining graph, each cluster is compared with all others held constant.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.graphs.pose_graphs.lie_groups import adjoint_between
from bundle.model.pose_graph_arrays import PoseGraph

WEAK = 1e-4  # weak information relative to that of a typical edge: sigmas are 100 times as large

OPEN = 1e-13  # threshold of zero eigenvalues, relative to the largest eigenvalue

MOST_CLUSTERS = 100
"""Largest number of clusters of a component that are analysed together; larger components are
analysed cluster by cluster.
"""

MOST_CARRIED = 1000  # largest number of clusters that a joint lists as moving

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Joint:
    """Poses that move as a rigid body, with edges to other poses that do not fix this body."""

    poses: Ints  # positions of the poses, the reference pose first
    edges: Ints  # positions of the edges to other poses
    # (d,) ascending eigenvalues of the information of these edges on the cluster, with the other
    # clusters held constant, in units of typical sigmas. A typical edge has eigenvalues of about 1
    eigenvalues: Floats
    vectors: Floats  # (d, d), in columns, in the reference pose's frame, typical sigmas

    @property
    def num_open(self) -> int:
        """Number of directions that the edges leave undetermined."""
        return int((self.eigenvalues <= OPEN * self.eigenvalues[-1]).sum())

    @property
    def num_weak(self) -> int:
        """Number of directions that the edges determine weakly."""
        return int((self.eigenvalues < WEAK).sum()) - self.num_open


@dataclass(frozen=True)
class Joints:
    """Undetermined and weak directions of a graph."""

    opened: tuple[Joint, ...]  # joints with undetermined directions
    weak: tuple[Joint, ...]  # joints with weakly determined directions
    # (n d, k) right perturbations of all poses that change no error, without the gauge; zero at
    # constant poses
    directions: Floats
    # False if a component has too many clusters to be analysed together. ``num_open`` then counts
    # directions of single clusters, and ``directions`` does not contain them
    is_exact: bool
    num_open: int  # dimension of the null space without the gauge


@dataclass(frozen=True)
class _Rows:
    """Rows of an edge for the clusters at its ends, in typical sigmas."""

    edge: int
    clusters: tuple[int, int]
    parts: tuple[Floats, Floats]


class _Clusters:
    """Rigid clusters of poses, by component, and the edges between them."""

    def __init__(
        self, graph: PoseGraph, tight: NDArray[np.bool_], sigmas: Floats, error: str
    ) -> None:
        fixed = np.flatnonzero(graph.fixed)
        as_one = np.stack([fixed[:-1], fixed[1:]], axis=1).reshape(-1, 2)
        joined = np.concatenate([graph.edges[tight], as_one]).astype(np.int32)
        self.graph, self.sigmas = graph, sigmas
        self.of_pose = np.asarray(_core.pose_components(graph.num_poses, joined), np.int64)
        self.reference: dict[int, int] = {}
        ends = self.of_pose[graph.edges]
        between = np.flatnonzero(~tight & (ends[:, 0] != ends[:, 1]))
        component = np.asarray(_core.pose_components(graph.num_poses, graph.edges))
        self.of_component: dict[int, list[_Rows]] = {}
        for edge in between.tolist():
            rows = self.of_component.setdefault(int(component[graph.edges[edge, 0]]), [])
            rows.append(self._rows(edge, error))

    def _rows(self, edge: int, error: str) -> _Rows:
        graph = self.graph
        i, j = graph.edges[edge].tolist()
        _, _, right = _core.relative_pose_error(
            error, graph.poses[i], graph.poses[j], graph.measurements[edge]
        )
        scaled = graph.information[edge] * np.outer(self.sigmas, self.sigmas)
        values, vectors = np.linalg.eigh(scaled)
        root = np.sqrt(np.maximum(values, 0))[:, None] * vectors.T / self.sigmas
        parts, clusters = [], []
        for pose, sign in ((i, -1.0), (j, 1.0)):
            cluster = int(self.of_pose[pose])
            reference = self.reference.setdefault(cluster, pose)
            lever = adjoint_between(graph.poses[j][None], graph.poses[reference])[0]
            parts.append(sign * root @ right @ lever * self.sigmas)
            clusters.append(cluster)
        return _Rows(edge, (clusters[0], clusters[1]), (parts[0], parts[1]))


def typical_sigmas(graph: PoseGraph) -> Floats:
    """Return (d,) medians over the edges of one sigma for rotations and one for translations."""
    diagonal = np.diagonal(graph.information, axis1=1, axis2=2)
    sigmas = np.ones(graph.tangent_size)
    parts = (slice(0, 2), slice(2, 3)) if graph.dimension == 2 else (slice(0, 3), slice(3, 6))
    for part in parts:
        means = diagonal[:, part].mean(axis=1)
        some = means[means > 0]
        if len(some):
            sigmas[part] = 1 / np.sqrt(np.median(some))
    return sigmas


def find_joints(graph: PoseGraph, held: NDArray[np.bool_], error: str) -> Joints:
    """Find directions that the edges leave undetermined or weak; ``held`` (n,) are constant."""
    sigmas = typical_sigmas(graph)
    values = np.linalg.eigvalsh(graph.information * np.outer(sigmas, sigmas))
    full = values[:, 0] > OPEN * values[:, -1]
    weak = [
        joint
        for joint in _joints(_Clusters(graph, values[:, 0] >= WEAK, sigmas, error))
        if joint.num_weak
    ]
    clusters = _Clusters(graph, full, sigmas, error)
    opened = [joint for joint in _joints(clusters) if joint.num_open]
    directions = [np.zeros((graph.num_poses * graph.tangent_size, 0))]
    is_exact, num_open = True, 0
    for rows in clusters.of_component.values():
        names = sorted({cluster for row in rows for cluster in row.clusters})
        if len(names) > MOST_CLUSTERS:
            is_exact = False
            continue
        directions.append(_open_directions(clusters, held, names, rows))
        num_open += directions[-1].shape[1]
    if not is_exact:
        num_open = max(num_open, sum(joint.num_open for joint in opened))
    return Joints(
        tuple(opened), tuple(weak), np.concatenate(directions, axis=1), is_exact, num_open
    )


def _joints(clusters: _Clusters) -> list[Joint]:
    found: list[Joint] = []
    for rows in clusters.of_component.values():
        found += _of_component(clusters, rows)
    return found


def _of_component(clusters: _Clusters, rows: list[_Rows]) -> list[Joint]:
    """Return the joint of every cluster except the reference cluster, leaves first."""
    touching: dict[int, list[tuple[_Rows, int]]] = {}
    for row in rows:
        for side, cluster in enumerate(row.clusters):
            touching.setdefault(cluster, []).append((row, side))
    sizes = np.bincount(clusters.of_pose, minlength=clusters.graph.num_poses)
    fixed = set(clusters.of_pose[clusters.graph.fixed].tolist())
    # The reference is the fixed cluster, or else the largest cluster.
    base = max(touching, key=lambda cluster: (cluster in fixed, sizes[cluster], -cluster))
    carried = {cluster: [cluster] for cluster in touching}  # with the clusters merged into it
    neighbours = {
        cluster: {row.clusters[1 - side] for row, side in own} for cluster, own in touching.items()
    }
    leaves = [cluster for cluster, near in neighbours.items() if len(near) == 1]
    done: set[int] = set()
    found = []
    while leaves:
        leaf = leaves.pop()
        if leaf == base or leaf in done or len(neighbours[leaf]) != 1:
            continue
        done.add(leaf)
        (stem,) = neighbours[leaf]
        own = [(row, side) for row, side in touching[leaf] if row.clusters[1 - side] == stem]
        found.append(_joint(clusters, leaf, own, carried[leaf]))
        if len(carried[stem]) < MOST_CARRIED:
            carried[stem] += carried[leaf]
        neighbours[stem].discard(leaf)
        if len(neighbours[stem]) == 1:
            leaves.append(stem)
    for cluster, own in touching.items():
        if cluster != base and cluster not in done:
            own = [(row, side) for row, side in own if row.clusters[1 - side] not in done]
            found.append(_joint(clusters, cluster, own, carried[cluster]))
    return found


def _joint(
    clusters: _Clusters, cluster: int, own: list[tuple[_Rows, int]], carried: list[int]
) -> Joint:
    parts = np.array([row.parts[side] for row, side in own])
    values, vectors = np.linalg.eigh((parts.transpose(0, 2, 1) @ parts).sum(axis=0))
    reference = clusters.reference[cluster]
    others = np.flatnonzero(np.isin(clusters.of_pose, carried))
    poses = np.concatenate([[reference], others[others != reference]])
    return Joint(poses, np.array([row.edge for row, _ in own]), values, vectors)


def _open_directions(
    clusters: _Clusters, held: NDArray[np.bool_], names: list[int], rows: list[_Rows]
) -> Floats:
    """Return the null directions of a component as perturbations of all poses."""
    graph, d = clusters.graph, clusters.graph.tangent_size
    anchors = set(clusters.of_pose[held].tolist())
    free = [cluster for cluster in names if cluster not in anchors]
    place = {cluster: d * k for k, cluster in enumerate(free)}
    system = np.zeros((d * len(free), d * len(free)))
    for row in rows:
        parts = [
            (place[cluster], part)
            for cluster, part in zip(row.clusters, row.parts, strict=True)
            if cluster in place
        ]
        for first, left in parts:
            for second, right in parts:
                system[first : first + d, second : second + d] += left.T @ right
    values, vectors = np.linalg.eigh(system)
    null = vectors[:, values <= OPEN * values.max(initial=0.0)]
    directions = np.zeros((graph.num_poses, d, null.shape[1]))
    for cluster, first in place.items():
        moved = clusters.sigmas[:, None] * null[first : first + d]
        poses = np.flatnonzero(clusters.of_pose == cluster)
        reference = graph.poses[clusters.reference[cluster]]
        directions[poses] = adjoint_between(graph.poses[poses], reference) @ moved
    return directions.reshape(graph.num_poses * d, null.shape[1])
