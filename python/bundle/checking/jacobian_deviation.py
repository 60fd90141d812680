"""Jacobians with their reference, and relative errors in the units of each row.

An entry A_ij of a Jacobian, with the reference R_ij and the bound U_ij on its error, is wrong if

    |A_ij - R_ij| > U_ij + t s_ij,        s_ij = min(c_j, max(u_i d_j, U_ij / t)),

with the tolerance t. c_j is the norm of column j. A comparison with c_j alone would hide all
mistakes in a row of small numbers, such as radians beside pixels, or a residual of small weight. So
each row has a unit u_i <= 1, and d_j is the norm of column j after division of each row by its
unit:

- Sizes of rows and columns are those that fit the entries best, log |R_ij| ~ a_i + b_j in least
  squares over the known entries other than zero (A. R. Curtis, J. K. Reid: On the automatic scaling
  of matrices for Gaussian elimination, J. Inst. Maths Applics 10, 1972). Any units of residuals
  and of parameters are recovered from a connected pattern of entries.
- Rows whose size is at least 1 / ALIKE of the largest have the unit 1. Below, u_i is ALIKE times
  their size. A mistake is then found if it is larger than ALIKE t = 1e-4 of its row.

No entry is judged more exactly than its numerical derivative: U_ij holds the rounding of the row's
own values and the truncation of the differences. Where u_i d_j is below U_ij / t, a deviation up to
2 U_ij is right. s_ij is at most c_j, so a row that is zero, constant or noise has the unit 1, and
its uncertainty is relative to c_j.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.interface.analysis_options import TOLERANCE

Array = NDArray[np.float64]

CHECKER_PRECISION = 1e-6
"""Relative precision for ceres::GradientChecker, whose differences are not always more precise."""
FLOOR = 1e-3  # smallest divisor of errors, as a fraction of the column's usual size
ALIKE = 1e3  # ratio of the sizes of rows up to which they share a unit
CLEAR = 8  # multiple of its uncertainty above which an entry determines the size of its row
SWEEPS = 50  # largest number of sweeps of the fit of sizes; one is exact if all entries are known
SETTLED = 0.1  # change of the logarithms of sizes in a sweep below which the fit ends


@dataclass(frozen=True, eq=False)
class JacobianDeviation:
    """Jacobians of one residual at K points, each num_residuals x num_columns."""

    analytic: Array  # (K, R, N) Jacobians to check
    reference: Array  # (K, R, N) second reference
    uncertainty: Array  # (K, R, N) bound on the reference's own error, infinite without a value
    tolerance: float = TOLERANCE  # relative error above which an entry is wrong

    @cached_property
    def scale(self) -> Array:
        """Divisor of the error of each entry, (K, R, N)."""
        by_column = np.broadcast_to(_column_sizes(self.reference), self.reference.shape)
        units = _row_units(self.reference, self.uncertainty)
        if (units == 1).all():
            return np.array(by_column)
        in_units = units * _column_sizes(self.reference / units)
        known = np.maximum(in_units, self.uncertainty / self.tolerance)
        return np.asarray(np.minimum(by_column, known), np.float64)

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
        with np.errstate(over="ignore"):
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
            self.analytic[points], self.reference[points], self.uncertainty[points], self.tolerance
        )

    @staticmethod
    def join(parts: list[JacobianDeviation]) -> JacobianDeviation:
        """Return the concatenated points of all parts, which have one tolerance."""
        return JacobianDeviation(
            np.concatenate([part.analytic for part in parts]),
            np.concatenate([part.reference for part in parts]),
            np.concatenate([part.uncertainty for part in parts]),
            parts[0].tolerance,
        )


def norm(values: Array) -> float:
    """Return the norm of all values, without overflow of their squares."""
    size = float(np.abs(values).max(initial=0.0))
    return size * float(np.linalg.norm(values / size)) if 0 < size < np.inf else size


def _column_sizes(matrices: Array) -> Array:
    """Return the divisor of the errors of each column, (K, 1, N).

    The divisor is the norm of the column. If this norm is zero or unusually small, relative errors
    are meaningless. For example, the derivative w.r.t. the distortion is zero for a point on the
    camera's axis. The divisor is then FLOOR times the column's usual size over all points. If the
    column is zero at all points, the divisor is the usual size of the other columns.
    """
    reference = np.nan_to_num(matrices)
    size = np.abs(reference).max(axis=1, keepdims=True, initial=np.finfo(float).tiny)
    norms = size * np.linalg.norm(reference / size, axis=1, keepdims=True)  # no overflow
    nonzero = np.where(norms > 0, norms, np.nan)
    usual = np.ones(norms.shape[2])
    has_any = (norms > 0).any(axis=(0, 1))
    if has_any.any():
        usual[has_any] = np.nanmedian(nonzero[..., has_any], axis=(0, 1))
        usual[~has_any] = np.median(usual[has_any])
    sizes: Array = np.maximum(norms, np.where(has_any, FLOOR, 1.0) * usual)
    return sizes


def _row_units(reference: Array, uncertainty: Array) -> Array:
    """Return the unit of each row, (K, R, 1): 1 for rows of similar size, less for smaller rows."""
    sizes = np.abs(reference)
    with np.errstate(divide="ignore", invalid="ignore"):
        known = np.isfinite(sizes) & (sizes > CLEAR * uncertainty) & (sizes > 0)
        logs = np.where(known, np.log(sizes), 0.0)
    in_row, in_column = (np.maximum(known.sum(axis, keepdims=True), 1) for axis in (2, 1))
    of_rows, of_columns = np.zeros((*sizes.shape[:2], 1)), np.zeros((len(sizes), 1, sizes.shape[2]))
    for _ in range(SWEEPS):
        before = of_rows
        of_columns = (known * (logs - of_rows)).sum(axis=1, keepdims=True) / in_column
        of_rows = (known * (logs - of_columns)).sum(axis=2, keepdims=True) / in_row
        if np.abs(of_rows - before).max(initial=0.0) < SETTLED:
            break
    is_known = known.any(axis=2, keepdims=True)
    of_rows = np.where(is_known, of_rows, -np.inf)
    largest = of_rows.max(axis=1, keepdims=True, initial=-np.inf)
    with np.errstate(invalid="ignore"):
        units = ALIKE * np.exp(of_rows - largest)
    units = np.where(is_known, np.minimum(units, 1.0), 1.0)
    usual = np.median(units, axis=0, keepdims=True) if len(units) else 1.0
    return np.asarray(np.maximum(units, FLOOR * usual), np.float64)
