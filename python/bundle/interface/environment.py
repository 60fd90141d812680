"""Machine and software of a measurement: date, processor, load, versions."""

from __future__ import annotations

import ctypes
import datetime
import math
import os
import platform
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.base.words import plural


@dataclass(frozen=True, kw_only=True)
class Environment:
    """Conditions under which times were measured."""

    date: str  # start in UTC, in ISO 8601
    cpu_model: str  # processor model as the kernel names it
    num_cores: int  # cores that this process may use
    load_before: float  # load average of the last minute before the measurement; NaN if unknown
    load_after: float  # load average of the last minute after it, which includes the measurement
    versions: Mapping[str, str]  # version of "bundle", "ceres", "blas", "python", "numpy" and "os"

    @staticmethod
    def now() -> Environment:
        """Return the conditions at the start of a measurement."""
        return Environment(
            date=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            cpu_model=cpu_model(),
            num_cores=_core.hardware_threads(),
            load_before=load_average(),
            load_after=math.nan,
            versions={
                "bundle": _core.__version__,
                "ceres": _core.CERES_VERSION,
                "blas": _blas_version(),
                "python": platform.python_version(),
                "numpy": np.__version__,
                "os": _system(),
            },
        )

    def finished(self) -> Environment:
        """Return the conditions with the load at the end."""
        return replace(self, load_after=load_average())

    @property
    def sentence(self) -> str:
        """Date, machine, load and versions in words."""
        versions = ", ".join(f"{name} {one}" for name, one in self.versions.items() if one)
        return (
            f"Measured {self.date} on {self.cpu_model}, {plural(self.num_cores, 'core')}, load "
            f"{self.load_before:.1f} before and {self.load_after:.1f} after. {versions}."
        )

    def is_busy(self, num_threads: int) -> bool:
        """Return True if other work left too few cores for solves on this number of threads."""
        return self.load_before + num_threads > self.num_cores + 0.5


def load_average() -> float:
    """Return the load average of the last minute; NaN if the system does not report it."""
    try:
        return os.getloadavg()[0]
    except (AttributeError, OSError):
        return math.nan


def cpu_model() -> str:
    """Return the processor model as the kernel names it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
    except OSError:
        lines = []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _system() -> str:
    """Return system, release, machine and C library; platform.platform() would start a process."""
    parts = [platform.system(), platform.release(), platform.machine()]
    library = "".join(platform.libc_ver())
    return "-".join([*parts, *(["with", library] if library else [])])


def _blas_version() -> str:
    """Return the build of the OpenBLAS that the core uses, such as "OpenBLAS 0.3.21 ..."."""
    try:
        maps = Path("/proc/self/maps").read_text(errors="replace").splitlines()
    except OSError:
        return ""
    paths = {line.split(maxsplit=5)[5] for line in maps if "openblas" in line.lower()}
    for path in sorted(path for path in paths if "openblas" in Path(path).name.lower()):
        try:
            describe = ctypes.CDLL(path).openblas_get_config
        except (OSError, AttributeError):
            continue  # NumPy's own copy has other names of functions
        describe.restype = ctypes.c_char_p
        return " ".join(describe().decode(errors="replace").split())
    return ""
