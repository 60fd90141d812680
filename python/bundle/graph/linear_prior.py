"""A dense quadratic prior on several variables, as marginalisation leaves it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bundle import _core
from bundle.errors import InputError, brief
from bundle.graph.factors import Factor
from bundle.graph.variables import MANIFOLDS, Key, as_keys, as_row, variable_name
from bundle.option_fields import choice

__all__ = ["LinearPrior"]


@dataclass(frozen=True, eq=False, repr=False)
class LinearPrior(Factor):
    """The cost 1/2 d^T Lambda d - eta^T d of d = Log(X*^-1 X) over several variables.

    As a factor it costs this and a constant that makes its minimum 0. Lambda may be singular: what
    a gauge leaves free stays free.

    Attributes:
        Lambda: (n, n) symmetric positive semidefinite, n the sum of the tangent sizes, variables in
            the order of ``keys``.
        eta: (n,), in the range of Lambda.
        linearization_point: the values X* by key, as the manifolds store them.
        keys: the variables.
        manifolds: by key, "euclidean" where not given.

    Raises:
        InputError: shapes, keys or manifolds do not fit each other; a Lambda that is asymmetric or
            indefinite is refused by :meth:`bundle.FactorGraph.add_factor`.
    """

    Lambda: ArrayLike
    eta: ArrayLike
    linearization_point: Mapping[Key, ArrayLike]
    keys: tuple[Key, ...]
    manifolds: Mapping[Key, str] = field(default_factory=dict, kw_only=True)

    kind = "linear"

    def __post_init__(self) -> None:
        object.__setattr__(self, "keys", as_keys("LinearPrior: keys", self.keys))
        super().__post_init__()
        self._freeze_matrix("Lambda")
        self._freeze_row("eta")
        for what in ("linearization_point", "manifolds"):
            given = getattr(self, what)
            if not isinstance(given, Mapping):
                raise InputError(
                    f"{self.name}: {what}: expected a dict by key, found {brief(given)}"
                )
            for key in given:
                if key not in self.keys:
                    raise InputError(f"{self.name}: {what}: there is no variable {brief(key)}")
        points, manifolds = {}, {}
        size = 0
        for key in self.keys:
            if key not in self.linearization_point:
                raise InputError(f"{self.name}: linearization_point: expected one of {brief(key)}")
            where = f"{self.name}: manifold of {brief(key)}"
            manifolds[key] = choice(where, self.manifolds.get(key, "euclidean"), MANIFOLDS)
            where = f"{self.name}: linearization_point of {brief(key)}"
            value = as_row(where, self.linearization_point[key])
            points[key], names = _core.check_value(where, manifolds[key], value)
            size += len(names)
        if np.shape(self.Lambda) != (size, size) or np.shape(self.eta) != (size,):
            raise InputError(
                f"{self.name}: expected Lambda of shape {(size, size)} and eta of {(size,)}, "
                f"found {np.shape(self.Lambda)} and {np.shape(self.eta)}"
            )
        self._set("linearization_point", points)
        self._set("manifolds", manifolds)

    def reanchor(self, values: Mapping[Key, ArrayLike]) -> LinearPrior:
        """Return the same prior about other values: eta - Lambda d, Lambda unchanged.

        On Euclidean variables the cost is the same function, without the constant that it leaves
        out, which changes by 1/2 d^T Lambda d - eta^T d. On curved manifolds the quadratic form is
        carried over as it is; its Jacobians stay those of the first linearization point.

        Args:
            values: new linearization points by key; keys that are not the prior's are ignored.

        Raises:
            InputError: a value is missing or none of its manifold.
        """
        points, steps = {}, []
        if not isinstance(values, Mapping):
            raise InputError(f"values: expected a dict by key, found {brief(values)}")
        for key in self.keys:
            if key not in values:
                raise InputError(f"values: expected one of {variable_name(key)}, found none")
            manifold = self.manifolds[key]
            value = as_row(variable_name(key), values[key])
            points[key], _ = _core.check_value(variable_name(key), manifold, value)
            old = np.asarray(self.linearization_point[key])
            if len(points[key]) != len(old):
                raise InputError(
                    f"{variable_name(key)}: expected {len(old)} numbers, found {len(points[key])}"
                )
            steps.append(_core.local_coordinates(manifold, old, points[key]))
        eta = np.asarray(self.eta) - np.asarray(self.Lambda) @ np.concatenate(steps)
        return LinearPrior(
            self.Lambda,
            eta,
            points,
            self.keys,
            manifolds=self.manifolds,
            loss=self.loss,
            loss_scale=self.loss_scale,
        )

    def core_arguments(self, name: str, sizes: tuple[int, ...]) -> tuple[Any, ...]:  # noqa: ARG002
        """See :meth:`Factor.core_arguments`."""
        return [self.linearization_point[key] for key in self.keys], self.Lambda, self.eta
