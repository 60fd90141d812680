"""Rates of the operations of a step on a machine, and bounds of plausible rates.

A calibration subtracts measured times. Load by other processes distorts them, and a difference may
give a rate near zero or one that no processor reaches. Physical bounds and ratios of rates detect
this.

Rates of further work are fitted to the times of solves whose counts of work differ. With the counts
a_ij of solve i and its time t_i, the rates x minimise the squares of the relative errors, sum_i
(sum_j a_ij x_j / t_i - 1)^2, under the condition that no rate is negative: a time that the solves
cannot separate from others becomes 0, instead of the difference of two large ones.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass


@dataclass(frozen=True, kw_only=True)
class FactorRate:
    """Rate of a Cholesky factorisation: flops / flops_per_second + seconds_per_entry * nnz(L)."""

    flops_per_second: float
    seconds_per_entry: float

    def seconds(self, flops: float, nnz: float) -> float:
        """Return the time of one factorisation and its substitutions."""
        return flops / self.flops_per_second + nnz * self.seconds_per_entry


@dataclass(frozen=True, kw_only=True)
class Rates:
    """Seconds per operation of a step, for blocks of 9 camera parameters.

    Attributes:
        num_threads: threads of the timed solves.
        dense: dense factorisations with one BLAS thread.
        dense_threaded: dense factorisations of 1000 or more columns with ``num_threads`` threads.
        sparse: supernodal factorisations of panels too narrow for BLAS threads.
        reduced_bytes_per_second: bytes of S that conjugate gradients read per second.
        fused_step: constant cost of a step: starting threads, the trust region.
        fused_observation: linearise, back-substitute and evaluate an observation.
        fused_pair: block product of two observations of a point.
        fused_scattered_pair: add a pair of images of a chunk to an S larger than the caches.
        ceres_step: constant cost of a step.
        ceres_evaluation: evaluate an observation, and all work outside the linear solver.
        ceres_elimination: eliminate and back-substitute an observation.
        ceres_pair: two blocks that observe a point, in kernels of fixed size.
        ceres_dynamic_pair: the same in kernels of dynamic size.
        ceres_reduced_value: find, convert and copy a value of a sparse S.
        ceres_product: an observation in an implicit product with S.
        ceres_normal_entry: update one entry of the full system's factor to eliminate a point.
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


# Flops and bytes per second and core, from slow single-board computers to wide vector units.
_FLOPS = (1e7, 5e11)
_BYTES = (1e7, 1e12)

# Seconds per operation. The lower bounds are a few clock cycles; the operations take hundreds.
_SECONDS = {
    "fused_step": (1e-7, 1.0),
    "fused_observation": (2e-9, 1e-4),
    "fused_pair": (1e-11, 1e-5),
    "ceres_step": (1e-6, 1.0),
    "ceres_evaluation": (1e-8, 1e-3),
    "ceres_elimination": (1e-9, 1e-3),
    "ceres_pair": (1e-11, 1e-4),
    "ceres_product": (1e-10, 1e-4),
    "ceres_normal_entry": (1e-10, 1e-4),
}


def implausible(rates: Rates) -> tuple[str, ...]:
    """Return the names of rates that are out of bounds or contradict other rates."""
    found = []
    for name, rate in (
        ("dense", rates.dense),
        ("dense_threaded", rates.dense_threaded),
        ("sparse", rates.sparse),
    ):
        cores = rates.num_threads if name == "dense_threaded" else 1
        is_fast_enough = _FLOPS[0] < rate.flops_per_second < cores * _FLOPS[1]
        if not (is_fast_enough and 0 <= rate.seconds_per_entry < 1e-4):
            found.append(name)
    if not _BYTES[0] < rates.reduced_bytes_per_second < _BYTES[1]:
        found.append("reduced_bytes_per_second")
    for name, (low, high) in _SECONDS.items():
        if not low < getattr(rates, name) < high:
            found.append(name)
    # Threads neither slow a factorisation down much nor speed it up by more than their number.
    gain = rates.dense_threaded.flops_per_second / rates.dense.flops_per_second
    if not 0.5 <= gain <= 1.5 * rates.num_threads:
        found.append("dense_threaded")
    # Ceres stores and reads the Jacobian; the fused backend holds it in registers.
    if rates.ceres_evaluation + rates.ceres_elimination < 0.3 * rates.fused_observation:
        found.append("ceres_evaluation")
    return tuple(dict.fromkeys(found))


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
