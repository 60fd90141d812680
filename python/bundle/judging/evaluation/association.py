"""Association of the poses of an estimate A with those of a reference B.

Equal names denote the same image. If more names are equal without folders, or without folders and
suffix, these shorter names are compared. A name that several images share at that level has no
partner. The nearest time stamp of B is the partner, if it is also the nearest in the other
direction and differs by at most the tolerance. Small whole numbers, as in frame_0012.jpg, count
frames: the stamps of the other input must, too, with all numbers of one input among those of the
other. Without names and stamps, poses correspond by order.

Pairs are sorted by name (numbers by size) or by time: the order of the input changes no result.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from decimal import Decimal

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.base.words import noun, number
from bundle.errors import InputError, brief
from bundle.georeference.text_lines import last_part
from bundle.model.pose_table import PoseTable
from bundle.model.sequence.sequence import other_unit

FEWEST = 3  # number of shared poses that an alignment needs

NANOSECONDS = 10**14
"""Least integer in a name that is read as nanoseconds; as seconds, three million years."""

EARLIEST_CLOCK = 10**8
"""Least integer in a name that is read as seconds of a clock; its date is in 1973."""

_NO_STAMPS = "expected names that are time stamps, because the other input has time stamps only"
LATEST_STAMP = Decimal(2**63)

Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Association:
    """Pairs of poses of the same image or time."""

    rows_a: Indices  # (n,) indices of the poses of A
    rows_b: Indices  # (n,) indices of the poses of B
    names: tuple[str, ...]  # n names: those of A if it has names, else of B, times or numbers
    only_a: tuple[str, ...]  # names of the poses of A without a partner
    only_b: tuple[str, ...]  # names of the poses of B without a partner
    by: str  # "name", "base name", "stem", "time", "frame number" or "order"
    sentence: str  # the rule in words

    def __len__(self) -> int:
        return len(self.names)


def associate(a: PoseTable, b: PoseTable, tolerance: float = 0.01) -> Association:
    """Return the pairs of poses of A and B; see the top of this file.

    The tolerance of time stamps is in seconds.
    """
    named = [_is_named(table) for table in (a, b)]
    timed = [table.timestamps_ns is not None for table in (a, b)]
    if all(named):
        found = _by_name(a, b)
    elif any(timed) and all(t or n for t, n in zip(timed, named, strict=True)):
        found = _by_time(a, b, tolerance)
    else:
        found = _by_order(a, b)
    if len(found) < FEWEST:
        raise InputError(_too_few(a, b, found, named, tolerance))
    return found


def _is_named(table: PoseTable) -> bool:
    return len(table) > 0 and all(table.names)


def _by_name(a: PoseTable, b: PoseTable) -> Association:
    for argument, table in (("a", a), ("b", b)):
        again = [name for name, count in Counter(table.names).items() if count > 1]
        if again:
            raise InputError(
                f"{argument}: expected a different name for each image, found {brief(again[0])} "
                f"{Counter(table.names)[again[0]]} times"
            )
    best: tuple[int, str, list[tuple[int, int]]] | None = None
    for by, key in _LEVELS.items():
        known_a, known_b = _unique(a.names, key), _unique(b.names, key)
        pairs = [(row, known_b[name]) for name, row in known_a.items() if name in known_b]
        if best is None or len(pairs) > best[0]:
            best = len(pairs), by, pairs
    assert best is not None
    count, by, pairs = best
    pairs.sort(key=lambda pair: _by_size(a.names[pair[0]]))
    sentence = f"by {_SAID[by]}"
    return _made(a, b, np.array(pairs, np.int64).reshape(count, 2), by, sentence)


_LEVELS: dict[str, Callable[[str], str]] = {
    "name": lambda name: name,
    "base name": last_part,
    "stem": lambda name: re.sub(r"(?<=.)\.[A-Za-z]\w*$", "", last_part(name)),
}
_SAID = {
    "name": "name",
    "base name": "name without folders",
    "stem": "name without folders and suffix",
}


def _by_size(name: str) -> tuple[int, str]:
    """Return the sort key of a name; numbers, such as ids of a graph, precede other names."""
    return (len(name) if name.isdecimal() else 99, name)


def _unique(names: tuple[str, ...], key: Callable[[str], str]) -> dict[str, int]:
    keys = [key(name) for name in names]
    counts = Counter(keys)
    return {name: row for row, name in enumerate(keys) if counts[name] == 1}


def _by_time(a: PoseTable, b: PoseTable, tolerance: float) -> Association:
    stamps = _stamps(a, b)
    orders = [np.argsort(one, kind="stable") for one in stamps]
    first, second = (one[order] for one, order in zip(stamps, orders, strict=True))
    forward, back = _nearest(first, second), _nearest(second, first)
    gap = np.abs(first - second[forward])
    mutual = back[forward] == np.arange(len(first))
    chosen = np.flatnonzero(mutual & (gap <= round(1e9 * tolerance)))
    pairs = np.column_stack([orders[0][chosen], orders[1][forward[chosen]]])
    largest = 1e-9 * float(gap[chosen].max()) if len(chosen) else 0.0
    sentence = (
        f"by time, at most {tolerance:g} s apart (the largest difference is {number(largest)} s)"
    )
    return _made(a, b, pairs, "time", sentence)


def _nearest(wanted: Indices, among: Indices) -> Indices:
    after = np.clip(np.searchsorted(among, wanted), 0, len(among) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.abs(wanted - among[before]) <= np.abs(among[after] - wanted)
    found: Indices = np.where(nearer, before, after)
    return found


def _stamps(a: PoseTable, b: PoseTable) -> list[Indices]:
    """Return time stamps in nanoseconds; if a table has none, read them from the names."""
    first, second = a.timestamps_ns, b.timestamps_ns
    if first is None:
        assert second is not None
        first = _stamps_of_names("a", a.names, second)
    return [first, _stamps_of_names("b", b.names, first) if second is None else second]


def _stamps_of_names(argument: str, names: Sequence[str], others: Indices) -> Indices:
    stamps, frames = [], []
    for name in names:
        words = re.findall(r"\d+(?:\.\d+)?", last_part(name))
        stamp = Decimal(words[0]) if len(words) == 1 else LATEST_STAMP
        frames += [name] * (stamp < EARLIEST_CLOCK and "." not in words[0])
        stamp *= 10**9 if stamp < NANOSECONDS else 1
        if stamp >= LATEST_STAMP:
            raise InputError(f"{argument}: {_NO_STAMPS}, found {brief(name)}")
        stamps.append(int(stamp))
    here, there = set(stamps), set(others.tolist())
    if frames and ((others % 10**9).any() or not (here <= there or there <= here)):
        raise InputError(
            f"{argument}: {_NO_STAMPS}, {1e-9 * min(there):.10g} to {1e-9 * max(there):.10g} s, "
            f"found the frame {brief(frames[0])}; a list, name qw qx qy qz tx ty tz, has names"
        )
    return np.array(stamps, np.int64)


def _by_order(a: PoseTable, b: PoseTable) -> Association:
    first, second = _frames(a), _frames(b)
    if first is not None and second is not None and "kitti" in (a.format, b.format):
        _, rows_a, rows_b = np.intersect1d(first, second, assume_unique=True, return_indices=True)
        pairs = np.column_stack([rows_a, rows_b]).astype(np.int64)
        sentence = "by frame number: line k of a KITTI file, from 0, is frame k"
        return _made(a, b, pairs, "frame number", sentence)
    if len(a) != len(b):
        raise InputError(
            f"b: expected {len(a)} poses, as in A, because poses without names and time stamps "
            f"correspond by order, found {len(b)}"
        )
    pairs = np.column_stack([_sorted_rows(a), _sorted_rows(b)])
    return _made(a, b, pairs, "order", "by order, since one input has neither names nor times")


def _frames(table: PoseTable) -> Indices | None:
    if table.format == "kitti":
        return np.arange(len(table))
    words = [re.search(r"(\d{1,18})$", _LEVELS["stem"](name)) for name in table.names]
    if not len(table) or not all(words):
        return None
    frames = np.array([int(word[1]) for word in words if word], np.int64)
    return frames if len(np.unique(frames)) == len(frames) else None


def _sorted_rows(table: PoseTable) -> Indices:
    if table.timestamps_ns is not None:
        return np.argsort(table.timestamps_ns, kind="stable")
    if _is_named(table):
        return np.array(sorted(range(len(table)), key=lambda k: _by_size(table.names[k])), np.int64)
    return np.arange(len(table))


def _made(a: PoseTable, b: PoseTable, pairs: Indices, by: str, sentence: str) -> Association:
    rows_a, rows_b = pairs[:, 0], pairs[:, 1]
    label_a, label_b = _labels(a), _labels(b)
    from_a = _is_named(a) or not (_is_named(b) or b.timestamps_ns is not None)
    names = [label_a[k] for k in rows_a] if from_a else [label_b[k] for k in rows_b]
    taken_a, taken_b = set(rows_a.tolist()), set(rows_b.tolist())
    return Association(
        rows_a=rows_a,
        rows_b=rows_b,
        names=tuple(names),
        only_a=tuple(name for row, name in enumerate(label_a) if row not in taken_a),
        only_b=tuple(name for row, name in enumerate(label_b) if row not in taken_b),
        by=by,
        sentence=sentence,
    )


def _labels(table: PoseTable) -> list[str]:
    if _is_named(table):
        return list(table.names)
    if table.timestamps_ns is not None:
        return [f"{stamp // 10**9}.{stamp % 10**9:09d}" for stamp in table.timestamps_ns.tolist()]
    return [str(row) for row in range(len(table))]


def _too_few(
    a: PoseTable, b: PoseTable, found: Association, named: list[bool], tolerance: float
) -> str:
    by = {"time": "by time", "order": "by order"}.get(found.by, f"with the same {found.by}")
    wanted = f"expected at least {FEWEST} shared poses of A and B {by}"
    count = f"found {len(found)} of {len(a)} and {len(b)}"
    if found.by == "time":
        hint = "" if len(found) else other_unit(*_stamps(a, b))
        return f"b: {wanted} (within {tolerance:g} s), {count}{hint}"
    hint = ""
    if all(named) and not len(found):
        hint = f": A has {brief(min(a.names))}, B has {brief(min(b.names))}"
    return f"b: {wanted}, {count} {noun(len(b), 'pose', 'poses')}{hint}"
