"""What memory a process takes, and a limit to it.

Resident memory is what counts, for the report and for the cap. The kernel has no limit on that for
a single process, so two things hold a run to its cap:

- RLIMIT_DATA, set by the process itself once its problem is loaded. It makes the allocation fail
  that would go beyond the cap, before anything is touched: what asks for 3 GB of a dense matrix
  under a cap of 500 MB never takes them. RLIMIT_AS would not do. It counts libraries, files and
  address space that threads only set aside (64 MiB a malloc arena). RLIMIT_DATA still counts stacks
  and the buffers of OpenBLAS (128 MiB a thread), which are reserved whole and touched in part; they
  come on top of the cap, as `_reserve`. OpenBLAS waits for ever for a buffer that it cannot get.
- The parent, which looks at the resident size several times a second and ends what exceeds the cap.

What still ended, and took more between two looks, is found by its peak.
"""

from __future__ import annotations

import contextlib
import os
import resource
import sys
from pathlib import Path

from bundle import _core

__all__ = [
    "available_memory",
    "go_first_when_memory_ends",
    "limit_growth",
    "peak_memory",
    "resident_memory",
    "restart_peak",
]

_MIB = 2**20
_BLAS_BUFFER = 128 * _MIB
_ARENAS = 64 * _MIB
_SOME_STACK = 8 * _MIB


def available_memory() -> int:
    """Return the bytes that processes may still take on this machine; 0 where it does not tell."""
    size = _core.available_memory()
    return int(size) if size < 2**63 else 0


def resident_memory(pid: int | str = "self") -> int:
    """Return the bytes of a process that are resident; 0 where the system does not tell."""
    return _kibibytes(Path(f"/proc/{pid}/status"), "VmRSS")


def peak_memory() -> int:
    """Return the largest resident size of this process so far, in bytes.

    VmHWM belongs to this program alone; ru_maxrss, the stand-in, also knows the size of the parent
    when it forked.
    """
    unit = 1 if sys.platform == "darwin" else 1024
    peak = unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return _kibibytes(Path("/proc/self/status"), "VmHWM") or peak


def restart_peak() -> bool:
    """Let `peak_memory` count anew; False where that cannot be.

    What a loader needed for a moment would otherwise hide what the solver adds.
    """
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return False
    return True


def limit_growth(size: int, num_threads: int) -> None:
    """Make this process' allocations fail that grow it by more than `size` bytes from here on."""
    data = _kibibytes(Path("/proc/self/status"), "VmData")
    if not data:
        return
    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    limit = data + size + _reserve(num_threads)
    if most == resource.RLIM_INFINITY or limit < most:
        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))


def go_first_when_memory_ends() -> None:
    """Tell the kernel to end this process before any other, should the machine run out."""
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000")


def _reserve(num_threads: int) -> int:
    """Return what threads set aside without touching it: stacks and buffers, the caller's too."""
    stack, _ = resource.getrlimit(resource.RLIMIT_STACK)
    stack = _SOME_STACK if stack == resource.RLIM_INFINITY else stack
    cores = max(num_threads, os.cpu_count() or 1)  # OpenBLAS starts with all of them
    return (cores + 1) * (stack + _BLAS_BUFFER) + _ARENAS


def _kibibytes(path: Path, field: str) -> int:
    """Return the value of a line "field:   123 kB" in bytes; 0 where there is none."""
    try:
        _, found, rest = path.read_text().partition(f"{field}:")
        return 1024 * int(rest.split(maxsplit=1)[0]) if found else 0
    except (OSError, ValueError, IndexError):
        return 0
