"""Marginalization: information of the factors on some variables after elimination of the others.

Dense elimination runs in single or double precision, by QR (square-root marginalisation) or by
normal equations. Let J_a and J_b be the eliminated and the kept columns of the whitened Jacobian.
Householder reflections give

    Q^T [J_a  J_b  r] = [R_a  R_ab  r_a]
                        [ 0   R_b   r_b]
                        [ 0    0     e ],

so that the cost minimised over d_a is 1/2 ||R_b d_b + r_b||^2 + 1/2 e^2. R_b is a square root of
the Schur complement Lambda' = R_b^T R_b, and eta' = -R_b^T r_b. The elimination forms no difference
of large numbers and no product that squares the condition number of J. Therefore Lambda' cannot
become indefinite, even in single precision (N. Demmel, D. Schubert, C. Sommer, D. Cremers, V.
Usenko: Square Root Marginalization for Sliding-Window Bundle Adjustment, ICCV 2021).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Self

import numpy as np

import bundle._core as _core
from bundle.base.arrays import as_flag
from bundle.errors import InputError
from bundle.graphs.factors.contents import GraphContents
from bundle.graphs.factors.linear_prior import LinearPrior, SquareRootPrior
from bundle.graphs.factors.variables import Array, Key, as_keys, variable_name
from bundle.interface.option_fields import choice


class UndeterminedError(Exception):
    """Error for an eliminated column that depends on earlier columns; the argument is its index."""


def square_root_of_marginal(
    eliminated: Array, kept: Array, residual: Array, dtype: Any
) -> tuple[Array, Array]:
    """Return R_b (rows, n) and -r_b (rows,), rows at most n, computed in ``dtype``."""
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
    """Return Lambda' (n, n), symmetric, and eta' (n,) by normal equations in ``dtype``."""
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
    """Scale columns to norm 1, so that pivots can be compared in any units."""
    norms = np.linalg.norm(columns, axis=0)
    return columns / np.where(norms > 0, norms, 1.0)


def _check_pivots(pivots: Array, dtype: Any) -> None:
    rounding = 16 * max(len(pivots), 1) * float(np.finfo(dtype).eps)
    for column, pivot in enumerate(pivots):
        if not pivot > rounding:
            raise UndeterminedError(column)


PRECISIONS = {"double": np.float64, "single": np.float32}


class GraphMarginals(GraphContents):
    """Part of :class:`bundle.FactorGraph` that eliminates variables."""

    def information(self, keys: Iterable[Key] | None = None) -> tuple[Array, Array]:
        """Return the joint marginal information of all factors on some variables.

        All other variables are eliminated, at the variables' present values. With a the free
        coordinates of the other variables and b the coordinates of ``keys``,

            Lambda = L_bb - L_ba L_aa^-1 L_ab,    eta = e_b - L_ba L_aa^-1 e_a

        by one factorisation of L_aa, without an inverse. Bounds have no effect. Fixed coordinates
        of ``keys`` count as free; fixed coordinates of other variables stay fixed.

        Args:
            keys: variables in the order of the result; by default all variables.

        Returns:
            Lambda (n, n), exactly symmetric, and eta (n,), with n the sum of tangent sizes.

        Raises:
            InputError: a key is unknown, or the factors do not determine the eliminated variables;
                the message names one.
        """
        positions = range(len(self._factors))
        members = self.keys
        return self._marginal(
            members if keys is None else as_keys("keys", keys), members, positions
        )

    def marginalize(
        self, keys: Iterable[Key], *, square_root: bool = False, precision: str = "double"
    ) -> LinearPrior | SquareRootPrior:
        """Eliminate variables; return the prior on the other variables of their factors.

        Only the factors of these variables are used, linearised at the variables' values.
        :meth:`without` drops the same factors, so ``graph.without(keys)`` and the prior together
        replace the graph. The graph itself does not change.

        Args:
            keys: the variables to eliminate.
            square_root: eliminate by a QR factorisation of the Jacobian and keep its triangle: a
                :class:`bundle.SquareRootPrior`, which cannot become indefinite.
            precision: "double" or "single" precision of the elimination; single precision and QR
                use dense matrices.

        Raises:
            InputError: a key is unknown, or the factors have no other variables or do not determine
                the eliminated variables.
        """
        precision = choice("precision", precision, tuple(PRECISIONS))
        gone = set(self._checked_keys(keys))
        used = [i for i, factor in enumerate(self._factors) if not gone.isdisjoint(factor.keys)]
        touched = {key for i in used for key in self._factors[i].keys}
        for key in gone - touched:
            raise InputError(
                f"{variable_name(key)}: expected at least one factor of this variable, found 0"
            )
        kept = [key for key in self._variables if key in touched - gone]
        if not kept:
            raise InputError("keys: expected factors that also have other variables, found 0")
        members = [key for key in self._variables if key in touched]
        by_root = as_flag("square_root", square_root)
        if by_root or precision == "single":
            compute = square_root_of_marginal if by_root else schur_complement
            matrix, vector = self._dense_marginal(
                compute, kept, members, used, PRECISIONS[precision]
            )
        else:
            matrix, vector = self._marginal(kept, members, used)
        kind = SquareRootPrior if by_root else LinearPrior
        prior = kind(
            matrix,
            vector,
            {key: self._variables[key].value for key in kept},
            tuple(kept),
            manifolds={key: self._variables[key].manifold for key in kept},
        )
        return prior.made_of(self._factors[i] for i in used)

    def forget(
        self,
        keys: Iterable[Key],
        how: str = "marginalize",
        *,
        square_root: bool = False,
        precision: str = "double",
    ) -> Self:
        """Return the graph without some variables, as in a fixed-lag smoother.

        Args:
            keys: variables to remove.
            how: "marginalize": their factors become a prior on the neighbours, which is exact if
                the factors are linear; "drop": their factors are lost, including their information
                on the neighbours and possibly the gauge; "keep": nothing is removed, for
                comparison.
            square_root: as in :meth:`marginalize`.
            precision: as in :meth:`marginalize`.

        Raises:
            InputError: for the reasons of :meth:`marginalize`, or ``how`` is unknown.
        """
        how = choice("how", how, ("marginalize", "drop", "keep"))
        keys = self._checked_keys(keys)
        if how == "keep":
            return self.with_values({})
        graph = self.without(keys)
        if how == "marginalize":
            graph.add_factor(self.marginalize(keys, square_root=square_root, precision=precision))
        return graph

    def _dense_marginal(
        self,
        compute: Callable[[Array, Array, Array, Any], tuple[Array, Array]],
        kept: list[Key],
        members: list[Key],
        positions: list[int],
        dtype: Any,
    ) -> tuple[Array, Array]:
        core = self._core(members, positions, [self._factors[i] for i in positions])
        residual, jacobian = _core.graph_jacobian(*core)
        columns: dict[Key, list[int]] = {}
        free: list[tuple[int, Key]] = []
        begin = 0
        for key in members:
            variable = self._variables[key]
            size = len(variable.coordinates)
            columns[key] = list(range(begin, begin + size))
            if key not in kept:
                held = variable.held or (False,) * size
                free += [(begin + i, key) for i in range(size) if not held[i]]
            begin += size
        of_kept = [column for key in kept for column in columns[key]]
        try:
            return compute(jacobian[:, [c for c, _ in free]], jacobian[:, of_kept], residual, dtype)
        except UndeterminedError as column:
            raise InputError(
                f"{variable_name(free[column.args[0]][1])}: expected factors that determine the "
                "eliminated variables, found an undetermined direction"
            ) from None

    def _marginal(
        self, kept: Iterable[Key], members: Iterable[Key], positions: Iterable[int]
    ) -> tuple[Array, Array]:
        members, positions = list(members), list(positions)
        places = {key: i for i, key in enumerate(members)}
        for key in kept:
            self._known("keys", key)
        core = self._core(members, positions, [self._factors[i] for i in positions])
        return _core.marginal_information(*core, [places[key] for key in kept])
