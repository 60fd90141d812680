"""Lists of ids for sentences."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from numpy.typing import NDArray

__all__ = ["named", "noun", "sorted_ids"]

_MOST = 5


def named(what: str, ids: Iterable[int]) -> str:
    """Return "image 3", "images 3, 4" or "images 3, 4, 5, 6, 7 and 12 more"."""
    listed = [int(entry) for entry in ids]
    first = ", ".join(map(str, listed[:_MOST]))
    more = f" and {len(listed) - _MOST} more" if len(listed) > _MOST else ""
    return f"{what}{'' if len(listed) == 1 else 's'} {first}{more}"


def noun(count: int, one: str, many: str) -> str:
    """Return the singular or plural of a noun for a count."""
    return one if count == 1 else many


def sorted_ids(ids: NDArray[Any], rows: NDArray[Any]) -> tuple[int, ...]:
    """Return the ids in some rows, ascending."""
    return tuple(sorted(ids[rows].tolist()))
