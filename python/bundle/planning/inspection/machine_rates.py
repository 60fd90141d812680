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
from bundle.planning.inspection.calibrate import calibrate
from bundle.planning.inspection.rates import FactorRate, Rates, implausible

__all__ = ["cache_path", "machine_rates"]

ATTEMPTS = 3
"""Calibrations before rates are used that cannot be right, and not kept."""


def machine_rates(num_threads: int, *, recalibrate: bool = False) -> Rates:
    """Return the rates for solves by this many threads, measuring them unless they are kept."""
    path = cache_path(num_threads)
    rates = None if recalibrate else _read(path)
    if rates is None:
        rates = _measure(num_threads)
        if implausible(rates):  # good enough for this once
            return rates
        with contextlib.suppress(OSError):  # without a place to keep them they are measured again
            _write(path, rates)
    return rates


def _measure(num_threads: int) -> Rates:
    """Calibrate until the rates are plausible; return the least implausible of ATTEMPTS."""
    attempts: list[Rates] = []
    while len(attempts) < ATTEMPTS:
        attempts.append(calibrate(num_threads))
        if not implausible(attempts[-1]):
            return attempts[-1]
    return min(attempts, key=lambda rates: len(implausible(rates)))


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
        _blas(),
        os.environ.get("BUNDLE_INSTRUCTION_SET", ""),
        _core.hardware_threads(),
        [field.name for field in dataclasses.fields(Rates)],
    )
    digest = hashlib.sha256(repr(machine).encode()).hexdigest()[:12]
    return base / "bundle" / f"rates-{digest}-{num_threads}.json"


def _processor() -> tuple[str, ...]:
    """Return the model and its instruction sets, of which a virtual machine may hide some."""
    try:
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
    except OSError:
        return (platform.processor(),)
    heads = ("model name", "flags", "Features")
    return tuple(next((line for line in lines if line.startswith(head)), "") for head in heads)


def _blas() -> tuple[str, ...]:
    """Return the BLAS libraries that are loaded, with sizes and dates, and what selects kernels."""
    choice = os.environ.get("OPENBLAS_CORETYPE", "")
    try:
        maps = Path("/proc/self/maps").read_text(errors="replace").splitlines()
    except OSError:
        return (choice,)
    found = set()
    for path in {line.split(maxsplit=5)[5] for line in maps if len(line.split(maxsplit=5)) == 6}:
        if "blas" in Path(path).name.lower():
            with contextlib.suppress(OSError):
                status = Path(path).stat()
                found.add(f"{path} {status.st_size} {int(status.st_mtime)}")
    return (choice, *sorted(found))


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
    return rates if sound and not implausible(rates) else None


def _write(path: Path, rates: Rates) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{path.name}.{os.getpid()}")
    partial.write_text(json.dumps(dataclasses.asdict(rates), indent=2) + "\n", encoding="ascii")
    partial.replace(path)
