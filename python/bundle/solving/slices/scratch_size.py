"""Size of the files of a refinement whose observations and points are on disk."""

from __future__ import annotations

from bundle.base.words import format_size
from bundle.errors import InputError, shown

RESIDENT_BYTES = 1 << 30  # bytes of the files in memory at a time


def scratch_bytes(num_observations: int, num_points: int) -> float:
    """Return the bytes on disk during a solve with tracks of one length.

    For each observation, the files hold its pixels and its image twice, its point, and its places
    in chunk and tile. For each point: the input, two states, scales and places. For each pair of
    observations of a point: 4 bytes (cpp/core/schur/elimination_plan.h).
    """
    length = num_observations / max(num_points, 1)
    pairs = 4 * max(length - 1, 0) / 2
    return num_observations * (50 + 1.1 * pairs) + num_points * 132


def refuse_small_disk(folder: str, num_observations: int, num_points: int) -> None:
    """Raise an InputError if the files cannot fit."""
    import shutil  # late: it loads three compressors

    needed = scratch_bytes(num_observations, num_points)
    free = shutil.disk_usage(folder).free
    if needed > free:
        raise InputError(
            f"--out-of-core: expected {format_size(needed)} of free disk for {num_observations} "
            f"observations and {num_points} points, found {format_size(free)} in {shown(folder)}"
        )
