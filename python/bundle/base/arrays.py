"""Checked arguments of public functions, and immutable arrays.

Indices are checked only once, when a problem is created. A solve does not check them again, so the
memory of a problem's arrays must not change later. The read-only flag alone does not ensure this:
the memory may belong to a writable array, to a mapped file, to another library, or to an array
whose flag can be reset. An array that is not immutable in the sense of
``cpp/bindings/immutable_array.h`` is copied.

Classes declare the arrays of their fields in a table ``ARRAYS``, functions those of their arguments
where they read them. :func:`check_arrays` and :func:`as_declared` apply the declarations.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.errors import InputError, brief


def freeze(array: NDArray[Any]) -> NDArray[Any]:
    """Return an immutable array on the memory of ``array``, which must have no other references."""
    return _core.freeze(array)


def distinct(values: NDArray[Any], axis: int | None = None) -> NDArray[Any]:
    """Return the distinct values, or rows (axis 0), sorted.

    NumPy's unique imports masked arrays for 10 ms, unless it also returns counts.
    """
    return np.unique(values, return_counts=True, axis=axis)[0]


def rows_among(ids: NDArray[np.int64], among: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the position of each id in ``among``, -1 if it is absent."""
    order = np.argsort(among, kind="stable")
    found = np.searchsorted(among, ids, sorter=order)
    rows = np.append(order, 0)[found]
    known = (found < len(among)) & (np.append(among, 0)[rows] == ids)
    return np.where(known, rows, -1)


def median(values: NDArray[np.float64]) -> float:
    """Return the lower median; 0 without values. NumPy's median imports masked arrays for 6 ms."""
    middle = (len(values) - 1) // 2
    return float(np.partition(values, middle)[middle]) if len(values) else 0.0


def filled(shape: tuple[int, ...], value: float, dtype: type) -> NDArray[Any]:
    """Return an immutable array filled with one value."""
    return freeze(np.full(shape, value, dtype))


def no_rows(dtype: type, *shape: int) -> Any:
    """Return a field of a dataclass that is an empty array if an input has no such rows."""
    return dataclasses.field(default_factory=lambda: filled(shape or (0,), 0, dtype))


