"""How fast this machine does what a step is made of, measured once and kept.

Every rate comes from real solves of small problems by the solver whose steps it predicts, so that
it holds what is particular to the machine: instruction set, caches, BLAS, threads. The shape of a
problem lets one term stand out; what is known already is taken off the rest.

The rates are kept in a file per version and number of threads, in ``bundle`` under XDG_CACHE_HOME,
by default ~/.cache.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import math
import os
import platform
from dataclasses import dataclass
from pathlib import Path

from bundle import _core

__all__ = ["FactorRate", "Rates", "cache_path", "machine_rates"]


@dataclass(frozen=True, kw_only=True)
class FactorRate:
    """A Cholesky factorisation takes flops / flops_per_second + seconds_per_entry * nnz(L)."""

    flops_per_second: float
    seconds_per_entry: float

    def seconds(self, flops: float, nnz: float) -> float:
        """Return the time of one factorisation and its substitutions."""
        return flops / self.flops_per_second + nnz * self.seconds_per_entry


@dataclass(frozen=True, kw_only=True)
class Rates:
    """Seconds of a step for one of each; entries are those of 9 columns on the camera side.

    Attributes:
        num_threads: of the solves that were timed.
        dense: factorisations with one BLAS thread.
        dense_threaded: with ``num_threads``, of 1000 columns and more.
        sparse: supernodal factorisations of panels too narrow for BLAS threads.
        reduced_bytes_per_second: S read by the products of conjugate gradients.
        fused_step: whatever the size: starting threads, the trust region.
        fused_observation: linearised, back-substituted, evaluated.
        fused_pair: two observations of a point: a block product.
        fused_scattered_pair: a pair of images of a chunk, added to an S beyond the caches.
        ceres_step: the same.
        ceres_evaluation: an observation evaluated, and all else outside of the linear solver.
        ceres_elimination: an observation in the elimination and the back-substitution.
        ceres_pair: two blocks that see a point, in kernels of fixed size.
        ceres_dynamic_pair: the same in the kernels of any size.
        ceres_reduced_value: a value of a sparse S, found, converted and copied.
        ceres_product: an observation in an implicit product with S.
        ceres_normal_entry: an entry of the update that a point makes to the whole system's factor.
    """

    num_threads: int
    dense: FactorRate
    dense_threaded: FactorRate
    sparse: FactorRate
    reduced_bytes_per_second: float
    fused_step: float
    fused_observation: float
    fused_pair: float
    fused_scattered_pair: float
    ceres_step: float
    ceres_evaluation: float
    ceres_elimination: float
    ceres_pair: float
    ceres_dynamic_pair: float
    ceres_reduced_value: float
    ceres_product: float
    ceres_normal_entry: float


def machine_rates(num_threads: int, *, recalibrate: bool = False) -> Rates:
    """Return the rates for solves by this many threads, measuring them unless they are kept."""
    path = cache_path(num_threads)
    rates = None if recalibrate else _read(path)
    if rates is None:
        from bundle.inspection.calibrate import calibrate

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
