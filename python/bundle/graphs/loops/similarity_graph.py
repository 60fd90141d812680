"""Graph of similarities: poses with free scale, and measurements between pairs of them.

The pose graph of a monocular model must also correct scale: each image has its own length unit, and
rigid edges cannot correct the drift of this unit (Strasdat, Montiel and Davison, "Scale
drift-aware large scale monocular SLAM", RSS 2010). A node is therefore X = (R, c, s), which maps a
point x of its own frame to

    X x = s R x + c,

and an edge measures the difference Z = (R_z, t_z, 1) of X_i M_i and X_j M_j, with M the mounts of
two cameras on their nodes. With A = X_i M_i, B = X_j M_j, P = A^-1 B = (R_p, t_p, s_p) and

    E = Z^-1 P = (R_e, t_e, s_e),    t_e = R_z^T (t_p - t_z),    s_e = s_p,

the residual is r = (Log R_e, t_e, log s_e), 7 numbers, and an edge costs 1/2 r^T W r. An edge
without a scale has zeros in the last row and column of W. t_p is measured in the unit of A.

Nodes move by X <- X (Exp(w), t, exp(l)), d = (w, t, l). To first order, r changes by

    of B:   dr = (J w,  s_e R_e t,  l),
    of A:   dr = (-J R_p^T w,  R_z^T ([t_p]x w - t - l t_p),  -l),

with J the inverse of the right Jacobian of SO(3) at Log R_e. If A moves, P becomes
(Exp(w), t, exp(l))^-1 P = (Exp(-w) R_p, exp(-l) Exp(-w) (t_p - t), exp(-l) s_p). A node moves its
camera by M^-1 (w, t, l) M, which is linear in d: with M = (R_m, t_m, 1)

    w' = R_m^T w,    t' = R_m^T (t + w x t_m + l t_m),    l' = l.

The minimiser is Levenberg-Marquardt, with one block-sparse Cholesky factorisation per step
(core/linear/edge_system.h). If scales are known, l has no column.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.model.rigid_motions import (
    cross_matrices,
    inverse_jacobian_coefficient,
    multiply_poses,
    quaternion_from_vector,
    quaternion_inverse,
    quaternion_multiply,
    quaternion_rotate,
    rotation_matrices,
    vector_from_quaternion,
)

Array = NDArray[np.float64]
Weigh = Callable[[Array], tuple[Array, Array]]

MAX_STEPS = 100
WORST_DAMPING = 1e12


@dataclass(frozen=True)
class Nodes:
    """Similarities world_from_node."""

    poses: Array  # (n, 7) qx qy qz qw and the origin of the node in the world
    scales: Array  # (n,) world units per node unit

    def of(self, index: NDArray[np.int64], mounts: Array) -> Nodes:
        """Return the cameras with these mounts (m, 7), node_from_camera, on nodes."""
        poses, scales = self.poses[index], self.scales[index]
        grown = mounts.copy()
        grown[:, 4:] *= scales[:, None]
        return Nodes(multiply_poses(poses, grown), scales)

    def moved(self, step: Array) -> Nodes:
        """Return the nodes after steps (n, 6) or (n, 7) in their own frames."""
        quaternions = quaternion_multiply(self.poses[:, :4], quaternion_from_vector(step[:, :3]))
        quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
        shift = quaternion_rotate(self.poses[:, :4], step[:, 3:6]) * self.scales[:, None]
        scales = self.scales * np.exp(step[:, 6]) if step.shape[1] == 7 else self.scales
        return Nodes(np.hstack([quaternions, self.poses[:, 4:] + shift]), scales)


@dataclass(frozen=True)
class SimilarityGraph:
    """Edges between cameras on nodes; see the head of the file."""

    edges: NDArray[np.int64]  # (m, 2) nodes i and j
    mounts: Array  # (m, 2, 7) node_from_camera of both cameras
    measurements: Array  # (m, 7) camera_i_from_camera_j
    information: Array  # (m, 7, 7) of rotation, translation, log scale; semidefinite
    held: NDArray[np.bool_]  # (n,) constant nodes
    has_free_scales: bool  # True if nodes may change their scale

    def residuals(self, nodes: Nodes) -> Array:
        """Return (m, 7): rotation vectors, translations and logarithms of scales."""
        return self._relative(nodes)[0]

    def chi2(self, nodes: Nodes) -> Array:
        """Return r^T W r of each edge (m,)."""
        r = self.residuals(nodes)
        squared: Array = np.einsum("mi,mij,mj->m", r, self.information, r)
        return np.maximum(squared, 0.0)

    def solve(self, nodes: Nodes, weigh: Weigh, tolerance: float) -> Nodes:
        """Return the nodes that minimise 1/2 sum rho(chi2) over the edges.

        ``weigh``: function from chi2 (m,) to rho and its derivative, both (m,).
        """
        free = np.flatnonzero(~self.held)
        active: NDArray[np.bool_] = ~np.all(self.held[self.edges], axis=1)
        if not len(free) or not active.any():
            return nodes
        part = dataclasses.replace(
            self,
            edges=self.edges[active],
            mounts=self.mounts[active],
            measurements=self.measurements[active],
            information=self.information[active],
        )
        return part._descend(nodes, free, lambda chi2: _within(weigh, active, chi2), tolerance)

    def _descend(
        self, nodes: Nodes, free: NDArray[np.int64], weigh: Weigh, tolerance: float
    ) -> Nodes:
        damping = 0.0
        rho, weights = weigh(self.chi2(nodes))
        cost = 0.5 * float(rho.sum())
        for _ in range(MAX_STEPS):
            diagonal, between, gradient = self._normal(nodes, weights, free)
            while True:
                step = self._step(diagonal, between, gradient, free, damping)
                if step is not None:
                    whole = np.zeros((len(self.held), step.shape[1]))
                    whole[free] = step
                    after = nodes.moved(whole)
                    after.poses[self.held] = nodes.poses[self.held]
                    rho, new_weights = weigh(self.chi2(after))
                    new_cost = 0.5 * float(rho.sum())
                    if np.isfinite(new_cost) and new_cost <= cost:
                        break
                damping = max(10 * damping, 1e-8)
                if damping > WORST_DAMPING:
                    return nodes
            change, nodes, weights = cost - new_cost, after, new_weights
            cost, damping = new_cost, damping / 10 if damping > 1e-7 else 0.0
            if change <= tolerance * cost or np.abs(step).max() < 1e-13:
                break
        return nodes

    def _relative(self, nodes: Nodes) -> tuple[Array, Array, Array, Array]:
        """Return residuals, and the rotations (q), translations and scales of P."""
        a = nodes.of(self.edges[:, 0], self.mounts[:, 0])
        b = nodes.of(self.edges[:, 1], self.mounts[:, 1])
        back = quaternion_inverse(a.poses[:, :4])
        turn = quaternion_multiply(back, b.poses[:, :4])
        shift = quaternion_rotate(back, b.poses[:, 4:] - a.poses[:, 4:]) / a.scales[:, None]
        scale = b.scales / a.scales
        z_back = quaternion_inverse(self.measurements[:, :4])
        rotation = vector_from_quaternion(quaternion_multiply(z_back, turn))
        translation = quaternion_rotate(z_back, shift - self.measurements[:, 4:])
        residual = np.hstack([rotation, translation, np.log(scale)[:, None]])
        return residual, turn, shift, scale

    def _normal(
        self, nodes: Nodes, weights: Array, free: NDArray[np.int64]
    ) -> tuple[Array, Array, Array]:
        """Return the diagonal blocks of free nodes, the blocks of edges, and the gradient."""
        r, turn, shift, scale = self._relative(nodes)
        m, d = len(r), 7 if self.has_free_scales else 6
        z_turned = np.swapaxes(rotation_matrices(self.measurements[:, :4]), 1, 2)
        p_turn = rotation_matrices(turn)
        inverse = _inverse_right_jacobian(r[:, :3])
        of_b = np.zeros((m, 7, 7))
        of_b[:, :3, :3] = inverse
        of_b[:, 3:6, 3:6] = scale[:, None, None] * (z_turned @ p_turn)
        of_b[:, 6, 6] = 1.0
        of_a = np.zeros((m, 7, 7))
        of_a[:, :3, :3] = -inverse @ np.swapaxes(p_turn, 1, 2)
        of_a[:, 3:6, :3] = z_turned @ cross_matrices(shift)
        of_a[:, 3:6, 3:6] = -z_turned
        of_a[:, 3:6, 6] = -np.einsum("mij,mj->mi", z_turned, shift)
        of_a[:, 6, 6] = -1.0
        of_a = (of_a @ _moves_of_cameras(self.mounts[:, 0]))[:, :, :d]
        of_b = (of_b @ _moves_of_cameras(self.mounts[:, 1]))[:, :, :d]
        weighted = weights[:, None, None] * self.information
        a_weighted = np.swapaxes(of_a, 1, 2) @ weighted
        b_weighted = np.swapaxes(of_b, 1, 2) @ weighted
        n = len(self.held)
        diagonal, gradient = np.zeros((n, d, d)), np.zeros((n, d))
        for column, rows, jacobian in ((0, a_weighted, of_a), (1, b_weighted, of_b)):
            np.add.at(diagonal, self.edges[:, column], rows @ jacobian)
            np.add.at(gradient, self.edges[:, column], np.einsum("mij,mj->mi", rows, r))
        return diagonal[free], a_weighted @ of_b, gradient[free]

    def _step(
        self,
        diagonal: Array,
        between: Array,
        gradient: Array,
        free: NDArray[np.int64],
        damping: float,
    ) -> Array | None:
        place = np.full(len(self.held), -1, np.int32)
        place[free] = np.arange(len(free), dtype=np.int32)
        edges = place[self.edges]
        both = (edges >= 0).all(axis=1)
        damped = diagonal.copy()
        entries = np.arange(damped.shape[1])
        damped[:, entries, entries] *= 1 + damping
        if damping > 0:
            damped[:, entries, entries] += damping * 1e-6
        return _core.solve_edge_system(
            np.ascontiguousarray(edges[both]), damped, between[both], -gradient
        )


def _within(weigh: Weigh, active: NDArray[np.bool_], chi2: Array) -> tuple[Array, Array]:
    """Apply ``weigh`` with the chi2 of some edges; the chi2 of other edges counts as 0."""
    whole = np.zeros(len(active))
    whole[active] = chi2
    rho, weights = weigh(whole)
    return rho[active], weights[active]


def _inverse_right_jacobian(vectors: Array) -> Array:
    """Return (m, 3, 3): I + [v]x / 2 + c [v]x^2."""
    factor = inverse_jacobian_coefficient(np.linalg.norm(vectors, axis=1))
    cross = cross_matrices(vectors)
    jacobian: Array = np.eye(3) + 0.5 * cross + factor[:, None, None] * (cross @ cross)
    return jacobian


def _moves_of_cameras(mounts: Array) -> Array:
    """Return (m, 7, 7) maps from a step of a node to the step of its camera with this mount."""
    back = np.swapaxes(rotation_matrices(mounts[:, :4]), 1, 2)
    matrix = np.zeros((len(mounts), 7, 7))
    matrix[:, :3, :3] = back
    matrix[:, 3:6, :3] = -back @ cross_matrices(mounts[:, 4:])
    matrix[:, 3:6, 3:6] = back
    matrix[:, 3:6, 6] = np.einsum("mij,mj->mi", back, mounts[:, 4:])
    matrix[:, 6, 6] = 1.0
    return matrix
