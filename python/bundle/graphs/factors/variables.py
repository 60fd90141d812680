"""Variables of a factor graph: keys, manifolds, values."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping, Set
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import bundle._core as _core
from bundle.base.arrays import FrozenArrays, as_array, as_integers, freeze
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.errors import InputError, brief
from bundle.interface.option_fields import choice

Key = Hashable
Array = NDArray[np.float64]

MANIFOLDS = ("euclidean", "so2", "so3", "se2", "se3")


def variable_name(key: Key) -> str:
    """Return the name of a variable for messages."""
    return f"variable {brief(key)}"


@dataclass(frozen=True, eq=False)
class Variable(FrozenArrays):
    """Variable of a graph.

    Attributes:
        key: name of the variable in the graph.
        manifold: one of MANIFOLDS.
        value: (n,) in the manifold's representation; quaternions have norm 1.
        coordinates: names of the tangent coordinates.
        held: flag per tangent coordinate, True if constant; () if all are free.
        lower: lower bounds (n,), or (0,) without bounds.
        upper: upper bounds in the same shape.
    """

    key: Key
    manifold: str
    value: Array
    coordinates: tuple[str, ...]
    held: tuple[bool, ...]
    lower: Array
    upper: Array

    @cached_property
    def name(self) -> str:
        """Name for messages."""
        return variable_name(self.key)

    @staticmethod
    def make(
        key: Key,
        value: ArrayLike,
        manifold: str,
        fixed: bool | Iterable[int],
        lower: ArrayLike | None,
        upper: ArrayLike | None,
    ) -> Variable:
        """Return a checked variable.

        Raises:
            InputError: value, manifold and bounds do not fit each other; the message names the
                variable.
        """
        name = variable_name(key)
        manifold = choice(f"{name}: manifold", manifold, MANIFOLDS)
        checked, coordinates = _core.check_value(name, manifold, as_row(name, value))
        held = _held(name, fixed, len(coordinates))
        bounds = [
            _bound(name, what, manifold, bound, len(checked), none)
            for what, bound, none in (("lower", lower, -np.inf), ("upper", upper, np.inf))
        ]
        if lower is None and upper is None:
            bounds = [np.zeros(0), np.zeros(0)]
        equal = bounds[0] == bounds[1]
        if equal.any():
            held = tuple(bool(flag) for flag in equal | (held or False))
        variable = Variable(
            key, manifold, checked, tuple(coordinates), held, freeze(bounds[0]), freeze(bounds[1])
        )
        _core.check_variable((*variable.core()[:-2], *bounds))
        return variable

    def holding(self, held: NDArray[np.bool_]) -> Variable:
        """Return the variable with additional coordinates held constant."""
        flags = held | np.array(self.held or (False,) * len(held))
        return replace(self, held=tuple(map(bool, flags)))

    def core(self) -> tuple[Any, ...]:
        """Return the arguments of ``_core``.

        Equal bounds, which Ceres refuses, become constants.
        """
        equal = self.lower == self.upper
        lower, upper = (
            np.where(equal, infinity, bound)
            for infinity, bound in ((-np.inf, self.lower), (np.inf, self.upper))
        )
        return (
            self.name,
            self.manifold,
            self.value,
            list(self.held),
            lower,
            upper,
        )


class Values(Mapping[Key, Array]):
    """View of the values of variables by key, like ``dict.values``."""

    def __init__(self, variables: Mapping[Key, Variable]) -> None:
        self._variables = variables

    def __getitem__(self, key: Key) -> Array:
        return self._variables[key].value

    def __iter__(self) -> Iterator[Key]:
        return iter(self._variables)

    def __len__(self) -> int:
        return len(self._variables)

    def __repr__(self) -> str:
        return repr(dict(self))


def as_row(name: str, value: Any) -> Array:
    """Return numbers as an array (n,); one number has n = 1."""
    row = np.atleast_1d(as_array(name, value))
    if row.ndim != 1:
        raise InputError(f"{name}: expected a 1-D array of numbers, found shape {row.shape}")
    return row


def as_keys(argument: str, keys: Any, *, ordered: bool = True) -> tuple[Key, ...]:
    """Return distinct keys in the given order."""
    listed = as_list(argument, "keys", keys)
    if ordered and isinstance(keys, Set):
        raise InputError(f"{argument}: expected a list of keys with an order, found a set")
    seen: set[Key] = set()
    for key in listed:
        check_key(argument, key)
        if key in seen:
            raise InputError(f"{argument}: expected different variables, found {brief(key)} twice")
        seen.add(key)
    return listed


def as_list(argument: str, things: str, given: Any) -> tuple[Any, ...]:
    """Return the members of an iterable other than text."""
    try:
        if not isinstance(given, str | bytes):
            return tuple(given)
    except TypeError:
        pass
    raise InputError(f"{argument}: expected a list of {things}, found {brief(given)}")


def check_key(argument: str, key: Any) -> None:
    """Refuse keys that are not hashable."""
    try:
        hash(key)
    except Exception:  # any exception of a user's __hash__
        raise InputError(
            f"{argument}: expected a key, such as a word or a number, found {brief(key)}"
        ) from None


def _held(name: str, fixed: bool | Iterable[int], size: int) -> tuple[bool, ...]:
    if isinstance(fixed, bool | np.bool_):
        return (True,) * size if fixed else ()
    flags = [False] * size
    for entry in as_integers(f"{name}: fixed", fixed).reshape(-1):
        if not 0 <= entry < size:
            raise InputError(
                f"{name}: fixed: expected tangent coordinates from 0 to {size - 1}, found {entry}"
            )
        flags[entry] = True
    return tuple(flags) if any(flags) else ()


def _bound(
    name: str, what: str, manifold: str, bound: ArrayLike | None, size: int, none: float
) -> Array:
    if bound is None:
        return np.full(size, none)
    if manifold != "euclidean":
        raise InputError(f"{name}: {what}: expected a euclidean variable, found {manifold}")
    values = as_array(f"{name}: {what}", bound)
    if values.ndim and values.shape != (size,):
        raise InputError(
            f"{name}: {what}: expected {plural(size, 'number')}, found shape {values.shape}"
        )
    if np.isnan(values).any():
        raise InputError(f"{name}: {what}: expected numbers, found nan")
    return np.ascontiguousarray(np.broadcast_to(values, (size,)), dtype=np.float64).copy()
