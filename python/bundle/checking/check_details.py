"""Details of a check for its page: errors of all entries, and curves against the step size."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.checking.jacobian_deviation import Array, JacobianDeviation
from bundle.checking.step_curve import Line, StepCurve

MOST_WRONG = 6
"""Number of curves of wrong entries, one per column."""
MOST_RIGHT = 4
"""Number of curves of right entries, one per group of parameters."""

LineOf = Callable[[int, int], Line]
"""Function from the index of a point and a column to the residuals along it."""


@dataclass(frozen=True, eq=False)
class CheckDetails:
    """Errors of all entries of a Jacobian, and curves of some.

    Attributes:
        columns: names of the columns.
        errors: (R, N) largest relative error of each entry over all points; that of the reference
            where it exceeds the tolerance is subtracted.
        is_wrong: (R, N) mask of wrong entries.
        curves: curves of the worst entries, then of right ones.
    """

    columns: tuple[str, ...]
    errors: Array
    is_wrong: NDArray[np.bool_]
    curves: tuple[StepCurve, ...]


def make_details(
    names: Sequence[str],
    groups: Sequence[str],
    deviations: JacobianDeviation,
    tolerance: float,
    line_of: LineOf,
    place: Callable[[int], str],
) -> CheckDetails:
    """Return the details of a check.

    Args:
        names: names of the columns.
        groups: groups of the columns.
        deviations: Jacobians at all points.
        tolerance: relative error above which an entry is wrong.
        line_of: residuals along a column at a point.
        place: description of a point.
    """
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
    """Return point, row and column of the worst entry of wrong columns, and of right groups."""
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
