"""Jacobians with their reference, and relative errors that are safe near zero."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

__all__ = ["JacobianDeviation"]

Array = NDArray[np.float64]

FLOOR = 1e-3
"""Smallest divisor of errors, as a fraction of the column's usual size."""


@dataclass(frozen=True, eq=False)
class JacobianDeviation:
    """Jacobians of one residual at K points, each num_residuals x num_columns.

    Attributes:
        analytic: (K, R, N) Jacobians to check.
        reference: (K, R, N) second reference.
        uncertainty: (K, R, N) bound on the reference's own error, infinite without a value.
    """

    analytic: Array
    reference: Array
    uncertainty: Array

    @cached_property
    def scale(self) -> Array:
        """Divisor of the error of each entry, (K, 1, N).

        The divisor is the norm of the entry's column. If this norm is zero or unusually small,
        relative errors are meaningless. For example, the derivative by the distortion is zero for a
        point on the camera's axis. The divisor is then FLOOR times the column's usual size over all
        points. If the column is zero at all points, the divisor is the usual size of the other
        columns.
        """
        reference = np.nan_to_num(self.reference)
        size = np.abs(reference).max(axis=1, keepdims=True, initial=np.finfo(float).tiny)
        norms = size * np.linalg.norm(reference / size, axis=1, keepdims=True)  # no overflow
        nonzero = np.where(norms > 0, norms, np.nan)
        usual = np.ones(norms.shape[2])
        has_any = (norms > 0).any(axis=(0, 1))
        if has_any.any():
            usual[has_any] = np.nanmedian(nonzero[..., has_any], axis=(0, 1))
            usual[~has_any] = np.median(usual[has_any])
        scale: Array = np.maximum(norms, np.where(has_any, FLOOR, 1.0) * usual)
        return scale

    @cached_property
    def deviation(self) -> Array:
        """Deviation |analytic - reference| / scale, (K, R, N).

        Infinite if the analytic value is not finite.
        """
        with np.errstate(invalid="ignore", over="ignore"):
            deviation = np.abs(self.analytic - self.reference) / self.scale
        deviation = np.where(np.isinf(self.uncertainty), 0.0, deviation)
        return np.where(np.isfinite(self.analytic), deviation, np.inf)

    @cached_property
    def doubt(self) -> Array:
        """Relative uncertainty of the reference, (K, R, N): uncertainty / scale."""
        doubt: Array = self.uncertainty / self.scale
        return doubt

    @cached_property
    def error(self) -> Array:
        """Part of the deviation that exceeds the reference's uncertainty, (K, R, N)."""
        bad = ~np.isfinite(self.deviation)
        with np.errstate(invalid="ignore"):
            error = np.maximum(self.deviation - self.doubt, 0.0)
        return np.where(bad, np.inf, error)

    def __len__(self) -> int:
        return len(self.analytic)

    def take(self, points: NDArray[np.intp]) -> JacobianDeviation:
        """Return the deviation at some of the points."""
        return JacobianDeviation(
            self.analytic[points], self.reference[points], self.uncertainty[points]
        )

    @staticmethod
    def join(parts: list[JacobianDeviation]) -> JacobianDeviation:
        """Return the concatenated points of all parts."""
        return JacobianDeviation(
            np.concatenate([part.analytic for part in parts]),
            np.concatenate([part.reference for part in parts]),
            np.concatenate([part.uncertainty for part in parts]),
        )
