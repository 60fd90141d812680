"""Check of memory limits before libraries are loaded.

Under `ulimit -v` or `ulimit -d`, OpenBLAS and other libraries abort or hang while they are loaded.
This module imports only the standard library, and only if a limit is set.
"""

from __future__ import annotations

import os
from pathlib import Path

# Measured with 2 cores, plus a margin. LIBRARIES: NumPy, the C++ core, their threads and the first
# matrix product on Debian 13, whose OpenBLAS takes 130 MB more than that of Debian 12. The second
# constant: pycolmap. Each further core adds a stack and an arena of the heap.
LIBRARIES = (620e6, 400e6)
"""Bytes of address space and of data that `import bundle` takes."""

PYCOLMAP = (330e6, 100e6)
"""Bytes of address space and of data that `import pycolmap` takes."""

_PER_CORE = 80e6
_MEASURED_CORES = 2


def require(what: str, sizes: tuple[float, float]) -> None:
    """Raise MemoryError if the limits of this process leave less memory than ``sizes``.

    Args:
        what: library to be loaded next, for the message.
        sizes: bytes of address space and of data that the library takes.
    """
    try:
        import resource
    except ImportError:  # the system has no such limits
        return
    kinds = ((resource.RLIMIT_AS, 0, "ulimit -v"), (resource.RLIMIT_DATA, 5, "ulimit -d"))
    for (kind, field, option), size in zip(kinds, sizes, strict=True):
        limit = resource.getrlimit(kind)[0]
        if limit == resource.RLIM_INFINITY:
            continue
        needed = size + _PER_CORE * max(0, _cores() - _MEASURED_CORES)
        left = limit - _pages(field) * resource.getpagesize()
        if left < needed:
            raise MemoryError(
                f"{what} takes about {needed / 1e6:.0f} MB; the limit ({option}) leaves "
                f"{max(left, 0) / 1e6:.0f} MB"
            )


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1


def _pages(field: int) -> int:
    """Return a field of /proc/self/statm (0: all pages, 5: data and stack); 0 without the file."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[field])
    except OSError:
        return 0
