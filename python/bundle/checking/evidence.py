"""Input of signatures: wrong columns, and a test of hypotheses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.checking.jacobian_deviation import Array, JacobianDeviation, norm
from bundle.checking.residual_blocks import Block, Column

EXPLAINED = 1e-5
"""Largest fraction of the deviation that an accepted hypothesis may leave unexplained."""

KNOWN = 0.1  # largest relative uncertainty of a reference entry that can support a hypothesis

ReferenceAt = Callable[[int, int], Array | None]


@dataclass(frozen=True)
class Finding:
    """A mistake and its description."""

    kind: str  # signature, one of ``bundle.checking.classify.MISTAKES``
    columns: tuple[str, ...]  # names of the affected parameters
    sentence: str  # explanation
    error: float = 0.0  # largest relative error of these columns
    factor: float | None = None  # analytic / correct, if this ratio is constant
    # indices of the residuals with a wrong entry in these columns; () if the mistake is one of the
    # whole Jacobian
    rows: tuple[int, ...] = ()


@dataclass(eq=False)
class Evidence:
    """Points with wrong Jacobians, and their columns that no signature explains yet."""

    deviations: JacobianDeviation  # Jacobians at K points, all of them wrong
    columns: Sequence[Column]  # N columns
    blocks: Sequence[Block]  # blocks to test, which may overlap
    points: Array  # (K, N) the parameters at these points
    # function of (k, j) that returns the reference at point k with parameter j set to zero, or None
    reference_at: ReferenceAt
    wrong: list[int]  # unexplained wrong columns; signatures remove what they explain
    tolerance: float = 0.0  # relative error above which an entry is wrong
    findings: list[Finding] = field(default_factory=list)
    numbers: NDArray[np.intp] | None = None  # (K,) sample numbers, for data per sample
    residuals: Array | None = None  # (K, R) residuals at the points, if available to signatures

    def __post_init__(self) -> None:
        scale = self.deviations.scale
        self.analytic: Array = self.deviations.analytic / scale
        self.reference: Array = self.deviations.reference / scale
        doubt = np.minimum(self.deviations.doubt, 1.0)
        self.doubt: Array = doubt

    def explains(
        self, guess: Array, columns: Sequence[int], points: NDArray[np.intp] | None = None
    ) -> bool:
        """Return True if a hypothesis (K, R, len(columns)), in units of scale, equals the Jacobian.

        The remainder is compared both with the deviation and with the Jacobian itself. Otherwise
        any small number would explain a column of a thousandth of the correct size.
        """
        chosen = slice(None) if points is None else points
        doubts = self.doubt[chosen][..., columns]
        known = doubts <= KNOWN
        if 2 * known.sum() < known.size:
            return False
        analytic = np.where(known, self.analytic[chosen][..., columns], 0.0)
        reference = np.where(known, self.reference[chosen][..., columns], 0.0)
        left = norm(analytic - np.where(known, guess, 0.0))
        deviation = norm(analytic - reference)
        doubt = norm(np.where(known, doubts, 0.0))
        size = min(deviation, norm(analytic))
        return bool(deviation > 10 * doubt and left <= EXPLAINED * size + 2 * doubt)

    def points_wrong_in(self, column: int) -> NDArray[np.intp]:
        """Return the points at which a column is wrong; a mistake may affect one branch only."""
        errors = self.deviations.error[..., column].max(axis=1)
        return np.flatnonzero(errors > self.tolerance)

    def names(self, columns: Sequence[int]) -> str:
        """Return joined names such as "rotation x, y and z"; a common first word appears once."""
        return join_names([self.columns[j].name for j in columns])

    def found(
        self, kind: str, columns: Sequence[int], sentence: str, factor: float | None = None
    ) -> None:
        """Add a finding that explains columns."""
        errors = self.deviations.error[..., list(columns)]
        error = float(np.max(errors, initial=0.0))
        rows = tuple(np.flatnonzero((errors > self.tolerance).any(axis=(0, 2))).tolist())
        names = tuple(self.columns[j].name for j in columns)
        self.findings.append(Finding(kind, names, sentence, error, factor, rows))
        self.wrong = [j for j in self.wrong if j not in columns]


def join_names(names: Sequence[str]) -> str:
    """Return names as a phrase; the first words of consecutive names appear once."""
    parts: list[str] = []
    for head, same in groupby(names, key=lambda name: name.rpartition(" ")[0]):
        first, *others = same
        parts += [first, *(name.removeprefix(f"{head} ") for name in others)]
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
