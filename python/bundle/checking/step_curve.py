"""Differences of a residual against the step size at sample points, and details for a page.

Along one parameter, with r the residual, there are three differences of each row:

    D(h) = (r(h) - r(-h)) / 2h,     D+(h) = (r(h) - r(0)) / h,     D-(h) = (r(0) - r(-h)) / h.

Their errors fall with h (truncation: h^2 and h) until the rounding errors of r, divided by h, take
over: a V on logarithmic axes. One extrapolation removes the leading term,

    R(h) = D(h/2) + (D(h/2) - D(h)) / 3,     R+-(h) = 2 D+-(h/2) - D+-(h).

A Jacobian that equals one of these at two consecutive steps, to a hundredth of its deviation from
the reference, is the derivative at this scale: no mistake agrees by chance, because the error of R
changes by a factor of 16 from step to step and that of R+- by 4. The residual then has another
slope at another scale, or on the other side of a kink: digits cancel near a small angle, a robust
loss begins. Such an entry is undecided, not wrong.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.checking.classify import rounds_to_single
from bundle.checking.function import UserFunction
from bundle.checking.jacobian_deviation import CHECKER_PRECISION, Array, JacobianDeviation
from bundle.checking.residual_blocks import Layout

HALVINGS = 44
"""Least number of steps; the last is at the resolution of double precision, for parameters of 1."""
MOST_HALVINGS = 1074  # largest number of steps, for tiny parameters
LARGEST_STEP = 1 / 16  # first step, as a fraction of the parameter
LEAST_FIRST_STEP = 1 / 128
CLOSE = 1e-6  # largest difference of an acquitted entry, relative to its scale
ROUNDING = 8  # rounding errors of a difference, in units of the last place of the largest residual
NOISY_STEPS = 8  # number of the smallest steps, at which a residual changes by rounding errors only
SHARE = 1e-2  # largest difference of an acquitted entry, relative to its deviation

Values = Callable[[float], Array | None]


@dataclass(frozen=True, eq=False)
class Line:
    """Residuals along a parameter."""

    steps: Array  # (S,) step sizes, each half of the one before
    center: Array  # (R,) residual at the point
    plus: Array  # (S, R) residuals at +h; NaN without a value
    minus: Array  # (S, R) residuals at -h

    @property
    def central(self) -> Array:
        """D(h) (S, R)."""
        return (self.plus - self.minus) / (2 * self.steps[:, None])

    @property
    def forward(self) -> Array:
        """D+(h) (S, R)."""
        return (self.plus - self.center) / self.steps[:, None]

    @property
    def backward(self) -> Array:
        """D-(h) (S, R)."""
        return (self.center - self.minus) / self.steps[:, None]


@dataclass(frozen=True, eq=False)
class StepCurve:
    """Differences of one entry of a Jacobian against the step size."""

    parameter: str  # name of the column
    place: str  # point of the check in words
    residual: int  # index of the row
    analytic: float  # value to check
    reference: float  # extrapolated difference
    uncertainty: float  # bound on the error of the reference
    scale: float  # divisor of relative errors
    is_wrong: bool  # True if the entry is wrong
    steps: Array  # (S,) step sizes
    differences: Array  # (S,) central differences; NaN without a value


def walk(values: Values, center: Array, size: float) -> Line:
    """Evaluate a residual on both sides of a point.

    Args:
        values: residual at a step; None without a value.
        size: size of the parameter. A small parameter gets additional smaller steps.
    """
    first = max(abs(size) * LARGEST_STEP, LEAST_FIRST_STEP)
    further = math.ceil(math.log2(LEAST_FIRST_STEP / (LARGEST_STEP * abs(size)))) if size else 0
    count = min(HALVINGS + max(further, 0), MOST_HALVINGS)
    steps = np.asarray(first * 0.5 ** np.arange(count), np.float64)
    sides = np.full((2, count, len(center)), np.nan)
    for k, h in enumerate(steps):
        for side, step in enumerate((h, -h)):
            found = values(float(step))
            if found is not None:
                sides[side, k] = found
    return Line(steps, center, sides[0], sides[1])


def acquitted(line: Line, analytic: Array, deviation: Array, scale: Array) -> NDArray[np.bool_]:
    """Return the mask (R,) of entries that are a derivative at some scale or on one side.

    Args:
        analytic: (R,) column of the Jacobian.
        deviation: (R,) its absolute deviation from the reference.
        scale: (R,) divisors of relative errors, which may be far too small if the reference has
            another scale.
    """
    close = np.minimum(CLOSE * np.maximum(scale, np.abs(analytic)), SHARE * deviation)
    # At smaller steps rounding alone decides: a residual that does not change has slope 0.
    sides = np.nan_to_num(np.maximum(abs(line.plus), abs(line.minus)), posinf=0.0)
    noise = ROUNDING * np.finfo(float).eps * np.maximum(sides[:-1], abs(line.center))
    smallest = (line.plus - line.minus)[-NOISY_STEPS:]
    noise = noise + np.max(np.abs(np.nan_to_num(smallest, posinf=0.0, neginf=0.0)), axis=0)
    is_clear = noise <= close * line.steps[1:, None]
    found = np.zeros(len(analytic), bool)
    for differences, divisor in ((line.central, 3), (line.forward, 1), (line.backward, 1)):
        with np.errstate(invalid="ignore", over="ignore"):
            extrapolated = differences[1:] + np.diff(differences, axis=0) / divisor
            same = is_clear & (np.abs(extrapolated - analytic) <= close)
        found |= (same[1:] & same[:-1]).any(axis=0)
    return found


MOST_WRONG = 6  # number of curves of wrong entries, one per column
MOST_RIGHT = 4  # number of curves of right entries, one per group of parameters

LineOf = Callable[[int, int], Line]
"""Function from the index of a point and a column to the residuals along it."""


@dataclass(frozen=True, eq=False)
class CheckDetails:
    """Errors of all entries of a Jacobian, and curves of selected ones."""

    columns: tuple[str, ...]  # names of the columns
    # (R, N) largest relative error of each entry over all points; that of the reference where it
    # exceeds the tolerance is subtracted
    errors: Array
    is_wrong: NDArray[np.bool_]  # (R, N) mask of wrong entries
    curves: tuple[StepCurve, ...]  # curves of the worst entries, then of right ones


def make_details(
    names: Sequence[str],
    groups: Sequence[str],
    deviations: JacobianDeviation,
    tolerance: float,
    line_of: LineOf,
    place: Callable[[int], str],
) -> CheckDetails:
    """Return the details of a check."""
    error = deviations.error
    clear = np.where(deviations.doubt <= tolerance, deviations.deviation, error)
    curves = tuple(
        curve_of(deviations, (k, row, j), names[j], place(k), line_of(k, j), tolerance)
        for k, row, j in choose_entries(deviations, groups, tolerance)
    )
    is_wrong = np.asarray((error > tolerance).any(axis=0))
    return CheckDetails(tuple(names), clear.max(axis=0), is_wrong, curves)


def choose_entries(
    deviations: JacobianDeviation, groups: Sequence[str], tolerance: float
) -> list[tuple[int, int, int]]:
    """Return (point, row, column) of the worst entry of each wrong column and right group."""
    error = deviations.error
    worst = error.max(axis=(0, 1))
    wrong = [int(j) for j in np.argsort(-worst, kind="stable") if worst[j] > tolerance]
    chosen = [_largest(error, j) for j in wrong[:MOST_WRONG]]
    sizes = np.abs(deviations.reference) / deviations.scale
    sizes = np.where(deviations.doubt <= tolerance, sizes, -1.0)
    right: dict[str, int] = {}
    for j, group in enumerate(groups):
        if j not in wrong and sizes[..., j].max() > 0:
            right.setdefault(group, j)
    return chosen + [_largest(sizes, j) for j in list(right.values())[:MOST_RIGHT]]


def curve_of(
    deviations: JacobianDeviation,
    entry: tuple[int, int, int],
    name: str,
    place: str,
    line: Line,
    tolerance: float,
) -> StepCurve:
    """Return the curve of an entry: point, row and column."""
    row = entry[1]
    return StepCurve(
        parameter=name,
        place=place,
        residual=row,
        analytic=float(deviations.analytic[entry]),
        reference=float(deviations.reference[entry]),
        uncertainty=float(deviations.uncertainty[entry]),
        scale=float(deviations.scale[entry]),
        is_wrong=bool(deviations.error[entry] > tolerance),
        steps=line.steps,
        differences=line.central[:, row],
    )


def _largest(values: Array, column: int) -> tuple[int, int, int]:
    k, row = np.unravel_index(int(np.argmax(values[..., column])), values.shape[:2])
    return int(k), int(row), column


Probe = tuple[bool, Array | None, Array | None, str]


@dataclass(frozen=True, eq=False)
class SamplePoint:
    """Values of the blocks at which a function is checked; each point may have its own function."""

    user: UserFunction
    blocks: list[Array]

    def evaluate(self) -> tuple[Array, Array]:
        """Return the residual (R,) and the Jacobians of all blocks, concatenated to (R, N)."""
        return self.user.evaluate(self.blocks)

    def reference(
        self, manifolds: list[tuple[str, list[int]]], minuends: Sequence[float] = ()
    ) -> Any:
        """Return the result of Richardson extrapolation.

        ``minuends``: size of the numbers whose difference is each residual, if known: their
        rounding errors are also those of the residual.
        """
        return _core.richardson_jacobian(
            self.user.core, self.user.num_residuals, self.blocks, manifolds, list(minuends)
        )

    def rounds_to_single(self) -> bool:
        """Return True if the function rounds a parameter to single precision."""
        return rounds_to_single(lambda blocks: self.user.evaluate(blocks)[0], self.blocks)

    def probe(self, manifolds: list[tuple[str, list[int]]]) -> Probe:
        """Return the result of ceres::GradientChecker."""
        return _core.gradient_checker(
            self.user.core, self.user.num_residuals, self.blocks, manifolds, CHECKER_PRECISION
        )

    def reference_without(
        self, parameter: int, manifolds: list[tuple[str, list[int]]]
    ) -> Array | None:
        """Return the reference with one parameter set to zero; None if it has none there."""
        flat = np.concatenate(self.blocks)
        flat[parameter] = 0.0
        there = SamplePoint(self.user, np.split(flat, np.cumsum(self.user.sizes)[:-1]))
        try:
            if self.user.core(there.blocks, False) is None:
                return None
            values, uncertainty, *_ = there.reference(manifolds)
        except Exception:  # the user's function may fail at a zero that it never meets
            return None
        return values if np.isfinite(uncertainty).all() else None


@dataclass(frozen=True, eq=False)
class SampleLines:
    """Sample points with their residuals; lines through them along columns of the Jacobian."""

    samples: Sequence[SamplePoint]
    residuals: Sequence[Array]
    layout: Layout

    def appealed(
        self,
        deviations: JacobianDeviation,
        samples: Sequence[int],
        tolerance: float,
        *,
        along_manifold: bool,
    ) -> JacobianDeviation:
        """Return the deviations; a derivative at another scale makes an entry undecided."""
        wrong = deviations.error > tolerance
        if not wrong.any():
            return deviations
        uncertainty = deviations.uncertainty.copy()
        off = np.abs(deviations.analytic - deviations.reference)
        for k, j in zip(*np.nonzero(wrong.any(axis=1)), strict=True):
            if not np.isfinite(deviations.analytic[k, :, j]).all():
                continue
            line = self.line(samples[k], int(j), along_manifold=along_manifold)
            scale = deviations.scale[k, :, j]
            found = acquitted(line, deviations.analytic[k, :, j], off[k, :, j], scale)
            found &= wrong[k, :, j]
            uncertainty[k, found, j] += off[k, found, j]
        return JacobianDeviation(
            deviations.analytic, deviations.reference, uncertainty, deviations.tolerance
        )

    def line(self, sample: int, column: int, *, along_manifold: bool) -> Line:
        """Return the residuals at steps along a column of the Jacobian."""
        at = self.samples[sample]
        manifolds = self.layout.manifolds
        sizes = [m.tangent_size if along_manifold else m.size for m in manifolds]
        b = int(np.searchsorted(np.cumsum(sizes), column, side="right"))
        direction = np.zeros(sizes[b])
        direction[column - sum(sizes[:b])] = 1.0
        is_curved = along_manifold and manifolds[b].is_curved

        def values(step: float) -> Array | None:
            blocks = [block.copy() for block in at.blocks]
            move = step * direction
            blocks[b] = manifolds[b].plus(blocks[b], move) if is_curved else blocks[b] + move
            answer = at.user.core(blocks, False)
            return None if answer is None else answer[0]

        size = 1.0 if is_curved else float(at.blocks[b] @ direction)
        return walk(values, self.residuals[sample], size)
