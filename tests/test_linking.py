"""Libraries and symbols that the compiled core needs, exports and binds to at load."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

from bundle import _core

LIBRARY = Path(_core.__file__)

# BLAS and LAPACK routines in which CHOLMOD and Ceres spend their time.
ROUTINES = {"dgemm_", "dsyrk_", "dtrsm_", "dpotrf_"}


def run(*command: str, **environment: str) -> str:
    """Return standard output and standard error of a command that must succeed."""
    return subprocess.run(
        command,
        env=os.environ | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=True,
        timeout=120,
    ).stdout


def test_openblas_is_the_first_needed_library() -> None:
    needed = re.findall(
        r"\(NEEDED\).*\[(.*)\]", run("readelf", "--dynamic", "--wide", str(LIBRARY))
    )
    assert needed[0].startswith("libopenblas.so"), needed


def test_blas_binds_to_openblas_in_every_library_that_the_core_loads() -> None:
    # The bare library, without NumPy and others that bring a BLAS of their own; bound at load, not
    # at the first call, so that the loader reports every symbol. RTLD_LOCAL as Python loads it.
    load = f"import ctypes; ctypes.CDLL({str(LIBRARY)!r}, mode=ctypes.RTLD_LOCAL)"
    report = run(sys.executable, "-c", load, LD_DEBUG="bindings", LD_BIND_NOW="1")
    pattern = r"binding file (\S+) \[\d+\] to (\S+) \[\d+\]: normal symbol `(\w+)'"
    bindings = [entry for entry in re.findall(pattern, report) if entry[2] in ROUTINES]
    strays = [entry for entry in bindings if not Path(entry[1]).name.startswith("libopenblas")]
    assert not strays
    from_cholmod = {name for user, _, name in bindings if Path(user).name.startswith("libcholmod")}
    assert from_cholmod == ROUTINES


def test_nothing_but_the_module_is_exported() -> None:
    # So that another Ceres in the process (pycolmap's, pyceres') cannot be mixed with ours.
    symbols = run("nm", "--dynamic", "--defined-only", "--format=posix", str(LIBRARY)).split("\n")
    assert [line.split()[0] for line in symbols if line] == ["PyInit__core"]
