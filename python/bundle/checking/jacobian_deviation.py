"""Jacobians and their reference, with relative errors that are defined near zero."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

__all__ = ["JacobianDeviation"]

Array = NDArray[np.float64]

FLOOR = 1e-3
"""Share of a column's usual size; smaller columns are measured by the usual size."""


@dataclass(frozen=True, eq=False)
class JacobianDeviation:
    """Jacobians of one residual at K points, each num_residuals x num_columns.

    Attributes:
        analytic: (K, R, N) the Jacobians to check.
        reference: (K, R, N) the second reference.
        uncertainty: (K, R, N) a bound on the reference's own error, infinite where it has no value.
    """

    analytic: Array
    reference: Array
    uncertainty: Array

    @cached_property
    def scale(self) -> Array:
        """(K, 1, N) the size that an entry's error is divided by.

        It is the norm of the entry's column. Where that is unusually small (a point on the axis of
        its camera has no derivative by the distortion) or zero, relative errors mean nothing, and
        the usual size of the column takes its place; where the whole column is zero, that of the
        others.
        """
        norms = np.linalg.norm(np.nan_to_num(self.reference), axis=1, keepdims=True)
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
        """(K, R, N) |analytic - reference| / scale; infinite where the analytic is not finite."""
        with np.errstate(invalid="ignore", over="ignore"):
            deviation = np.abs(self.analytic - self.reference) / self.scale
        deviation = np.where(np.isinf(self.uncertainty), 0.0, deviation)
        return np.where(np.isfinite(self.analytic), deviation, np.inf)

    @cached_property
    def doubt(self) -> Array:
        """(K, R, N) uncertainty / scale."""
        doubt: Array = self.uncertainty / self.scale
        return doubt

    @cached_property
    def error(self) -> Array:
        """(K, R, N) the part of the deviation that the reference's uncertainty does not explain."""
        bad = ~np.isfinite(self.deviation)
        with np.errstate(invalid="ignore"):
            error = np.maximum(self.deviation - self.doubt, 0.0)
        return np.where(bad, np.inf, error)

    def __len__(self) -> int:
        return len(self.analytic)

    def take(self, points: NDArray[np.intp]) -> JacobianDeviation:
        """Return some of the points."""
        return JacobianDeviation(
            self.analytic[points], self.reference[points], self.uncertainty[points]
        )

    @staticmethod
    def join(parts: list[JacobianDeviation]) -> JacobianDeviation:
        """Return the points of all parts."""
        return JacobianDeviation(
            np.concatenate([part.analytic for part in parts]),
            np.concatenate([part.reference for part in parts]),
            np.concatenate([part.uncertainty for part in parts]),
        )
