"""Variables and factors of a graph, checked when they are added."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any, Self
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

import bundle._core as _core
from bundle.base.arrays import check_type
from bundle.base.display import Displayed
from bundle.base.words import plural
from bundle.errors import InputError, nearest
from bundle.graphs.factors.factors import Factor
from bundle.graphs.factors.linear_prior import AnchoredFactor
from bundle.graphs.factors.variables import (
    Array,
    Key,
    Values,
    Variable,
    as_keys,
    check_key,
    variable_name,
)


class GraphContents(Displayed):
    """Variables and factors, without computations on them (:class:`bundle.FactorGraph`)."""

    def __init__(self) -> None:
        self._variables: dict[Key, Variable] = {}
        self._factors: list[Factor] = []
        self._in_priors: WeakKeyDictionary[Factor, str] = WeakKeyDictionary()
        self._as_tuples: tuple[tuple[Key, ...], tuple[Factor, ...]] = (), ()

    def __copy__(self) -> Self:
        return self.with_values({})

    def add_variable(
        self,
        key: Key,
        value: ArrayLike,
        manifold: str = "euclidean",
        *,
        fixed: bool | Iterable[int] = False,
        lower: ArrayLike | None = None,
        upper: ArrayLike | None = None,
    ) -> None:
        """Add a variable.

        Args:
            key: name of the variable, any hashable object.
            value: start of a solve, in the manifold's representation; quaternions may have any norm
                but 0.
            manifold: "euclidean", "so2", "so3", "se2" or "se3".
            fixed: True to hold the variable constant, or the tangent coordinates to hold constant.
            lower: lower bound of each number of a Euclidean variable, or one bound for all. A step
                that would cross a bound ends on it; equal bounds hold the number constant.
            upper: upper bounds in the same form.

        Raises:
            InputError: the key is taken, the value does not lie on the manifold, or the bounds
                exclude it.
        """
        check_key("key", key)
        if key in self._variables:
            raise InputError(f"{variable_name(key)}: expected a new key, found a key of the graph")
        self._variables[key] = Variable.make(key, value, manifold, fixed, lower, upper)

    def add_factor(self, factor: Factor) -> None:
        """Add a factor of variables that are in the graph.

        Raises:
            InputError: the object is not a factor, a key is unknown, or its numbers do not fit the
                variables: a wrong size, or an information matrix that is asymmetric, singular or
                indefinite. Also if information would count twice: the graph would have a prior of
                :meth:`bundle.FactorGraph.marginalize` together with a factor that it contains, or
                two priors that contain the same factor.
        """
        check_type("factor", factor, Factor)
        position = len(self._factors)
        name = factor_name(position, factor)
        for key in factor.keys:
            self._known(name, key)
        if isinstance(factor, AnchoredFactor):
            for key, manifold in factor.manifolds.items():
                if manifold != self._variables[key].manifold:
                    raise InputError(
                        f"{name}: {variable_name(key)}: expected manifold "
                        f"{self._variables[key].manifold}, found {manifold}; give manifolds="
                    )
        self._refuse_double_counting(name, factor)
        if factor.kind != "function":  # a function is first called when its values are needed
            variables, (given,) = self._core(factor.keys, [position], [factor])
            _core.factor_function(variables, given)
        self._factors.append(factor)
        self._remember(factor)

    @property
    def keys(self) -> tuple[Key, ...]:
        """Variables in the order in which they were added."""
        return self._tuples()[0]

    @property
    def variables(self) -> Mapping[Key, Variable]:
        """Variables by key."""
        return dict(self._variables)

    def variable(self, argument: str, key: Key) -> Variable:
        """Return a variable.

        Args:
            argument: name of the argument with the key, for messages.
            key: key of the variable.

        Raises:
            InputError: the graph does not have the variable.
        """
        return self._known(argument, key)

    @property
    def factors(self) -> tuple[Factor, ...]:
        """Factors in the order in which they were added."""
        return self._tuples()[1]

    @property
    def values(self) -> Mapping[Key, Array]:
        """Values of the variables, the start of a solve; the view follows changes of the graph."""
        return Values(self._variables)

    def with_values(self, values: Mapping[Key, ArrayLike]) -> Self:
        """Return the graph with other values, such as the result of a solve.

        Args:
            values: values by key; missing variables keep their values.

        Raises:
            InputError: a key is unknown, or a value does not lie on its manifold.
        """
        check_type("values", values, Mapping, "a dict by key")
        graph = type(self)()
        graph._variables, graph._factors = dict(self._variables), list(self._factors)
        graph._in_priors = self._in_priors.copy()
        for key, value in values.items():
            old = graph._known("values", key)
            bounds = (old.lower, old.upper) if len(old.lower) else (None, None)
            fixed = tuple(i for i, held in enumerate(old.held) if held)
            new = Variable.make(key, value, old.manifold, fixed, *bounds)
            if len(new.value) != len(old.value):
                raise InputError(
                    f"values: {variable_name(key)}: expected {plural(len(old.value), 'number')}, "
                    f"found {len(new.value)}"
                )
            graph._variables[key] = new
        return graph

    def without(self, keys: Iterable[Key]) -> Self:
        """Return the graph without some variables and without all factors of these variables.

        Raises:
            InputError: a key is unknown.
        """
        gone = set(self._checked_keys(keys))
        graph = type(self)()
        graph._variables = {k: v for k, v in self._variables.items() if k not in gone}
        graph._factors = [f for f in self._factors if gone.isdisjoint(f.keys)]
        for factor in graph._factors:
            graph._remember(factor)
        return graph

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_in_priors": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _in_priors=WeakKeyDictionary())

    def _refuse_double_counting(self, name: str, factor: Factor) -> None:
        """Refuse a factor that a prior of the graph contains, and a prior of its factors."""
        sources = factor.sources if isinstance(factor, AnchoredFactor) else ()
        for source in (factor, *sources):
            if source in self._in_priors:
                raise InputError(
                    f"{name}: expected every factor to count once, but {source.name} is already "
                    f"marginalised into {self._in_priors[source]} of the graph"
                )
        if not sources:
            return
        places = {id(member): i for i, member in enumerate(self._factors)}
        for source in sources:
            if id(source) in places:
                raise InputError(
                    f"{name}: expected every factor to count once, but it contains "
                    f"{factor_name(places[id(source)], source)}, which is in the graph; add it to "
                    "the graph without(...) the eliminated variables"
                )

    def _remember(self, factor: Factor) -> None:
        if isinstance(factor, AnchoredFactor):
            for source in factor.sources:
                self._in_priors[source] = factor.name

    def _tuples(self) -> tuple[tuple[Key, ...], tuple[Factor, ...]]:
        """Return keys and factors, cached until a graph grows (it never shrinks)."""
        keys, factors = self._as_tuples
        if len(factors) != len(self._factors):
            factors = tuple(self._factors)
        if len(keys) != len(self._variables):
            keys = tuple(self._variables)
        self._as_tuples = keys, factors
        return keys, factors

    def _core(
        self,
        keys: Iterable[Key] | None = None,
        positions: Iterable[int] | None = None,
        factors: Iterable[Factor] | None = None,
    ) -> tuple[list[Any], list[Any]]:
        """Return variables and factors in the format of ``_core``; by default all."""
        factors = list(self._factors if factors is None else factors)
        members = list(self._variables if keys is None else keys)
        positions = range(len(factors)) if positions is None else positions
        places = {key: i for i, key in enumerate(members)}
        described = []
        for position, factor in zip(positions, factors, strict=True):
            name = factor_name(position, factor)
            sizes = tuple(len(self._variables[key].coordinates) for key in factor.keys)
            described.append((
                factor.kind,
                name,
                [places[key] for key in factor.keys],
                factor.loss,
                factor.loss_scale,
                factor.core_arguments(name, sizes),
            ))  # fmt: skip
        return [self._variables[key].core() for key in members], described

    def core(self, factors: Sequence[Factor] | None = None) -> tuple[list[Any], list[Any]]:
        """Return variables and factors in the format of ``_core``.

        Args:
            factors: some factors of the graph, which are returned with their variables only; None:
                all factors and variables.
        """
        if factors is None:
            return self._core()
        return self._core(
            dict.fromkeys(key for factor in factors for key in factor.keys), None, factors
        )

    def check_free(self) -> None:
        """Refuse a graph without a free coordinate.

        Raises:
            InputError: the graph has no variable, no factor or no free coordinate.
        """
        for noun, count in (("variable", len(self._variables)), ("factor", len(self._factors))):
            if not count:
                raise InputError(f"graph: expected at least one {noun}, found 0")
        if all(variable.held and all(variable.held) for variable in self._variables.values()):
            raise InputError(
                "graph: expected a free coordinate, found only constant variables "
                f"({len(self._variables)})"
            )

    def _known(self, argument: str, key: Key) -> Variable:
        check_key(argument, key)
        if key not in self._variables:
            words = [known for known in self._variables if isinstance(known, str)]
            hint = nearest(key, words) if isinstance(key, str) else ""
            raise InputError(f"{argument}: there is no {variable_name(key)}{hint}")
        return self._variables[key]

    def _checked_keys(self, keys: Iterable[Key]) -> tuple[Key, ...]:
        found = as_keys("keys", keys, ordered=False)
        if not found:
            raise InputError("keys: expected at least one variable, found 0")
        for key in found:
            self._known("keys", key)
        return found


def factor_name(position: int, factor: Factor) -> str:
    """Return the name of a factor of a graph for messages."""
    return f"factor {position}, {factor.name}"


def connected(
    variables: Mapping[Key, Variable], factors: Iterable[Factor], *, held_connect: bool = True
) -> dict[Key, int]:
    """Return the component of each variable: the position of one of its variables."""
    place = {key: k for k, key in enumerate(variables)}
    joins = {key for key, v in variables.items() if held_connect or not (v.held and all(v.held))}
    pairs = [
        (place[first], place[second])
        for factor in factors
        for first, second in pairwise([key for key in factor.keys if key in joins])
    ]
    labels = _core.pose_components(len(place), np.array(pairs, np.int32).reshape(-1, 2))
    return dict(zip(place, np.asarray(labels).tolist(), strict=True))
