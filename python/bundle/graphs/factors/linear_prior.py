"""Quadratic priors on several variables, the results of marginalization.

``LinearPrior`` stores the information matrix, ``SquareRootPrior`` its square root from QR.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.errors import InputError
from bundle.graphs.factors.anchored import AnchoredFactor
from bundle.graphs.factors.spectrum import PriorSpectrum
from bundle.graphs.factors.variables import Array, Key


@dataclass(frozen=True, eq=False, repr=False)
class LinearPrior(AnchoredFactor):
    """Quadratic cost 1/2 d^T Lambda d - eta^T d of d = Log(X*^-1 X) over several variables.

    The cost of the factor is this plus a constant that makes its minimum 0. Lambda may be singular;
    gauge directions then stay free.

    Attributes:
        Lambda: (n, n) symmetric positive semidefinite, n the sum of the tangent sizes, variables in
            the order of ``keys``.
        eta: (n,), in the range of Lambda.
        linearization_point: values X* by key, in the manifolds' representation.
        keys: the variables.
        manifolds: manifolds by key; "euclidean" if missing.

    Further attributes are ``spectrum`` (:class:`bundle.PriorSpectrum` of Lambda), ``cost_jump`` of
    the last re-anchoring and, for results of :meth:`bundle.FactorGraph.marginalize`, ``sources``.

    Raises:
        InputError: shapes, keys or manifolds do not fit each other.
            :meth:`bundle.FactorGraph.add_factor` refuses an asymmetric or indefinite Lambda.
    """

    Lambda: ArrayLike
    eta: ArrayLike
    linearization_point: Mapping[Key, ArrayLike]
    keys: tuple[Key, ...]
    manifolds: Mapping[Key, str] = field(default_factory=dict, kw_only=True)

    kind = "linear"

    def __post_init__(self) -> None:
        self._keys_first()
        super().__post_init__()
        self._freeze_matrix("Lambda")
        self._freeze_row("eta")
        size = self._check_anchor()
        if np.shape(self.Lambda) != (size, size) or np.shape(self.eta) != (size,):
            raise InputError(
                f"{self.name}: expected Lambda of shape {(size, size)} and eta of {(size,)}, "
                f"found {np.shape(self.Lambda)} and {np.shape(self.eta)}"
            )

    def reanchor(self, values: Mapping[Key, ArrayLike]) -> LinearPrior:
        """Return the same prior about other values: eta - Lambda d, Lambda unchanged.

        On Euclidean variables the cost is the same function up to the constant 1/2 d^T Lambda d -
        eta^T d, which is ``cost_jump`` of the result. The cost of the factor, whose minimum is 0
        about any point, does not change. On curved manifolds the quadratic form is kept, with the
        Jacobians of the first linearization point (first-estimate Jacobians).

        Args:
            values: new linearization points by key; other keys are ignored.

        Raises:
            InputError: a value is missing or does not lie on its manifold.
        """
        points, step = self._step_to(values)
        slope = np.asarray(self.Lambda) @ step
        eta = np.asarray(self.eta)
        moved = LinearPrior(
            self.Lambda,
            eta - slope,
            points,
            self.keys,
            manifolds=self.manifolds,
            loss=self.loss,
            loss_scale=self.loss_scale,
        )
        return self._moved(moved, float(step @ (slope / 2 - eta)))

    def _matrix(self) -> Array:
        return np.asarray(self.Lambda)

    def core_arguments(self, name: str, sizes: tuple[int, ...]) -> tuple[Any, ...]:  # noqa: ARG002
        """See :meth:`Factor.core_arguments`."""
        return [self.linearization_point[key] for key in self.keys], self.Lambda, self.eta


@dataclass(frozen=True, eq=False, repr=False)
class SquareRootPrior(AnchoredFactor):
    """Quadratic cost 1/2 ||R d - b||^2 of d = Log(X*^-1 X) over several variables.

    The information R^T R is positive semidefinite for any R, and has twice the digits of a
    :class:`bundle.LinearPrior`. That class explains ``spectrum``, ``cost_jump`` and ``sources``.

    Attributes:
        root: R, (rows, n), n the sum of the tangent sizes, variables in the order of ``keys``.
        vector: b, (rows,).
        linearization_point: values X* by key, in the manifolds' representation.
        keys: the variables.
        manifolds: manifolds by key; "euclidean" if missing.

    Raises:
        InputError: shapes, keys or manifolds do not fit each other, or a number is not finite.
    """

    root: ArrayLike
    vector: ArrayLike
    linearization_point: Mapping[Key, ArrayLike]
    keys: tuple[Key, ...]
    manifolds: Mapping[Key, str] = field(default_factory=dict, kw_only=True)

    kind = "square_root"

    def __post_init__(self) -> None:
        self._keys_first()
        super().__post_init__()
        self._freeze_matrix("root")
        self._freeze_row("vector")
        size = self._check_anchor()
        root, vector = np.asarray(self.root), np.asarray(self.vector)
        if root.ndim != 2 or root.shape[1] != size or vector.shape != root.shape[:1] or not size:
            raise InputError(
                f"{self.name}: expected root of shape (rows, {size}) and vector of (rows,), "
                f"found {root.shape} and {vector.shape}"
            )
        for name, array in (("root", root), ("vector", vector)):
            if not np.isfinite(array).all():
                raise InputError(
                    f"{self.name}: {name}: expected finite numbers, found nan or infinity"
                )
        if not root.any():
            raise InputError(f"{self.name}: root: expected at least one row, found 0")

    @property
    def Lambda(self) -> Array:  # noqa: N802
        """Information matrix R^T R, (n, n)."""
        root: Array = np.asarray(self.root)
        return np.asarray(root.T @ root)

    @property
    def eta(self) -> Array:
        """Information vector R^T b, (n,)."""
        return np.asarray(np.asarray(self.root).T @ np.asarray(self.vector))

    def reanchor(self, values: Mapping[Key, ArrayLike]) -> SquareRootPrior:
        """Return the same prior about other values: b - R d, R unchanged.

        ``cost_jump`` is as in :meth:`bundle.LinearPrior.reanchor`; on Euclidean variables the cost
        is the same function.

        Args:
            values: new linearization points by key; other keys are ignored.

        Raises:
            InputError: a value is missing or does not lie on its manifold.
        """
        points, step = self._step_to(values)
        change = np.asarray(self.root) @ step
        vector = np.asarray(self.vector)
        moved = SquareRootPrior(
            self.root,
            vector - change,
            points,
            self.keys,
            manifolds=self.manifolds,
            loss=self.loss,
            loss_scale=self.loss_scale,
        )
        return self._moved(moved, float(change @ (change / 2 - vector)))

    def _matrix(self) -> Array:
        return self.Lambda

    def _find_spectrum(self) -> PriorSpectrum:
        return PriorSpectrum.of_root(np.asarray(self.root))

    def core_arguments(self, name: str, sizes: tuple[int, ...]) -> tuple[Any, ...]:
        """See :meth:`Factor.core_arguments`."""
        if np.asarray(self.root).shape[1] != sum(sizes):
            raise InputError(
                f"{name}: expected {plural(sum(sizes), 'column')} of root, one per tangent "
                f"coordinate, found {np.asarray(self.root).shape[1]}"
            )
        return [self.linearization_point[key] for key in self.keys], self.root, self.vector
