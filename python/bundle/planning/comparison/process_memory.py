"""Memory of a process, and a limit on it.

The report and the cap count resident memory. The kernel cannot limit it for a single process,
so two mechanisms enforce the cap:

- RLIMIT_DATA, which the process sets after loading its problem. An allocation beyond the cap fails
  before its memory is touched: a dense matrix of 3 GB under a cap of 500 MB is never allocated.
  RLIMIT_AS is unsuitable: it counts libraries, files and reserved address space (64 MiB per malloc
  arena). RLIMIT_DATA still counts stacks and the buffers of OpenBLAS (128 MiB per thread), which
  are reserved in full and touched in part; `_reserve` adds them to the cap, because OpenBLAS blocks
  for ever if it cannot get a buffer.
- The parent, which reads the resident size several times a second and kills a process above the
  cap.

If a process exceeds the cap between two readings and then ends, its peak reveals it.
"""

from __future__ import annotations

import contextlib
import os
import resource
import sys
from pathlib import Path

import bundle._core as _core

_MIB = 2**20
_BLAS_BUFFER = 128 * _MIB
_ARENAS = 64 * _MIB
_SOME_STACK = 8 * _MIB


def available_memory() -> int:
    """Return the free memory of this machine in bytes; 0 if the system does not report it."""
    size = _core.available_memory()
    return int(size) if size < 2**63 else 0


def resident_memory(pid: int | str = "self") -> int:
    """Return the resident bytes of a process; 0 if the system does not report them."""
    return _kibibytes(Path(f"/proc/{pid}/status"), "VmRSS")


def peak_memory() -> int:
    """Return the peak resident size of this process in bytes.

    VmHWM counts this program only; the fallback ru_maxrss includes the parent's size at the fork.
    """
    unit = 1 if sys.platform == "darwin" else 1024
    peak = unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return _kibibytes(Path("/proc/self/status"), "VmHWM") or peak


def restart_peak() -> bool:
    """Reset the peak that `peak_memory` returns; False if the system does not allow it.

    Otherwise a loader's temporary memory would hide the memory of the solver.
    """
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return False
    return True


def limit_growth(size: int, num_threads: int) -> None:
    """Make allocations fail that grow this process by more than `size` bytes from now on."""
    data = _kibibytes(Path("/proc/self/status"), "VmData")
    if not data:
        return
    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    limit = data + size + _reserve(num_threads)
    if most == resource.RLIM_INFINITY or limit < most:
        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))


def go_first_when_memory_ends() -> None:
    """Tell the kernel to kill this process first if the machine runs out of memory."""
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000")


def _reserve(num_threads: int) -> int:
    """Return the number of bytes that threads reserve but do not use: stacks and buffers."""
    stack, _ = resource.getrlimit(resource.RLIMIT_STACK)
    stack = _SOME_STACK if stack == resource.RLIM_INFINITY else stack
    cores = max(num_threads, os.cpu_count() or 1)  # OpenBLAS starts one thread per core
    return (cores + 1) * (stack + _BLAS_BUFFER) + _ARENAS


def _kibibytes(path: Path, field: str) -> int:
    """Return the value of a line "field:   123 kB" in bytes; 0 without such a line."""
    try:
        _, found, rest = path.read_text().partition(f"{field}:")
        return 1024 * int(rest.split(maxsplit=1)[0]) if found else 0
    except (OSError, ValueError, IndexError):
        return 0
