"""How fast a machine does what a step is made of.

Whether measured rates can be those of a machine: physical bounds, and one rate against another.

A calibration subtracts times that another process may have stretched. What then comes out is a
rate of nothing, or one that no processor reaches.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["FactorRate", "Rates", "implausible"]


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
    """Seconds of a step for one of each; entries are those of blocks of 9 camera parameters.

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


# From a slow single board to wide vector units: flops and bytes per second and core.
_FLOPS = (1e7, 5e11)
_BYTES = (1e7, 1e12)

# Seconds for one of each. The lower bounds are a few clock cycles for what takes hundreds.
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
    """Return the names of the rates that cannot be, or cannot be beside the others."""
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
    # More threads make a factorisation neither slower by much nor faster than their number.
    gain = rates.dense_threaded.flops_per_second / rates.dense.flops_per_second
    if not 0.5 <= gain <= 1.5 * rates.num_threads:
        found.append("dense_threaded")
    # Ceres stores and reads the Jacobian that the fused backend keeps in registers.
    if rates.ceres_evaluation + rates.ceres_elimination < 0.3 * rates.fused_observation:
        found.append("ceres_evaluation")
    return tuple(dict.fromkeys(found))
