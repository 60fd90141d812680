"""A prior kept as the square root of its information, as marginalisation by QR leaves it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bundle.base.words import plural
from bundle.errors import InputError
from bundle.graphs.factors.anchored import AnchoredFactor
from bundle.graphs.factors.spectrum import PriorSpectrum
from bundle.graphs.factors.variables import Array, Key

__all__ = ["SquareRootPrior"]


@dataclass(frozen=True, eq=False, repr=False)
class SquareRootPrior(AnchoredFactor):
    """The cost 1/2 ||R d - b||^2 of d = Log(X*^-1 X) over several variables.

    Its information R^T R is positive semidefinite whatever R is, and has twice the digits of a
    :class:`bundle.LinearPrior`. ``spectrum``, ``cost_jump`` and ``sources`` are as there.

    Attributes:
        root: R, (rows, n), n the sum of the tangent sizes, variables in the order of ``keys``.
        vector: b, (rows,).
        linearization_point: the values X* by key, as the manifolds store them.
        keys: the variables.
        manifolds: by key, "euclidean" where not given.

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
                raise InputError(f"{self.name}: {name}: expected finite numbers, found others")
        if not root.any():
            raise InputError(f"{self.name}: root: expected some information, found none")

    @property
    def Lambda(self) -> Array:  # noqa: N802
        """R^T R, (n, n)."""
        root: Array = np.asarray(self.root)
        return np.asarray(root.T @ root)

    @property
    def eta(self) -> Array:
        """R^T b, (n,)."""
        return np.asarray(np.asarray(self.root).T @ np.asarray(self.vector))

    def reanchor(self, values: Mapping[Key, ArrayLike]) -> SquareRootPrior:
        """Return the same prior about other values: b - R d, R unchanged.

        As :meth:`bundle.LinearPrior.reanchor`, ``cost_jump`` included; on Euclidean variables the
        cost is the same function.

        Args:
            values: new linearization points by key; keys that are not the prior's are ignored.

        Raises:
            InputError: a value is missing or none of its manifold.
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
                f"{name}: expected {plural(sum(sizes), 'column')} of root, one a tangent "
                f"coordinate, found {np.asarray(self.root).shape[1]}"
            )
        return [self.linearization_point[key] for key in self.keys], self.root, self.vector
