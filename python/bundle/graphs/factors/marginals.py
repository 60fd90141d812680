"""What the factors of a graph know of some of its variables, all others eliminated."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Self

import numpy as np

from bundle import _core
from bundle.base.arguments import as_flag
from bundle.errors import InputError
from bundle.graphs.factors.contents import GraphContents
from bundle.graphs.factors.dense_marginals import (
    UndeterminedError,
    schur_complement,
    square_root_of_marginal,
)
from bundle.graphs.factors.linear_prior import LinearPrior
from bundle.graphs.factors.square_root_prior import SquareRootPrior
from bundle.graphs.factors.variables import Array, Key, as_keys, variable_name
from bundle.interface.option_fields import choice

__all__ = ["GraphMarginals"]

PRECISIONS = {"double": np.float64, "single": np.float32}


class GraphMarginals(GraphContents):
    """The part of :class:`bundle.FactorGraph` that eliminates variables."""

    def information(self, keys: Iterable[Key] | None = None) -> tuple[Array, Array]:
        """Return what all factors together know of some variables, all others eliminated.

        The marginal information at the variables' values: with a the free coordinates of all other
        variables and b those asked for,

            Lambda = L_bb - L_ba L_aa^-1 L_ab,    eta = e_b - L_ba L_aa^-1 e_a

        by one factorisation of L_aa, without an inverse. Bounds do not count. Fixed coordinates of
        the variables asked for count as if they were free; those of others stay.

        Args:
            keys: the variables, in the order of the result; all of the graph if not given.

        Returns:
            Lambda (n, n), symmetric to the last bit, and eta (n,), n the sum of tangent sizes.

        Raises:
            InputError: a key is unknown, or the factors do not determine what is eliminated; the
                message names a variable.
        """
        positions = range(len(self._factors))
        members = self.keys
        return self._marginal(
            members if keys is None else as_keys("keys", keys), members, positions
        )

    def marginalize(
        self, keys: Iterable[Key], *, square_root: bool = False, precision: str = "double"
    ) -> LinearPrior | SquareRootPrior:
        """Return what eliminating variables leaves on those that their factors touch.

        Only the factors of these variables are used, linearised at the variables' values;
        :meth:`without` drops the same factors, so that ``graph.without(keys)`` and the prior
        together stand for the graph. The graph stays as it is.

        Args:
            keys: the variables to eliminate.
            square_root: eliminate by a QR factorisation of the Jacobian and keep its triangle: a
                :class:`bundle.SquareRootPrior`, which cannot become indefinite.
            precision: "double" or "single", in which the elimination computes, by dense matrices
                where it is single or by QR.

        Raises:
            InputError: a key is unknown, the factors touch nothing else, or do not determine what
                is eliminated.
        """
        precision = choice("precision", precision, tuple(PRECISIONS))
        gone = set(self._checked_keys(keys))
        used = [i for i, factor in enumerate(self._factors) if not gone.isdisjoint(factor.keys)]
        touched = {key for i in used for key in self._factors[i].keys}
        for key in gone - touched:
            raise InputError(f"{variable_name(key)}: expected a factor that touches it, found none")
        kept = [key for key in self._variables if key in touched - gone]
        if not kept:
            raise InputError("keys: expected factors that touch other variables too, found none")
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
        """Return the graph after variables left it, as a window that slides forgets its oldest.

        Args:
            keys: the variables that leave.
            how: "marginalize": their factors become a prior on what they touched, which is exact
                where these are linear; "drop": their factors are lost, with what they knew of the
                others, the gauge perhaps; "keep": nothing leaves, for comparison.
            square_root: as :meth:`marginalize` has it.
            precision: likewise.

        Raises:
            InputError: as by :meth:`marginalize`, or another word.
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
                f"{variable_name(free[column.args[0]][1])}: expected factors that determine what "
                "is eliminated, found a direction that none does"
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
