"""The tests of the core in C++ (tests/cpp), built and run; `make sanitize` runs them too.

What passed there need not be compiled a second time, which takes minutes.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pybind11
import pytest

ROOT = Path(__file__).parents[1]
# Where pip built the module, whose objects are used again.
BUILD = ROOT / "build" / "release"
# `make sanitize` leaves it behind when everything passed.
PASSED = ROOT / "build" / "sanitize" / "passed"


def is_sanitized() -> bool:
    """Return whether all C++ sources are older than a pass under sanitizers."""
    if not PASSED.exists():
        return False
    folders = (ROOT / "cpp", ROOT / "tests" / "cpp", ROOT / "CMakeLists.txt")
    sources = [path for folder in folders for path in (folder, *folder.rglob("*"))]
    return max(path.stat().st_mtime for path in sources) < PASSED.stat().st_mtime


def run(*command: str | Path) -> None:
    """Run a command that finds CMake and Ninja beside this Python; fail with what it prints."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(
        command,
        env=os.environ | {"PATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        timeout=1200,
    )
    assert done.returncode == 0, done.stdout


@pytest.mark.skipif(is_sanitized(), reason="passed under sanitizers: build/sanitize/passed")
def test_cpp() -> None:
    run(
        *("cmake", "-S", ROOT, "-B", BUILD, "-G", "Ninja", "-DBUNDLE_CPP_TESTS=ON"),
        *(f"-DPython_EXECUTABLE={sys.executable}", f"-Dpybind11_DIR={pybind11.get_cmake_dir()}"),
    )
    run("cmake", "--build", BUILD, "--target", "bundle_tests")
    run(BUILD / "tests" / "cpp" / "bundle_tests", "--gtest_brief=1")