def refrozen(state: Mapping[str, Any]) -> dict[str, Any]:
    """Return attributes with immutable arrays; arrays from pickles and deep copies are writable."""

    def again(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return value if _core.is_immutable(value) else freeze(value.copy())
        return refrozen(value) if isinstance(value, dict) else value

    return {name: again(value) for name, value in state.items()}


class FrozenArrays:
    """Base of classes whose arrays are immutable again after pickling and deep copies.

    Fields that the class of an older pickle did not have get the values of their factories.
    """

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, one in getattr(self, "__dataclass_fields__", {}).items():
            if name not in state and one.default_factory is not dataclasses.MISSING:
                self.__dict__[name] = one.default_factory()
        self.__dict__.update(refrozen(state))


def immutable(name: str, value: Any, dtype: type) -> NDArray[Any]:
    """Convert a value to an immutable C-contiguous array; copy only if necessary."""
    is_plain = type(value) is np.ndarray and value.dtype == dtype
    given = value if is_plain else real_numbers(name, value)
    if given.ndim == 0:
        raise InputError(f"{name}: expected an array of numbers, found {brief(value)}")
    if given.dtype == dtype:
        usable = given.flags.c_contiguous and given.flags.aligned and _core.is_immutable(given)
        return given.view() if usable else freeze(np.array(given, order="C", copy=True))
    with np.errstate(invalid="ignore", over="ignore"):  # of integers below, infinity by callers
        array: NDArray[Any] = np.array(given, dtype=dtype, order="C", copy=True)
    if np.issubdtype(dtype, np.integer):
        refuse_row(
            given.ravel() != array.ravel(),
            lambda k: f"{name}: expected whole numbers of {array.dtype}, found {given.flat[k]}",
        )
    return freeze(array)


def as_array(name: str, value: Any) -> NDArray[np.float64]:
    """Convert real numbers to a C-contiguous array of doubles, if possible without a copy."""
    if type(value) is np.ndarray and value.dtype == np.float64 and value.flags.c_contiguous:
        return value  # fast path for thousands of calls with a few samples each
    with np.errstate(over="ignore"):  # of long doubles; the caller checks for infinity
        return np.asarray(real_numbers(name, value), dtype=np.float64, order="C")


def real_numbers(name: str, value: Any) -> NDArray[Any]:
    """Convert a value to an array of real numbers; return such an array unchanged."""
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
    """Refuse a value that is neither callable nor None."""
    if value is not None and not callable(value):
        raise InputError(f"{name}: expected a function, found {brief(value)}")


def as_integers(argument: str, values: Any) -> NDArray[np.int64]:
    """Convert values to an array of 64-bit integers; an empty list has shape (0,)."""
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
    """Return a flag as a bool."""
    check_type(name, value, bool | np.bool_, "True or False")
    return bool(value)


def check_type(name: str, value: Any, kind: Any, expected: str = "") -> None:
    """Refuse a value that is not an instance of a class, or of one of several (int | str)."""
    if not isinstance(value, kind):
        raise InputError(
            f"{name}: expected {expected or f'a {kind.__name__}'}, found {brief(value)}"
        )


def check_distinct(expected: str, names: Iterable[Hashable]) -> None:
    """Refuse a name that occurs twice; the message begins with ``expected``."""
    seen = set()
    for name in names:
        if name in seen:
            raise InputError(f"{expected}, found {brief(name)} twice")
        seen.add(name)


def refuse_row(wrong: Any, message: Callable[[int], str]) -> None:
    """Raise an InputError with the message of the first True in a mask (n,), if there is one."""
    rows = np.flatnonzero(wrong)
    if len(rows):
        raise InputError(message(int(rows[0])))


@contextmanager
def at(place: str, errors: type[Exception] = InputError) -> Iterator[None]:
    """Put a place before the messages of errors that the block raises."""
    try:
        yield
    except errors as error:
        raise InputError(f"{place}: {error}") from None


class Index(NamedTuple):
    """Declaration of numbers from ``lowest`` to one less than a size, by its name."""

    size: str
    words: str = "indices"
    lowest: int = 0


class Array(NamedTuple):
    """Declaration of an array that a field or an argument takes."""

    # length of each axis: a number, or the name of a size. The first array with the name fixes the
    # size; until then messages show the name
    shape: tuple[int | str, ...]
    values: str | Index = "any"  # condition of the numbers: a key of ``VALUES``, or an ``Index``
    dtype: type = np.float64  # type of the array
    # what None stands for: a number in all places, "range" (0, 1, 2, ...), "none" (the field may
    # stay None) or "required"
    default: float | Literal["range", "none", "required"] = "required"


def declare(**arrays: Array) -> Mapping[str, Array]:
    """Return the table of a class: declarations by field."""
    return arrays


VALUES: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "any": ("numbers", lambda x: np.ones(x.shape, bool)),
    "finite": ("finite numbers", np.isfinite),
    "finite or nan": ("finite numbers or nan", lambda x: ~np.isinf(x)),
    "not nan": ("numbers", lambda x: ~np.isnan(x)),
    "above 0": ("numbers above 0", lambda x: x > 0),
    "at least 0": ("numbers of 0 or more", lambda x: x >= 0),
    "whole": ("whole numbers from 0", lambda x: x >= 0),
    "share or nan": ("shares of a frame above 0 and at most 1", lambda x: ~((x <= 0) | (x > 1))),
    "pose": ("finite numbers", np.isfinite),
    "quaternion": ("finite numbers", np.isfinite),
}
"""Names of what numbers must be: in words, and as a test. The first four numbers of a pose, and of
a quaternion, must not all be zero, either."""

