"""Rates of this machine, measured once and cached.

Each rate is measured on real solves of small problems by the solver that it predicts. It therefore
includes the instruction set, caches, BLAS and threads of the machine (``calibrate``;
``graph_rates`` for pose graphs, ``factor_graph_time`` for other factor graphs).

The cache folder has one file per version and number of threads.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import math
import os
import platform
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import bundle._core as _core
from bundle.base.cache_folder import cache_folder, write_cached
from bundle.planning.inspection.calibrate import calibrate
from bundle.planning.inspection.factor_graph_time import FEATURES as FACTOR_GRAPH_FEATURES
from bundle.planning.inspection.factor_graph_time import calibrate_factor_graphs
from bundle.planning.inspection.graph_rates import FEATURES, GraphRates, calibrate_graphs
from bundle.planning.inspection.rates import FactorRate, Rates, implausible

RATE_NAMES = tuple(field.name for field in dataclasses.fields(Rates))

KERNELS = 4
"""Number of the generation of kernels; rates of earlier ones are measured anew."""

ATTEMPTS = 3
"""Number of calibrations after which implausible rates are used once, without caching them."""


def machine_rates(num_threads: int, *, recalibrate: bool = False) -> Rates:
    """Return the rates for solves on ``num_threads`` threads; measure them unless cached."""
    path = cache_path(num_threads)
    rates = None if recalibrate else _read(path)
    if rates is None:
        rates = _measure(num_threads)
        if implausible(rates):  # used once, not cached
            return rates
        with contextlib.suppress(OSError):  # if they cannot be cached, the next call measures again
            _write(path, dataclasses.asdict(rates))
    return rates


def graph_rates(num_threads: int, *, recalibrate: bool = False) -> GraphRates:
    """Return the rates of pose graphs on ``num_threads`` threads; measure them unless cached."""

    def measure() -> dict[str, Any]:
        found = calibrate_graphs(num_threads)
        return {"seconds": dict(found.seconds), "efficiency": found.efficiency}

    path = cache_path(num_threads, "graph-rates", FEATURES)
    return GraphRates(num_threads=num_threads, **_fitted(path, FEATURES, measure, recalibrate))


def factor_graph_rates(*, recalibrate: bool = False) -> dict[str, float]:
    """Return the rates of factor graphs that Ceres solves; measure them unless cached."""
    path = cache_path(1, "factor-graph-rates", FACTOR_GRAPH_FEATURES)

    def measure() -> dict[str, Any]:
        return {"seconds": calibrate_factor_graphs(), "efficiency": 1.0}

    return dict(_fitted(path, FACTOR_GRAPH_FEATURES, measure, recalibrate)["seconds"])


def _fitted(
    path: Path, names: Sequence[str], measure: Callable[[], dict[str, Any]], recalibrate: bool
) -> dict[str, Any]:
    """Return seconds per unit of these names and the efficiency of threads, cached in a file."""
    try:
        given = {} if recalibrate else json.loads(path.read_text(encoding="ascii"))
        numbers = [given["efficiency"], *given["seconds"].values()]
        is_complete = set(given) == {"seconds", "efficiency"} and set(given["seconds"]) == {*names}
        if is_complete and all(map(math.isfinite, numbers)):
            return given
    except (OSError, ValueError, TypeError, KeyError):
        pass
    found = measure()
    with contextlib.suppress(OSError):
        _write(path, found)
    return found


def _measure(num_threads: int) -> Rates:
    """Calibrate until the rates are plausible; return the least implausible of ATTEMPTS."""
    attempts: list[Rates] = []
    while len(attempts) < ATTEMPTS:
        attempts.append(calibrate(num_threads))
        if not implausible(attempts[-1]):
            return attempts[-1]
    return min(attempts, key=lambda rates: len(implausible(rates)))


def cache_path(num_threads: int, kind: str = "rates", names: Sequence[str] = RATE_NAMES) -> Path:
    """Return the path of the cached rates of a kind, which have these names."""
    # Machines may share a home folder, and one processor may offer several instruction sets.
    machine = (
        _core.__version__,
        KERNELS,
        _core.CERES_VERSION,
        platform.node(),
        platform.machine(),
        _processor(),
        _blas(),
        os.environ.get("BUNDLE_INSTRUCTION_SET", ""),
        _core.hardware_threads(),
        list(names),
    )
    digest = hashlib.sha256(repr(machine).encode()).hexdigest()[:12]
    return cache_folder() / f"{kind}-{digest}-{num_threads}.json"


def _processor() -> tuple[str, ...]:
    """Return the processor model and the instruction sets that this (virtual) machine offers."""
    try:
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
    except OSError:
        return (platform.processor(),)
    heads = ("model name", "flags", "Features")
    return tuple(next((line for line in lines if line.startswith(head)), "") for head in heads)


def _blas() -> tuple[str, ...]:
    """Return the loaded BLAS libraries with sizes and dates, and the choice of their kernels."""
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
    """Return the rates of a file; None if it is missing, incomplete or of another version."""
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


def _write(path: Path, rates: dict[str, Any]) -> None:
    write_cached(path, json.dumps(rates, indent=2) + "\n")
