"""How fast a machine does what a step is made of."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["FactorRate", "Rates"]


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
