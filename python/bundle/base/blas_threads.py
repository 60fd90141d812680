"""Threads of the two OpenBLAS libraries of a process: idle ones sleep at once.

NumPy brings one OpenBLAS, the core is linked to another. Each starts its threads when it is loaded.
An idle thread spins for 2^26 cycles before it sleeps, which takes 40 ms of processor time in NumPy
and 100 ms in Debian's OpenBLAS 0.3.21: more than a small refinement, whose own threads then share
the processor with idle ones. Two variables, which OpenBLAS reads only while it is loaded, prevent
that:

- ``OPENBLAS_THREAD_TIMEOUT=20``: an idle thread sleeps after 2^20 cycles, less than a millisecond.
  A parallel Cholesky factorisation of 600 to 2500 columns takes the same time with 14 to 26, but
  1.5 times as long with 4. The first use of a public name of the package sets it for the libraries
  that are not loaded yet.
- ``OPENBLAS_NUM_THREADS=1`` for NumPy's, only in a process of the command line, where NumPy's
  matrices are small: ``--threads`` then bounds all threads. The core's OpenBLAS keeps its threads
  and gets a number from each solver.

Variables of the user have priority. The environment is restored at once: child processes, and
libraries that are loaded later, find it unchanged.
"""

from __future__ import annotations

import os
import sys

TYPE_CHECKING = False  # as in typing, but without its slow import
if TYPE_CHECKING:
    from collections.abc import Mapping

SLEEP = {"OPENBLAS_THREAD_TIMEOUT": "20"}
SLEEP_BY_USER = ("OPENBLAS_THREAD_TIMEOUT", "GOTO_THREAD_TIMEOUT")
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1"}
NUMBER_BY_USER = ("OPENBLAS_NUM_THREADS", "GOTO_NUM_THREADS", "OMP_NUM_THREADS")
"""Variables that OpenBLAS reads, the first that is set."""

_is_ours = False


def begin() -> None:
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
