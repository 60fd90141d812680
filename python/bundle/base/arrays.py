"""Checked arguments of public functions, and immutable arrays.

Indices are checked only once, when a problem is created. A solve does not check them again, so the
memory of a problem's arrays must not change later. The read-only flag alone does not ensure this:
the memory may belong to a writable array, to a mapped file, to another library, or to an array
whose flag can be reset. An array that is not immutable in the sense of
``cpp/bindings/immutable_array.h`` is copied.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
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


def as_array(name: str, value: Any) -> NDArray[np.float64]:
    """Convert real numbers to a C-contiguous array of doubles, if possible without a copy.

    Raises:
        InputError: numbers are complex, masked, ragged or missing; the message begins with the
            name.
    """
    if type(value) is np.ndarray and value.dtype == np.float64 and value.flags.c_contiguous:
        return value  # fast path for thousands of calls with a few samples each
    with np.errstate(over="ignore"):  # of long doubles; the caller checks for infinity
        return np.asarray(real_numbers(name, value), dtype=np.float64, order="C")


def real_numbers(name: str, value: Any) -> NDArray[Any]:
    """Convert a value to an array of real numbers; return such an array unchanged.

    Raises:
        InputError: numbers are complex, masked, ragged or missing; the message begins with the
            name.
    """
    if is_masked(value):
        raise InputError(f"{name}: expected an array without a mask, found a masked array")
    try:
        given = np.asarray(value)
    except Exception:  # any error of the object's __array__, __len__ or __getitem__
        raise InputError(f"{name}: expected numbers, found {brief(value)}") from None
    if given.dtype.kind not in "iuf" and given.size:
        found = brief(value) if given.ndim == 0 else f"an array of {given.dtype.name}"
        raise InputError(f"{name}: expected numbers, found {found}")
    return given


def is_masked(value: Any) -> bool:
    """Return True for a masked array; does not import ``numpy.ma``, which is slow."""
    masked = sys.modules.get("numpy.ma")  # None: no masked array can exist
    return masked is not None and isinstance(value, masked.MaskedArray)


def check_function(name: str, value: Any) -> None:
    """Check that a value is callable, or None.

    Raises:
        InputError: the value is neither callable nor None.
    """
    if value is not None and not callable(value):
        raise InputError(f"{name}: expected a function, found {brief(value)}")


def as_integers(argument: str, values: Any) -> NDArray[np.int64]:
    """Convert values to an array of 64-bit integers; an empty list has shape (0,).

    Raises:
        InputError: a value is not a 64-bit integer; the message begins with the argument.
    """
    try:
        array = np.asarray(values if isinstance(values, np.ndarray) else list(values))
    except Exception:  # any error of the user's objects
        raise InputError(
            f"{argument}: expected an array of integers, found {brief(values)}"
        ) from None
    if is_masked(values):
        raise InputError(f"{argument}: expected an array without a mask, found a masked array")
    if array.size == 0:
        return np.zeros(array.shape, np.int64)
    if array.dtype.kind not in "iu":
        found = f"{array.dtype} {brief(array.flat[0])}"
        if array.dtype.kind in "US":
            found = brief(array.flat[0].item())
        raise InputError(f"{argument}: expected integers, found {found}")
    if array.dtype.kind == "u" and array.max() > np.iinfo(np.int64).max:
        raise InputError(f"{argument}: expected integers below 2^63, found {array.max()}")
    return array.astype(np.int64)


def as_flag(name: str, value: Any) -> bool:
    """Return a flag as a bool.

    Raises:
        InputError: the value is neither True nor False.
    """
    if not isinstance(value, bool | np.bool_):
        raise InputError(f"{name}: expected True or False, found {brief(value)}")
    return bool(value)


def check_type(name: str, value: Any, kind: type) -> None:
    """Check that a value is an instance of a class.

    Raises:
        InputError: the value is not an instance of the class.
    """
    if not isinstance(value, kind):
        raise InputError(f"{name}: expected a {kind.__name__}, found {brief(value)}")
