"""Rates of this machine: seconds per unit of a solver's work, fitted to timed solves and cached.

The time of a step is a sum of counts, known before any solve, multiplied by seconds per unit. There
are three tables of such work: of problems (``problem_time``), of pose graphs (``pose_graph_time``)
and of the factor graphs that Ceres solves (``factor_graph_time``). Each table calibrates itself by
small solves of the solver that it predicts: rates include the instruction set, caches, BLAS and
threads of the machine.

With the counts a_ij of solve i and its time t_i, the rates x minimise the squares of the relative
errors, sum_i (sum_j a_ij x_j / t_i - 1)^2, under the condition that no rate is negative: a rate
that the solves cannot separate from others becomes 0, instead of the difference of two large ones.

Other processes distort times. Rates that do not reproduce the times of their solves are therefore
measured again, and never cached. The cache folder has one file per table, version and number of
threads.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import math
import os
import platform
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.paths import cache_folder, write_cached
from bundle.base.records import dataclass
from bundle.planning.inspection.peak_memory import Terms

KERNELS = 4  # number of the generation of kernels; rates of earlier ones are measured anew

ATTEMPTS = 3  # calibrations after which rates that do not fit are used once, without caching them

LARGEST_MISFIT = 0.6
"""Root mean square of the relative errors, above which rates do not fit their solves."""

Work = Mapping[str, Mapping[str, float]]
"""Counts of a step: for each term of its time, the units of each kind of work."""


@dataclass(frozen=True, kw_only=True)
class Rates:
    """Seconds per unit of work on this machine."""

    num_threads: int  # threads of the timed solves
    seconds: Mapping[str, float]  # seconds per unit, by kind of work
    misfit: float = 0.0  # root mean square of the relative errors of the times that they reproduce
    # share of the time saved by ideal threads that those of the machine save
    efficiency: float = 1.0

    def terms(self, work: Work) -> Terms:
        """Return the terms of the time of this work, in seconds."""
        return {
            term: sum(self.seconds[name] * count for name, count in counts.items())
            for term, counts in work.items()
        }


def cached_rates(
    table: str,
    features: Sequence[str],
    num_threads: int,
    calibrate: Callable[[int], Rates],
    *,
    recalibrate: bool = False,
) -> Rates:
    """Return the rates of a table of work, which has these features; measure them unless cached."""
    path = cache_path(table, num_threads)
    rates = None if recalibrate else _read(path, features)
    if rates is None:
        attempts: list[Rates] = []
        while len(attempts) < ATTEMPTS:
            attempts.append(calibrate(num_threads))
            if attempts[-1].misfit <= LARGEST_MISFIT:
                break
        rates = min(attempts, key=lambda rates: rates.misfit)
        if rates.misfit <= LARGEST_MISFIT:
            # If they cannot be cached, the next call measures again.
            with contextlib.suppress(OSError):
                write_cached(path, json.dumps(dataclasses.asdict(rates), indent=2) + "\n")
    return rates


def fitted(
    features: Sequence[str], num_threads: int, solves: Iterable[tuple[Work, float]]
) -> Rates:
    """Return the rates that fit best to the work and the seconds of some solves.

    Solves without a time are left out: no step was whole, or the clock is too coarse for it.
    """
    rows, times = [], []
    for work, time in solves:
        if not 0 < time < math.inf:
            continue
        counts = dict.fromkeys(features, 0.0)
        for name, count in (one for units in work.values() for one in units.items()):
            counts[name] += count
        rows.append(list(counts.values()))
        times.append(time)
    matrix, measured = np.array(rows), np.array(times)
    seconds = fit_rates(matrix, measured)
    errors = matrix @ seconds / measured - 1
    return Rates(
        num_threads=num_threads,
        seconds=dict(zip(features, seconds.tolist(), strict=True)),
        misfit=math.sqrt(np.square(errors).mean()),
    )


Floats = NDArray[np.float64]


def fit_rates(rows: Floats, times: Floats) -> Floats:
    """Return the nonnegative times per feature with the least squares of the relative errors.

    Cyclic coordinate descent: each time in turn takes its best value, at least 0, with all others
    unchanged.
    """
    relative = rows / times[:, None]
    scale = np.linalg.norm(relative, axis=0)
    used = scale > 0
    matrix = relative[:, used] / scale[used]
    found = np.zeros(matrix.shape[1])
    residual = np.ones(len(times))
    for _ in range(20_000):
        change = 0.0
        for k in range(len(found)):
            new = max(0.0, found[k] + float(matrix[:, k] @ residual))
            residual -= (new - found[k]) * matrix[:, k]
            change = max(change, abs(new - found[k]))
            found[k] = new
        if change < 1e-10:
            break
    result = np.zeros(rows.shape[1])
    result[used] = found / scale[used]
    return result


def cache_path(table: str, num_threads: int) -> Path:
    """Return the path of the cached rates of a table of work."""
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
    )
    digest = hashlib.sha256(repr(machine).encode()).hexdigest()[:12]
    return cache_folder() / f"{table}-rates-{digest}-{num_threads}.json"


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


def _read(path: Path, features: Sequence[str]) -> Rates | None:
    """Return the rates of a file; None if it is missing, incomplete or of another version."""
    try:
        rates = Rates(**json.loads(path.read_text(encoding="ascii")))
        numbers = [rates.num_threads, rates.misfit, rates.efficiency, *rates.seconds.values()]
        is_whole = set(rates.seconds) == {*features}
        is_sound = all(math.isfinite(number) and number >= 0 for number in numbers)
    except (OSError, ValueError, TypeError, AttributeError):
        return None
    return rates if is_whole and is_sound and rates.misfit <= LARGEST_MISFIT else None
