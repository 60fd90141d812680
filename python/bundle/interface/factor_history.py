"""Record of the cheapest factor of each structure that this user has solved.

The file ``factors-VERSION.json`` in the cache folder has one entry per structure: a checksum of who
is coupled with whom, the size of the matrix and the solver. An entry holds flops, nnz(L) and the
ordering, no path and no measurement. The checksum and nnz(Lambda) are equal only for the same
matrix: more flops than recorded are due to the ordering, not to the size.

Only solves of some tenths of a second read and write the file. It keeps the last MOST_ENTRIES
structures. Its first line is the checksum of the second: a file that was edited counts as empty, as
one that cannot be read or written.
"""

from __future__ import annotations

import contextlib
import json
import zlib
from pathlib import Path

from bundle._core import __version__
from bundle.base.cache_folder import cache_folder, write_cached
from bundle.base.records import dataclass

MOST_ENTRIES = 200


@dataclass(frozen=True)
class PastFactor:
    """Cost of the factor of an earlier solve."""

    flops: float
    nonzeros: float
    ordering: str


def history_path() -> Path:
    """Return the path of the record."""
    return cache_folder() / f"factors-{__version__}.json"


def recall(structure: str, now: PastFactor) -> PastFactor | None:
    """Return the cheapest earlier factor of a structure, or None; record the present one.

    Args:
        structure: checksum of the matrix and name of its solver.
        now: factor of this solve.
    """
    try:
        path = history_path()
        entries = _read(path)
    except (OSError, RuntimeError):  # no home folder
        return None
    past = entries.pop(structure, None)
    entries[structure] = now if past is None or now.flops < past.flops else past
    kept = list(entries.items())[-MOST_ENTRIES:]
    with contextlib.suppress(OSError):
        text = json.dumps({key: [one.flops, one.nonzeros, one.ordering] for key, one in kept})
        write_cached(path, f"{_checksum(text)}\n{text}\n")
    return past


def _read(path: Path) -> dict[str, PastFactor]:
    """Return the entries in order of their last use; empty if the file is missing or damaged."""
    try:
        checksum, text = path.read_text(encoding="ascii").splitlines()
    except (OSError, ValueError):  # not two lines of ASCII
        return {}
    if checksum != _checksum(text):
        return {}
    return {key: PastFactor(*values) for key, values in json.loads(text).items()}


def _checksum(text: str) -> str:
    return f"{zlib.crc32(text.encode()):08x}"
