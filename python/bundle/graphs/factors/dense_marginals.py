"""Marginalisation by dense matrices in either precision: by a QR factorisation, or plainly.

With J_a and J_b the columns of the whitened Jacobian that are eliminated and kept, Householder's
reflections give

    Q^T [J_a  J_b  r] = [R_a  R_ab  r_a]
                        [ 0   R_b   r_b]
                        [ 0    0     e ],

so that the cost minimised over d_a is 1/2 ||R_b d_b + r_b||^2 + 1/2 e^2: R_b is a square root of
the Schur complement Lambda' = R_b^T R_b, and eta' = -R_b^T r_b. No difference of large numbers is
formed and no product squares what J has: Lambda' cannot become indefinite, in single precision
either (N. Demmel, D. Schubert, C. Sommer, D. Cremers, V. Usenko: Square Root Marginalization for
Sliding-Window Bundle Adjustment, ICCV 2021).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bundle.graphs.factors.variables import Array

__all__ = ["UndeterminedError", "schur_complement", "square_root_of_marginal"]


class UndeterminedError(Exception):
    """A column of what is eliminated depends on those before it; its index is the argument."""


def square_root_of_marginal(
    eliminated: Array, kept: Array, residual: Array, dtype: Any
) -> tuple[Array, Array]:
    """Return R_b (rows, n) and -r_b (rows,), rows at most n, computed in ``dtype``.

    Raises:
        UndeterminedError: R_a is singular.
    """
    scaled = _scaled(eliminated)
    stacked = np.hstack((scaled, kept, residual[:, None])).astype(dtype)
    triangle: Any = np.linalg.qr(stacked, mode="r")
    m, n = eliminated.shape[1], kept.shape[1]
    pivots = np.zeros(m)
    diagonal = np.abs(np.diagonal(triangle))[:m]
    pivots[: len(diagonal)] = diagonal
    _check_pivots(pivots, dtype)
    below = triangle[m : m + n].astype(np.float64)
    return below[:, m:-1], -below[:, -1]


def schur_complement(
    eliminated: Array, kept: Array, residual: Array, dtype: Any
) -> tuple[Array, Array]:
    """Return Lambda' (n, n), symmetric, and eta' (n,) by normal equations, computed in ``dtype``.

    Raises:
        UndeterminedError: the normal equations of what is eliminated are not positive definite.
    """
    scaled = _scaled(eliminated).astype(dtype)
    others = np.hstack((kept, -residual[:, None])).astype(dtype)
    normal = scaled.T @ scaled
    sides = scaled.T @ others
    try:
        lower = np.linalg.cholesky(normal)
    except np.linalg.LinAlgError:
        _, vectors = np.linalg.eigh(normal)
        raise UndeterminedError(int(np.argmax(np.abs(vectors[:, 0])))) from None
    _check_pivots(np.diagonal(lower).astype(np.float64) ** 2, dtype)
    halved = np.linalg.solve(lower, sides)
    whole = (others[:, :-1].T @ others) - halved[:, :-1].T @ halved
    matrix = whole[:, :-1].astype(np.float64)
    return np.tril(matrix) + np.tril(matrix, -1).T, whole[:, -1].astype(np.float64)


def _scaled(columns: Array) -> Array:
    """Return columns of norm 1, which makes pivots comparable whatever the units."""
    norms = np.linalg.norm(columns, axis=0)
    return columns / np.where(norms > 0, norms, 1.0)


def _check_pivots(pivots: Array, dtype: Any) -> None:
    rounding = 16 * max(len(pivots), 1) * float(np.finfo(dtype).eps)
    for column, pivot in enumerate(pivots):
        if not pivot > rounding:
            raise UndeterminedError(column)
