"""Names of the parts of a problem: keys of variables, and selections of images.

A sensor of a rig has two ids, ``("sensor", (rig_id, camera_id))``.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import at, check_type
from bundle.errors import InputError, brief
from bundle.model.cameras import camera_models
from bundle.model.estimates import kinds, variable_of
from bundle.model.problem import Problem


class ProblemKeys:
    """Table from keys to variables of a problem.

    Args:
        problem: problem with the variables.
        kinds: allowed first elements of a key.
        what: role of a key for the caller, in messages.
    """

    def __init__(self, problem: Problem, kinds: tuple[str, ...], what: str) -> None:
        self._problem = problem
        self._kinds = kinds
        self._what = what
        self._indices: dict[str, dict[Any, int]] = {}

    def find(self, argument: str, key: Any) -> tuple[str, int]:
        """Return the kind of a key and its index in the problem's arrays."""
        if (
            not isinstance(key, tuple)
            or len(key) != 2
            or key[0] not in self._kinds
            or not _is_id(key[0], key[1])
        ):
            *others, last = (f"({kind!r}, {_ID.get(kind, 'id')})" for kind in self._kinds)
            expected = f"{', '.join(others)} or {last}" if others else last
            raise InputError(
                f"{argument}: expected {expected} for a {self._what}, found {brief(key)}"
            )
        kind, number = key
        if kind not in self._indices:
            self._indices[kind] = {known: index for index, known in enumerate(self._ids(kind))}
        index = self._indices[kind].get(number)
        if index is None:
            raise InputError(f"{argument}: there is no {kind} {number} in the problem")
        return kind, index

    def _ids(self, kind: str) -> list[Any]:
        problem = self._problem
        if kind != "sensor":
            ids: list[Any] = getattr(
                problem, f"{variable_of(kind).rows.removesuffix('s')}_ids"
            ).tolist()
            return ids
        rigs, cameras = problem.sensor_rig_ids.tolist(), problem.sensor_camera_ids.tolist()
        return list(zip(rigs, cameras, strict=True))


_ID = {"sensor": "(rig id, camera id)"}


def _is_id(kind: str, found: Any) -> bool:
    if kind in _ID:
        return isinstance(found, tuple) and len(found) == 2 and all(map(_is_whole, found))
    return _is_whole(found)


def _is_whole(found: Any) -> bool:
    return isinstance(found, int | np.integer) and not isinstance(found, bool)


def parameter_names(argument: str, problem: Problem, camera: int) -> tuple[str, ...]:
    """Return the names of a camera's parameters, by its index."""
    model = problem.camera_models[camera]
    names = camera_models().get(model)
    if names is None:
        raise InputError(
            f"{argument}: camera {problem.camera_ids[camera]}: model {model} is not supported"
        )
    return names


def touched_ids(factors: Iterable[Any]) -> dict[str, list[Any]]:
    """Return the ids of the variables of factors by kind; keys of unknown kind are left out."""
    touched: dict[str, list[Any]] = {kind: [] for kind in kinds()}
    keys: list[Any] = [key for factor in factors for key in factor.keys]
    for key in keys:
        if isinstance(key, tuple) and len(key) == 2 and key[0] in touched:  # others: error later
            touched[key[0]].append(key[1])
    return touched


MOST_IDS = 10_000_000
"""Largest number of ids in a list. It prevents that a typing error in a range fills the memory."""

ImageSelection = str | Iterable[int | str]
"""A list such as "1,5-9,left/*.jpg", or its entries one by one."""


def find_images(argument: str, problem: Problem, selection: Any) -> tuple[int, ...]:
    """Return the sorted ids of the images in a selection, each once.

    An entry is an id (12), a range of ids (5-9), or an image name, which may contain wildcards:
    ``*`` for any characters, ``?`` for one character and ``[ab]`` for a character of a set. Names
    are case-sensitive. A string is split at its commas. For a name with a comma, pass a list of
    entries, or write ``?`` for the comma.
    """
    if isinstance(selection, str):
        entries: list[Any] = [entry.strip() for entry in selection.split(",")]
    else:
        try:
            entries = list(selection)
        except TypeError:
            raise InputError(
                f"{argument}: expected ids or names of images, found {brief(selection)}"
            ) from None
    if not entries or any(isinstance(entry, str) and not entry for entry in entries):
        raise InputError(f"{argument}: expected ids or names of images, found {brief(selection)}")
    known = set(problem.image_ids.tolist())
    found: set[int] = set()
    for entry in entries:
        ids = _ids(argument, entry)
        if ids is None:
            found.update(named_images(argument, problem, entry))
            continue
        for image_id in ids:
            if image_id not in known:
                raise InputError(f"{argument}: there is no image {image_id} in the problem")
            found.add(image_id)
    return tuple(sorted(found))


def _ids(argument: str, entry: Any) -> Iterable[int] | None:
    """Return the ids of an entry, None if it is a name."""
    if isinstance(entry, int | np.integer) and not isinstance(entry, bool):
        return (int(entry),)
    check_type(argument, entry, str, "ids or names of images")
    with at(argument, ValueError):
        ids = id_range(entry)
    if ids is not None and ids.stop - ids.start > MOST_IDS:  # len() ends at 2^63 - 1
        raise InputError(f"{argument}: expected at most {MOST_IDS} ids, found {entry!r}")
    return ids


def id_range(text: str) -> range | None:
    """Parse "5" or "5-9" to ids; return None for other text."""
    first, dash, last = (piece.strip() for piece in text.partition("-"))
    if not _is_number(first) or (dash and not _is_number(last)):
        return None
    low, high = int(first), int(last) if dash else int(first)
    if high < low:
        raise ValueError(f"the range {text.strip()!r} ends before it starts")
    return range(low, high + 1)


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) < 20 and int(text) < 2**63


def named_images(argument: str, problem: Problem, pattern: str) -> list[int]:
    """Return the id of the image with a name, or the ids of images whose names match a pattern."""
    names, ids = problem.image_names, problem.image_ids.tolist()
    found = [key for key, name in zip(ids, names, strict=True) if name == pattern]
    if len(found) > 1:
        raise InputError(
            f"{argument}: expected one image named {pattern!r}, found {len(found)} "
            f"(ids {', '.join(map(str, found))}); give the id of an image instead"
        )
    if not found:
        matching = set(fnmatch.filter(set(names), pattern))
        found = [key for key, name in zip(ids, names, strict=True) if name in matching]
    if not found:
        raise InputError(
            f"{argument}: expected ids or names of images, found no image named {pattern!r}"
        )
    return found


def are_in(ids: NDArray[np.int64], some: frozenset[int]) -> NDArray[np.bool_]:
    """Return a mask of the ids in a set; for a few ids faster than NumPy's isin (20 us)."""
    if not some:
        return np.zeros(len(ids), bool)
    return np.fromiter(map(some.__contains__, ids.tolist()), bool, len(ids))
