"""Digits that the conditioning of a factor graph leaves to a step."""

from __future__ import annotations

import math
from collections.abc import Sequence

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import plural

DIGITS = 16
ENOUGH = 4


@dataclass(frozen=True, repr=False)
class DigitsLeft(Displayed):
    """Digits of a step by normal equations and by a QR factorisation.

    J is the whitened Jacobian with its columns scaled to norm 1, so that units have no effect.
    Normal equations square the condition number of J and lose twice as many digits as QR.

    Attributes:
        condition_number: kappa(J), the ratio of the largest and the smallest singular value,
            accurate to a few percent; infinite for dependent columns, as in a graph without a
            prior.
        rank: rank of J according to the QR factorisation.
        num_columns: number of free coordinates.
    """

    condition_number: float
    rank: int
    num_columns: int

    @staticmethod
    def of(largest: float, least: float, num_columns: int, dependent: Sequence[int]) -> DigitsLeft:
        """Return the digits for two singular values and the dependent columns."""
        rank = num_columns - len(dependent)
        condition = largest / least if least > 0 and rank == num_columns else math.inf
        return DigitsLeft(max(condition, 1.0), rank, num_columns)

    @property
    def normal_equations(self) -> int:
        """Digits of a step by normal equations: 16 - 2 log10 kappa, at least 0."""
        return self._digits(2)

    @property
    def square_root(self) -> int:
        """Digits of a step by QR: 16 - log10 kappa, at least 0."""
        return self._digits(1)

    @property
    def needs_square_root(self) -> bool:
        """True if normal equations leave fewer than 4 digits and J has full rank."""
        return self.rank == self.num_columns and self.normal_equations < ENOUGH

    def _digits(self, power: int) -> int:
        if math.isinf(self.condition_number):
            return 0
        return max(0, round(DIGITS - power * math.log10(self.condition_number)))

    def _display(self) -> Display:
        return Display(
            title="DigitsLeft",
            facts=(
                ("condition of J", f"{self.condition_number:.1e}"),
                ("rank", f"{self.rank} of {plural(self.num_columns, 'free coordinate')}"),
                ("normal equations", plural(self.normal_equations, "digit")),
                ("square root", plural(self.square_root, "digit")),
            ),
        )
