"""Arrays that cannot be changed after they were checked.

Indices are checked once, when a problem is made; a solve trusts them. So the memory of a problem's
arrays must not change afterwards, and the read-only flag alone does not see to that: the memory may
belong to a writable array, to a file that is mapped, to another library, or to an array whose flag
can be set back. What is not immutable in the sense of ``cpp/bindings/immutable_array.h`` is copied.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle import _core
from bundle.base.arguments import real_numbers
from bundle.errors import InputError, brief

__all__ = ["filled", "freeze", "immutable", "refrozen"]


def freeze(array: NDArray[Any]) -> NDArray[Any]:
    """Return an immutable array on the memory of one that no other object refers to."""
    return _core.freeze(array)


def filled(shape: tuple[int, ...], value: float, dtype: type) -> NDArray[Any]:
    """Return an immutable array of one value."""
    return freeze(np.full(shape, value, dtype))


def refrozen(state: Mapping[str, Any]) -> dict[str, Any]:
    """Return attributes, their arrays immutable: those of pickles and deep copies are writable."""

    def again(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return value if _core.is_immutable(value) else freeze(value.copy())
        return refrozen(value) if isinstance(value, dict) else value

    return {name: again(value) for name, value in state.items()}


def immutable(name: str, value: Any, dtype: type) -> NDArray[Any]:
    """Return the value as an immutable C-contiguous array; on the same memory where it is one.

    Raises:
        InputError: the value is no array of real numbers, or not of whole ones where the type asks
            for them; it begins with the name.
    """
    given = real_numbers(name, value)
    if given.ndim == 0:
        raise InputError(f"{name}: expected an array of numbers, found {brief(value)}")
    usable = given.dtype == dtype and given.flags.c_contiguous and given.flags.aligned
    if usable and _core.is_immutable(given):
        return given.view()
    with np.errstate(invalid="ignore", over="ignore"):  # told below, and by who checks for infinity
        array: NDArray[Any] = np.array(given, dtype=dtype, order="C", copy=True)
    if np.issubdtype(dtype, np.integer) and given.dtype != array.dtype:
        wrong = given != array
        if wrong.any():
            raise InputError(
                f"{name}: expected whole numbers of {array.dtype}, found {given[wrong][0]}"
            )
    return freeze(array)