Sizes = dict[Any, int]
"""Sizes by name."""


def check_arrays(
    record: Any, declared: Mapping[str, Array], subject: str = "", **sizes: int
) -> Sizes:
    """Convert and check fields of a frozen record in the order of the table, shapes before numbers.

    ``record``: the record; its fields become immutable arrays.
    """
    found = {}
    for name, one in declared.items():
        value = getattr(record, name)
        if value is None and one.default == "none":
            continue
        if value is None and one.default != "required":
            array = default_of(one, sizes)
        else:
            array = immutable(subject + name, value, one.dtype)
        check_shape(subject + name, array, one.shape, sizes)
        object.__setattr__(record, name, array)
        found[name] = array
    for name, array in found.items():
        check_values(subject + name, array, declared[name], sizes)
    return sizes


def default_of(declared: Array, sizes: Sizes) -> NDArray[Any]:
    """Return the default of a field whose sizes are known."""
    shape = tuple(sizes.get(length, length) for length in declared.shape)
    if declared.default == "range":
        return freeze(np.arange(shape[0], dtype=declared.dtype))
    return filled(shape, declared.default, declared.dtype)  # type: ignore[arg-type]


def as_declared(name: str, value: Any, declared: Array, sizes: Sizes | None = None) -> Any:
    """Convert an argument to an array of doubles or 64-bit integers, and check it."""
    is_whole = np.issubdtype(declared.dtype, np.integer)
    array = as_integers(name, value) if is_whole else as_array(name, value)
    sizes = {} if sizes is None else sizes
    check_shape(name, array, declared.shape, sizes)
    check_values(name, array, declared, sizes)
    return array


def check_shape(
    name: str, array: NDArray[Any], shape: tuple[int | str, ...], sizes: Sizes | None = None
) -> None:
    """Refuse an array of another shape; add the sizes that it fixes to the known ones."""
    sizes = {} if sizes is None else sizes
    expected = [sizes.get(length, length) for length in shape]
    fits = len(expected) == array.ndim
    if not fits or any(
        length != found
        for length, found in zip(expected, array.shape, strict=True)
        if not isinstance(length, str)
    ):
        shown = f"{', '.join(map(str, expected))}{',' * (len(expected) == 1)}"
        raise InputError(f"{name}: expected shape ({shown}), found {array.shape}")
    sizes.update(zip(shape, array.shape, strict=True))


def check_values(
    name: str, array: NDArray[Any], declared: Array, sizes: Sizes | None = None
) -> None:
    """Refuse numbers that are not as declared; the message names the first row."""
    values = declared.values
    if values == "any":
        return
    if isinstance(values, Index):
        lowest, count = values.lowest, (sizes or {})[values.size]
        expected = f"{values.words} from {lowest} to {count - 1}"
        right = (array >= lowest) & (array < count)
    else:
        expected, test = VALUES[values]
        right = test(array)
    if not right.all():
        _refuse_rows(name, array, ~right, declared.shape, expected)
    if values in ("pose", "quaternion") and array.shape[-1] in (4, 7):
        zero = (array[..., :4] == 0).all(axis=-1, keepdims=True)
        if zero.any():
            _refuse_rows(name, array, zero, declared.shape, "a quaternion qx qy qz qw", "norm 0")


def _refuse_rows(
    name: str,
    array: NDArray[Any],
    wrong: NDArray[np.bool_],
    shape: tuple[int | str, ...],
    expected: str,
    found: str = "",
) -> None:
    """Raise an InputError that names the first wrong row; the array if its length is fixed."""
    place = ""
    if isinstance(shape[0], str):
        row = int(np.argmax(wrong.reshape(len(array), -1).any(axis=1)))
        place, array = f"[{row}]" * (array.ndim > 1), array[row]
    raise InputError(f"{name}{place}: expected {expected}, found {found or brief(array.tolist())}")
