"""Arguments of public functions, made into what they stand for or refused in one line."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError, brief

__all__ = [
    "as_array",
    "as_flag",
    "as_integers",
    "check_function",
    "check_type",
    "is_masked",
    "real_numbers",
]


def as_array(name: str, value: Any) -> NDArray[np.float64]:
    """Return real numbers as a C-contiguous array of doubles; itself where it is one.

    Raises:
        InputError: complex, masked, ragged or no numbers; the message begins with the name.
    """
    if type(value) is np.ndarray and value.dtype == np.float64 and value.flags.c_contiguous:
        return value  # calls by the thousand, each with a few samples
    with np.errstate(over="ignore"):  # of long doubles; infinity is for the caller to judge
        return np.asarray(real_numbers(name, value), dtype=np.float64, order="C")


def real_numbers(name: str, value: Any) -> NDArray[Any]:
    """Return an array of real numbers as it is, anything else as one.

    Raises:
        InputError: complex, masked, ragged or no numbers; the message begins with the name.
    """
    if is_masked(value):
        raise InputError(f"{name}: expected an array without a mask, found a masked one")
    try:
        given = np.asarray(value)
    except Exception:  # whatever an object's __array__, __len__ or __getitem__ raises
        raise InputError(f"{name}: expected numbers, found {brief(value)}") from None
    if given.dtype.kind not in "iuf" and given.size:
        found = brief(value) if given.ndim == 0 else f"an array of {given.dtype.name}"
        raise InputError(f"{name}: expected numbers, found {found}")
    return given


def is_masked(value: Any) -> bool:
    """Tell whether a value is a masked array; does not import ``numpy.ma``, which takes a while."""
    masked = sys.modules.get("numpy.ma")  # without it there is no masked array
    return masked is not None and isinstance(value, masked.MaskedArray)


def check_function(name: str, value: Any) -> None:
    """Refuse what cannot be called.

    Raises:
        InputError: that.
    """
    if value is not None and not callable(value):
        raise InputError(f"{name}: expected a function, found {brief(value)}")


def as_integers(argument: str, values: Any) -> NDArray[np.int64]:
    """Return an array of integers of any shape; nothing at all has shape (0,).

    Raises:
        InputError: these are no integers of 64 bits; the message begins with the argument.
    """
    try:
        array = np.asarray(values if isinstance(values, np.ndarray) else list(values))
    except Exception:  # whatever the user's objects raise while they are looked at
        raise InputError(
            f"{argument}: expected an array of integers, found {brief(values)}"
        ) from None
    if is_masked(values):
        raise InputError(f"{argument}: expected an array without a mask, found a masked one")
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
    """Return True or False.

    Raises:
        InputError: it is neither.
    """
    if not isinstance(value, bool | np.bool_):
        raise InputError(f"{name}: expected True or False, found {brief(value)}")
    return bool(value)


def check_type(name: str, value: Any, kind: type) -> None:
    """Refuse what is no instance of a class.

    Raises:
        InputError: that.
    """
    if not isinstance(value, kind):
        raise InputError(f"{name}: expected a {kind.__name__}, found {brief(value)}")
