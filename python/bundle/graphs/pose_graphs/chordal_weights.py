"""Weights of a chordal cost from the information of a pose graph's edges.

A chordal cost (``cpp/core/pose_graph/chordal_cost.cpp``) has two numbers per edge,

    F = sum kappa || Y_j - Y_i R ||_F^2 + tau || t_j - t_i - Y_i t ||^2.

Let theta be the angle of the rotation's error, and u the error of the translation. Then

    || Y_j - Y_i R ||_F^2 = 4 (1 - cos theta) = 8 sin^2(theta / 2),

in the plane and in space. A solve minimises chi2 = sum e^T Omega e, with e of one of three kinds.
Isotropic information omega on the rotation and tau on the translation gives

    error  in space                                 kappa      in the plane
    log    omega theta^2 + tau ||V^-1 u||^2         omega / 2  omega theta^2 + tau ||V^-1 u||^2
    ceres  4 omega sin^2(theta/2) + tau ||u||^2     omega / 2  omega theta^2 + tau ||u||^2
    g2o    omega sin^2(theta/2) + tau ||u||^2       omega / 8  omega theta^2 + tau ||u||^2

and kappa = omega / 2 in the plane. V = int_0^1 exp(s theta) ds is a mean of rotations, so that
||V|| <= 1 and ||V^-1 u|| >= ||u||. With 4 sin^2(theta/2) <= theta^2, **F <= chi2 at all poses**,
for every kind of error; in space F = chi2 for g2o's and Ceres' error.

Any information satisfies Omega >= alpha diag(a I, b I), with a and b the smallest eigenvalues of
its blocks of rotation and translation, and alpha the smallest eigenvalue of the scaled matrix
D^-1/2 Omega D^-1/2, D = diag(a I, b I), which is 1 without a block that couples both. With the
weights of alpha a and alpha b ("bound"), F <= chi2 again. A lower bound of this F is a lower bound
of chi2. "mean" uses the means of the diagonals; for isotropic information it is the same.
"se-sync" are the weights of SE-Sync's reader of g2o files.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.model.pose_graph_arrays import PoseGraph

CHORDAL_WEIGHTS = ("mean", "se-sync")

ISOTROPIC = 1e-9
"""Relative difference of weights below which information is isotropic."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ChordalWeights:
    """Weights (m,) of the rotations and the translations of edges."""

    kappa: Floats
    tau: Floats

    def equals(self, other: ChordalWeights) -> bool:
        """Tell whether the weights of all edges are the same up to rounding."""
        return all(
            bool((np.abs(a - b) <= ISOTROPIC * np.abs(a)).all())
            for a, b in ((self.kappa, other.kappa), (self.tau, other.tau))
        )


def chordal_weights(graph: PoseGraph, weights: str, error: str) -> ChordalWeights:
    """Return the weights of a graph."""
    rotation, translation = _blocks(graph)
    if weights == "mean":
        kappa = _per_omega(graph, error) * _mean_diagonal(rotation)
        tau = _mean_diagonal(translation)
    else:
        kappa = 0.5 * _harmonic(rotation) if graph.dimension == 3 else rotation[:, 0, 0]
        tau = _harmonic(translation)
    usable = np.isfinite(kappa) & np.isfinite(tau) & (kappa > 0) & (tau > 0)
    if not usable.all():
        edge = int(np.argmin(usable))
        raise InputError(
            f"{graph.edge_name(edge)}: information: a certificate expects weights above 0 on "
            f"rotation and translation, found {kappa[edge]:g} and {tau[edge]:g}"
        )
    return ChordalWeights(kappa, tau)


def bound_weights(graph: PoseGraph, error: str) -> ChordalWeights | None:
    """Return the weights with F <= chi2 at all poses; None if an edge has singular information."""
    rotation, translation = _blocks(graph)
    least_rotation = np.linalg.eigvalsh(rotation)[:, 0]
    least_translation = np.linalg.eigvalsh(translation)[:, 0]
    if not (least_rotation.min() > 0 and least_translation.min() > 0):
        return None
    size, d = graph.tangent_size, graph.dimension
    diagonal = np.empty((graph.num_edges, size))
    diagonal[:, _rotation_of(graph)] = least_rotation[:, None]
    diagonal[:, _translation_of(graph)] = least_translation[:, None]
    root = 1 / np.sqrt(diagonal)
    scaled = root[:, :, None] * graph.information * root[:, None, :]
    # Rounding of eigenvalues must not raise a bound.
    alpha = np.minimum(np.linalg.eigvalsh(scaled)[:, 0], 1) - 8 * d * np.finfo(float).eps
    if not alpha.min() > 0:
        return None
    return ChordalWeights(
        _per_omega(graph, error) * alpha * least_rotation, alpha * least_translation
    )


def _per_omega(graph: PoseGraph, error: str) -> float:
    return 0.125 if error == "g2o" and graph.dimension == 3 else 0.5


def _rotation_of(graph: PoseGraph) -> slice:
    return slice(2, 3) if graph.dimension == 2 else slice(0, 3)


def _translation_of(graph: PoseGraph) -> slice:
    return slice(0, 2) if graph.dimension == 2 else slice(3, 6)


def _blocks(graph: PoseGraph) -> tuple[Floats, Floats]:
    rotation, translation = _rotation_of(graph), _translation_of(graph)
    return (
        graph.information[:, rotation, rotation],
        graph.information[:, translation, translation],
    )


def _mean_diagonal(blocks: Floats) -> Floats:
    mean: Floats = np.einsum("ekk->e", blocks) / blocks.shape[1]
    return mean


def _harmonic(blocks: Floats) -> Floats:
    """Return d / tr(Omega^-1) of each block; 0 for a singular block."""
    values = np.linalg.eigvalsh(blocks)
    safe = np.where(values > 0, values, np.inf)
    mean = blocks.shape[1] / (1 / safe).sum(axis=1)
    return np.where(values[:, 0] > 0, mean, 0.0)
