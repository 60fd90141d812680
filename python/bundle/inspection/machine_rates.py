"""The rates of this machine, measured once and kept.

Every rate comes from real solves of small problems by the solver whose steps it predicts, so that
it holds what is particular to the machine: instruction set, caches, BLAS, threads (``calibrate``).

They are kept in a file per version and number of threads, in ``bundle`` under XDG_CACHE_HOME, by
default ~/.cache.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import math
import os
import platform
from pathlib import Path

from bundle import _core
from bundle.inspection.calibrate import calibrate
from bundle.inspection.rates import FactorRate, Rates

__all__ = ["cache_path", "machine_rates"]


def machine_rates(num_threads: int, *, recalibrate: bool = False) -> Rates:
    """Return the rates for solves by this many threads, measuring them unless they are kept."""
    path = cache_path(num_threads)
    rates = None if recalibrate else _read(path)
    if rates is None:
        rates = calibrate(num_threads)
        with contextlib.suppress(OSError):  # without a place to keep them they are measured again
            _write(path, rates)
    return rates


def cache_path(num_threads: int) -> Path:
    """Return where the rates are kept."""
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if not base.is_absolute():  # as the XDG specification has it
        base = Path.home() / ".cache"
    # A home folder may be shared by machines, and a processor run several instruction sets.
    machine = (
        _core.__version__,
        _core.CERES_VERSION,
        platform.node(),
        platform.machine(),
        _processor(),
        os.environ.get("BUNDLE_INSTRUCTION_SET", ""),
        _core.hardware_threads(),
        [field.name for field in dataclasses.fields(Rates)],
    )
    digest = hashlib.sha256(repr(machine).encode()).hexdigest()[:12]
    return base / "bundle" / f"rates-{digest}-{num_threads}.json"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
    except OSError:
        return platform.processor()
    return next((line for line in lines if line.startswith("model name")), "")


def _read(path: Path) -> Rates | None:
    """Return the rates of a file, None if there are none: absent, cut off, of another version."""
    try:
        fields = json.loads(path.read_text(encoding="ascii"))
        for name in ("dense", "dense_threaded", "sparse"):
            fields[name] = FactorRate(**fields[name])
        rates = Rates(**fields)
        numbers = [
            number
            for value in dataclasses.asdict(rates).values()
            for number in (value.values() if isinstance(value, dict) else (value,))
        ]
        sound = all(math.isfinite(number) and number >= 0 for number in numbers)
    except (OSError, ValueError, TypeError, KeyError):
        return None
    return rates if sound else None


def _write(path: Path, rates: Rates) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{path.name}.{os.getpid()}")
    partial.write_text(json.dumps(dataclasses.asdict(rates), indent=2) + "\n", encoding="ascii")
    partial.replace(path)
