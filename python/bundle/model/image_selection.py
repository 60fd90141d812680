"""Selections of images by ids, ranges of ids and name patterns."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable
from typing import Any

import numpy as np

from bundle.base.arrays import at, check_type
from bundle.errors import InputError, brief
from bundle.model.problem import Problem

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
    """Parse "5" or "5-9" to ids; return None for other text.

    Raises:
        ValueError: the range ends before it starts.
    """
    first, dash, last = (piece.strip() for piece in text.partition("-"))
    if not _is_id(first) or (dash and not _is_id(last)):
        return None
    low, high = int(first), int(last) if dash else int(first)
    if high < low:
        raise ValueError(f"the range {text.strip()!r} ends before it starts")
    return range(low, high + 1)


def _is_id(text: str) -> bool:
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
