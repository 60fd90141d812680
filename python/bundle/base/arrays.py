"""Immutable arrays.

Indices are checked only once, when a problem is created. A solve does not check them again, so the
memory of a problem's arrays must not change later. The read-only flag alone does not ensure this:
the memory may belong to a writable array, to a mapped file, to another library, or to an array
whose flag can be reset. An array that is not immutable in the sense of
``cpp/bindings/immutable_array.h`` is copied.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arguments import real_numbers
from bundle.errors import InputError, brief


def freeze(array: NDArray[Any]) -> NDArray[Any]:
    """Return an immutable array on the memory of ``array``, which must have no other references."""
    return _core.freeze(array)


def distinct(values: NDArray[Any]) -> NDArray[Any]:
    """Return the distinct values, sorted.

    NumPy's unique imports masked arrays for 10 ms, unless it also returns counts.
    """
    return np.unique(values, return_counts=True)[0]


def median(values: NDArray[np.float64]) -> float:
    """Return the lower median; 0 without values. NumPy's median imports masked arrays for 6 ms."""
    middle = (len(values) - 1) // 2
    return float(np.partition(values, middle)[middle]) if len(values) else 0.0


def filled(shape: tuple[int, ...], value: float, dtype: type) -> NDArray[Any]:
    """Return an immutable array filled with one value."""
    return freeze(np.full(shape, value, dtype))


def refrozen(state: Mapping[str, Any]) -> dict[str, Any]:
    """Return attributes with immutable arrays; arrays from pickles and deep copies are writable."""

    def again(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return value if _core.is_immutable(value) else freeze(value.copy())
        return refrozen(value) if isinstance(value, dict) else value

    return {name: again(value) for name, value in state.items()}


class FrozenArrays:
    """Base of classes whose arrays are immutable again after pickling and deep copies."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(refrozen(state))


def immutable(name: str, value: Any, dtype: type) -> NDArray[Any]:
    """Convert a value to an immutable C-contiguous array; copy only if necessary.

    Raises:
        InputError: the value is not an array of real numbers (whole numbers for an integer type);
            the message begins with the name.
    """
    given = real_numbers(name, value)
    if given.ndim == 0:
        raise InputError(f"{name}: expected an array of numbers, found {brief(value)}")
    usable = given.dtype == dtype and given.flags.c_contiguous and given.flags.aligned
    if usable and _core.is_immutable(given):
        return given.view()
    with np.errstate(
        invalid="ignore", over="ignore"
    ):  # checked below; the caller checks for infinity
        array: NDArray[Any] = np.array(given, dtype=dtype, order="C", copy=True)
    if np.issubdtype(dtype, np.integer) and given.dtype != array.dtype:
        wrong = given != array
        if wrong.any():
            raise InputError(
                f"{name}: expected whole numbers of {array.dtype}, found {given[wrong][0]}"
            )
    return freeze(array)
