"""Odometry chain: composed poses, and their uncertainty relative to each other.

Pose q of the chain is O_q = O_{q-1} Z_q. Each measurement has an error on its right, Z_t Exp(e_t)
with e_t ~ N(0, Sigma_t), Sigma_t the inverse of its information. Because X Exp(d) = Exp(Ad_X d) X,
an error of step t moves all later poses together as one rigid body, by w_t in the frame of the
chain:

    O_q -> Exp(w_t) O_q  for q >= t,     w_t = Ad(O_t) e_t.

Steps are independent, so that covariances of w add up. The sum over the steps between p and q is

    sum_{p < t <= q} Cov(w_t) = W_q - W_p,     W_q = sum_{t <= q} Ad(O_t) Sigma_t Ad(O_t)^T,

a difference of two prefix sums that needs no second pass over the chain. An edge against the
direction of the chain measures the inverse: Z^-1 Exp(e) with e of covariance Ad(Z) Sigma Ad(Z)^T.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.graphs.pose_graphs.lie_groups import adjoints
from bundle.model.pose_graph_arrays import PoseGraph

Floats = NDArray[np.float64]

SINGULAR = 1e-14
"""Smallest eigenvalue of information with a unit diagonal that counts as invertible."""


@dataclass(frozen=True, kw_only=True)
class OdometryChain:
    """Odometry of a graph, relative to the centre of its poses.

    Attributes:
        poses: (n, 3) or (n, 7) in the order of the graph's poses.
        place: (n,) place of each pose along the chain, from 0.
        accumulated: (n, d, d) matrices W by place; zero at the first place.
    """

    poses: Floats
    place: NDArray[np.intp]
    accumulated: Floats


def odometry_chain(graph: PoseGraph, num_threads: int) -> OdometryChain:
    """Compose the odometry chain from the first edge between each two successive poses.

    Raises:
        InputError: two poses that follow each other in the order of ids have no edge, or the
            information of such an edge is singular.
    """
    order = np.argsort(graph.ids, kind="stable")
    first, second = _core.odometry_gap(graph)
    if first >= 0:
        raise InputError(
            "consistency: expected odometry without gaps, found no edge between "
            f"{graph.ids[first]} and {graph.ids[second]}"
        )
    held = np.zeros(graph.num_poses, bool)
    held[order[0]] = True
    poses = np.array(_core.initial_poses(graph, held, "odometry", num_threads))
    position = slice(0, 2) if graph.dimension == 2 else slice(4, 7)
    poses[:, position] -= poses[:, position].mean(axis=0)  # short levers lose fewer digits
    place = np.empty(graph.num_poses, np.intp)
    place[order] = np.arange(graph.num_poses)

    ends = place[graph.edges]
    steps = np.flatnonzero(~graph.is_closure)
    later, which = np.unique(ends[steps].max(axis=1), return_index=True)  # first edge of each step
    steps = steps[which]
    covariance = edge_covariance(graph, steps)
    back = ends[steps, 0] > ends[steps, 1]
    # Relative to the later end of the edge, then in the chain's frame.
    turned = adjoints(graph.measurements[steps[back]])
    covariance[back] = turned @ covariance[back] @ turned.transpose(0, 2, 1)
    moved = adjoints(poses[order[later]])
    d = graph.tangent_size
    accumulated = np.zeros((graph.num_poses, d, d))
    accumulated[1:] = np.cumsum(moved @ covariance @ moved.transpose(0, 2, 1), axis=0)
    return OdometryChain(poses=poses, place=place, accumulated=accumulated)


def edge_covariance(graph: PoseGraph, edges: NDArray[np.intp]) -> Floats:
    """Return the covariances (k, d, d) of some edges in tangent coordinates.

    Raises:
        InputError: information is singular or not finite; the message names the edge.
    """
    information = graph.information[edges]
    information[~np.isfinite(information).all(axis=(1, 2))] = 0.0
    diagonal = np.diagonal(information, axis1=1, axis2=2)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1))
    scaled = scale[:, :, None] * information * scale[:, None, :]
    singular = np.linalg.eigvalsh(scaled)[:, 0] < SINGULAR
    if singular.any():
        name = graph.edge_name(int(edges[np.argmax(singular)]))
        raise InputError(
            f"consistency: {name}: expected invertible information, found a singular matrix "
            "or infinity"
        )
    inverse: Floats = scale[:, :, None] * np.linalg.inv(scaled) * scale[:, None, :]
    return inverse
