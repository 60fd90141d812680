"""Arguments of public functions, made into what they stand for or refused in one line."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError, brief

__all__ = ["as_array", "check_function", "real_numbers"]


def as_array(name: str, value: Any) -> NDArray[np.float64]:
    """Return real numbers as a C-contiguous array of doubles; itself where it is one.

    Raises:
        InputError: complex, masked, ragged or no numbers; the message begins with the name.
    """
    with np.errstate(over="ignore"):  # of long doubles; infinity is for the caller to judge
        return np.asarray(real_numbers(name, value), dtype=np.float64, order="C")


def real_numbers(name: str, value: Any) -> NDArray[Any]:
    """Return an array of real numbers as it is, anything else as one.

    Raises:
        InputError: complex, masked, ragged or no numbers; the message begins with the name.
    """
    if isinstance(value, np.ma.MaskedArray):
        raise InputError(f"{name}: expected an array without a mask, found a masked one")
    try:
        given = np.asarray(value)
    except Exception:  # whatever an object's __array__, __len__ or __getitem__ raises
        raise InputError(f"{name}: expected numbers, found {brief(value)}") from None
    if given.dtype.kind not in "iuf" and given.size:
        found = brief(value) if given.ndim == 0 else f"an array of {given.dtype.name}"
        raise InputError(f"{name}: expected numbers, found {found}")
    return given


def check_function(name: str, value: Any) -> None:
    """Refuse what cannot be called.

    Raises:
        InputError: that.
    """
    if value is not None and not callable(value):
        raise InputError(f"{name}: expected a function, found {brief(value)}")
