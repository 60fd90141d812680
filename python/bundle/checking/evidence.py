"""Evidence for signatures: the wrong columns, and the test of a prediction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bundle.checking.columns import Block, Column
from bundle.checking.jacobian_deviation import Array, JacobianDeviation

__all__ = ["Evidence", "Finding"]

EXPLAINED = 1e-3
"""Share of a deviation that an accepted prediction may leave."""

ReferenceAt = Callable[[int, int], Array | None]


@dataclass(frozen=True)
class Finding:
    """A mistake, and its description.

    Attributes:
        kind: the signature, one of ``bundle.checking.classify.KINDS``.
        columns: names of the parameters concerned.
        sentence: the explanation.
        error: largest relative error of these columns.
        factor: analytic / correct, where that is constant.
    """

    kind: str
    columns: tuple[str, ...]
    sentence: str
    error: float = 0.0
    factor: float | None = None


@dataclass(eq=False)
class Evidence:
    """Points with errors, and the errors that are not explained yet.

    Attributes:
        deviations: the Jacobians at K points, those with errors only.
        columns: N columns.
        blocks: blocks to look at, which may overlap.
        points: (K, N) the parameters at these points.
        reference_at: (k, j) gives the reference at point k with parameter j set to zero, or None.
        wrong: indices of the columns that are wrong and not explained; signatures remove theirs.
        tolerance: relative error from which on an entry is wrong.
        numbers: (K,) of the points among the samples, where blocks know something of these.
        residuals: (K, R) the residuals there, where a signature may look at them.
    """

    deviations: JacobianDeviation
    columns: Sequence[Column]
    blocks: Sequence[Block]
    points: Array
    reference_at: ReferenceAt
    wrong: list[int]
    tolerance: float = 0.0
    findings: list[Finding] = field(default_factory=list)
    numbers: NDArray[np.intp] | None = None
    residuals: Array | None = None

    def __post_init__(self) -> None:
        scale = self.deviations.scale
        self.analytic: Array = self.deviations.analytic / scale
        self.reference: Array = self.deviations.reference / scale
        doubt = np.minimum(self.deviations.doubt, 1.0)
        self.doubt: Array = doubt

    def explains(
        self, guess: Array, columns: Sequence[int], points: NDArray[np.intp] | None = None
    ) -> bool:
        """Return whether a prediction (K, R, len(columns)), in units of scale, fits the columns.

        The remainder is compared with the deviation and with the columns: a column of a thousandth
        of the right size is not explained by any other small number.
        """
        chosen = slice(None) if points is None else points
        analytic = self.analytic[chosen][..., columns]
        reference = self.reference[chosen][..., columns]
        left = np.linalg.norm(analytic - guess)
        deviation = np.linalg.norm(analytic - reference)
        doubt = np.linalg.norm(self.doubt[chosen][..., columns])
        size = min(float(deviation), float(np.linalg.norm(analytic)))
        return bool(deviation > 4 * doubt and left <= EXPLAINED * size + 2 * doubt)

    def points_wrong_in(self, column: int) -> NDArray[np.intp]:
        """Return the points at which a column is wrong: a mistake can be in a single branch."""
        errors = self.deviations.error[..., column].max(axis=1)
        return np.flatnonzero(errors > self.tolerance)

    def names(self, columns: Sequence[int]) -> str:
        """Return joined names, such as "rotation x, y and z", with a common first word once."""
        return join_names([self.columns[j].name for j in columns])

    def found(
        self, kind: str, columns: Sequence[int], sentence: str, factor: float | None = None
    ) -> None:
        """Record a finding that explains columns."""
        error = float(np.max(self.deviations.error[..., list(columns)], initial=0.0))
        names = tuple(self.columns[j].name for j in columns)
        self.findings.append(Finding(kind, names, sentence, error, factor))
        self.wrong = [j for j in self.wrong if j not in columns]


def join_names(names: Sequence[str]) -> str:
    """Return names as a phrase."""
    heads = {name.rpartition(" ")[0] for name in names}
    if len(names) > 1 and len(heads) == 1 and "" not in heads:
        (head,) = heads
        last = [name.rpartition(" ")[2] for name in names]
        names = [f"{head} {last[0]}", *last[1:]]
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
