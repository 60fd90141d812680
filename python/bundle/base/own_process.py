"""Resources of this process: threads of OpenBLAS, memory limits, Ctrl-C, messages to the log."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

from bundle.base.records import dataclass

# Threads of the two OpenBLAS libraries of a process: idle ones sleep at once.
#
# NumPy brings one OpenBLAS, the core is linked to another. Each starts its threads when it is
# loaded. An idle thread spins for 2^26 cycles before it sleeps, which takes 40 ms of processor time
# in NumPy and 100 ms in Debian's OpenBLAS 0.3.21: more than a small refinement, whose own threads
# then share the processor with idle ones. Two variables, which OpenBLAS reads only while it is
# loaded, prevent that:
#
# - ``OPENBLAS_THREAD_TIMEOUT=20``: an idle thread sleeps after 2^20 cycles, less than a
#   millisecond. A parallel Cholesky factorisation of 600 to 2500 columns takes the same time with
#   14 to 26, but 1.5 times as long with 4. The first use of a public name of the package sets it
#   for the libraries that are not loaded yet.
# - ``OPENBLAS_NUM_THREADS=1`` for NumPy's, only in a process of the command line, where NumPy's
#   matrices are small: ``--threads`` then bounds all threads. The core's OpenBLAS keeps its threads
#   and gets a number from each solver.
#
# Variables of the user have priority. The environment is restored at once: child processes, and
# libraries that are loaded later, find it unchanged.

SLEEP = {"OPENBLAS_THREAD_TIMEOUT": "20"}
SLEEP_BY_USER = ("OPENBLAS_THREAD_TIMEOUT", "GOTO_THREAD_TIMEOUT")
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1"}
NUMBER_BY_USER = ("OPENBLAS_NUM_THREADS", "GOTO_NUM_THREADS", "OMP_NUM_THREADS")
"""Variables that OpenBLAS reads, the first that is set."""

_is_ours = False


def load_core() -> None:
    """Load the core; call first in a process of the command line."""
    global _is_ours
    _is_ours = True
    _load("bundle._core", _unless_set(SLEEP, SLEEP_BY_USER))


def load_numpy() -> None:
    """Load NumPy if this is a process of the command line."""
    if _is_ours:
        sleep = _unless_set(SLEEP, SLEEP_BY_USER)
        _load("numpy", {**sleep, **_unless_set(ONE_THREAD, NUMBER_BY_USER)})


def load_libraries() -> None:
    """Load NumPy and the core in a process of the user."""
    for module in ("numpy", "bundle._core"):
        _load(module, _unless_set(SLEEP, SLEEP_BY_USER))


def _unless_set(variables: Mapping[str, str], by_user: tuple[str, ...]) -> Mapping[str, str]:
    # OpenBLAS takes 0 for unset.
    is_set = any(os.environ.get(name, "").strip() not in ("", "0") for name in by_user)
    return {} if is_set else variables


def _load(module: str, variables: Mapping[str, str]) -> None:
    """Import a module, if it is not loaded yet, while the environment has the variables."""
    if module in sys.modules:
        return
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        __import__(module)
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


# Check of memory limits before libraries are loaded.
#
# Under `ulimit -v` or `ulimit -d`, OpenBLAS and other libraries abort or hang while they are
# loaded. This module imports only the standard library, and only if a limit is set.

# Measured with 2 cores, plus a margin. LIBRARIES: NumPy, the C++ core, their threads and the first
# matrix product on Debian 13, whose OpenBLAS takes 130 MB more than that of Debian 12. The second
# constant: pycolmap. Each further core adds a stack and an arena of the heap.
LIBRARIES = (620e6, 400e6)  # bytes of address space and of data that `import bundle` takes

PYCOLMAP = (330e6, 100e6)  # bytes of address space and of data that `import pycolmap` takes

_PER_CORE = 80e6
_MEASURED_CORES = 2


def require_memory(what: str, sizes: tuple[float, float]) -> None:
    """Raise MemoryError if the limits of this process leave less memory than ``sizes``.

    ``sizes``: bytes of address space and of data that the library takes.
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


# Deferral of Ctrl-C during short critical blocks.
#
# Three kinds of blocks must not be interrupted:
#
# * renames of files that belong together: the folder would contain a mixture of two models;
# * the import of pycolmap, which fails after an interruption;
# * the start of a process with its files: files that an interrupted constructor opened stay open.


@contextmanager
def interrupts_deferred() -> Iterator[None]:
    """Defer SIGINT until the block has ended; an exception of the block takes precedence.

    Use this only for blocks that take milliseconds. In threads other than the main thread it has no
    effect, because Python runs signal handlers in the main thread. A handler that is not a function
    (SIG_IGN, SIG_DFL) stays.

    Example:
        >>> with interrupts_deferred():
        ...     old.rename(backup)
        ...     new.rename(old)
    """
    handler = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(handler):
        yield
        return
    arrived: list[tuple[int, FrameType | None]] = []
    signal.signal(signal.SIGINT, lambda number, frame: arrived.append((number, frame)))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
    if arrived:
        handler(*arrived[0])


# Messages to the logger "bundle" of the standard library's logging.
#
# A program shows them with its own handlers::
#
#     import logging
#     logging.basicConfig(level=logging.INFO)
#
# Levels: DEBUG for each iteration, INFO for the start and the end of a solve, WARNING for warnings.
# The command line shows the same information in its own way and logs nothing.
#
# Importing logging is slow. A program that has not imported it has no handler, so that no message
# can be shown: then nothing is logged.

NAME = "bundle"
LEVELS = {"debug": 10, "info": 20, "warning": 30}  # levels of logging by name


def log(level: str, message: str, *values: object) -> None:
    """Log a message with values in the style of logging, such as ``log("info", "%d steps", 3)``.

    A value that is slow to make can be a function, which is called if a handler shows the message.
    """
    logger = _logger()
    if logger is not None and logger.isEnabledFor(LEVELS[level]):
        shown = (value() if callable(value) else value for value in values)
        logger.log(LEVELS[level], message, *shown)


def logged_iterations(
    progress: Callable[[dict[str, Any]], None] | None,
) -> Callable[[dict[str, Any]], None] | None:
    """Return a progress function that also logs each iteration; the same one if nobody listens."""
    logger = _logger()
    if logger is None or not logger.isEnabledFor(LEVELS["debug"]):
        return progress

    def step(iteration: Mapping[str, Any]) -> None:
        log("debug", "iteration %d: cost %.9e", iteration["iteration"], iteration["cost"])
        if progress is not None:
            progress(dict(iteration))

    return step


def _logger() -> Any:
    """Return the logger; None if the program has not imported logging."""
    logging = sys.modules.get("logging")
    if logging is None:
        return None
    logger = logging.getLogger(NAME)
    if not logger.handlers:
        logger.addHandler(logging.NullHandler())  # no output without the program's handlers
    return logger


# Time in which this process was ready to run and had no core, because others used it.
#
# Linux counts it for the calling thread (/proc/self/schedstat). Threads that have ended are not in
# it, but their involuntary context switches are in the process's: each costs about a time slice.


@dataclass(frozen=True)
class Waiting:
    """Time that this process waited for a core, so far or in an interval."""

    waiting: float  # seconds of the calling thread; 0 if the system does not report it
    preemptions: int  # involuntary context switches of all threads

    @staticmethod
    def now() -> Waiting:
        """Return the time waited since the start of the process."""
        try:
            text = Path("/proc/self/schedstat").read_text(encoding="ascii")
            seconds = 1e-9 * float(text.split()[1])
        except (OSError, ValueError, IndexError):
            seconds = 0.0
        import resource  # not on every system

        return Waiting(seconds, resource.getrusage(resource.RUSAGE_SELF).ru_nivcsw)


def waiting_since(before: Waiting) -> Waiting:
    """Return the time waited since an earlier value."""
    now = Waiting.now()
    return Waiting(
        max(now.waiting - before.waiting, 0.0), max(now.preemptions - before.preemptions, 0)
    )
