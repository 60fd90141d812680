"""Parts that the diagnoses of problems and of pose graphs share: rank, digits, problems."""

from __future__ import annotations

import math

from bundle.base.words import plural
from bundle.interface.finding import Finding

DIGITS = 16
"""Decimal digits of a double, rounded up as in the table of condition numbers."""


class Conditioned:
    """Conclusions from rank, condition number and findings of a diagnosis."""

    nullity: int
    expected_nullity: int
    nullity_is_exact: bool
    condition_number: float
    findings: tuple[Finding, ...]

    @property
    def ok(self) -> bool:
        """True if the problem is fully determined."""
        return not any(finding.is_problem for finding in self.findings)

    @property
    def digits_normal_equations(self) -> int:
        """Digits of a step from the normal equations: 16 - log10(cond S), at least 0."""
        return self._digits(1.0)

    @property
    def digits_square_root(self) -> int:
        """Digits of a step from a QR factorisation of the Jacobian; cond J = sqrt(cond S)."""
        return self._digits(0.5)

    def _digits(self, power: float) -> int:
        condition = self.condition_number
        if math.isnan(condition):
            return 0
        return max(0, round(DIGITS - power * math.log10(max(condition, 1.0))))

    @property
    def verdict(self) -> str:
        """Verdict on the rank in one sentence."""
        more = self.nullity - self.expected_nullity
        least = "" if self.nullity_is_exact else "at least "
        words = f"{least}{plural(self.nullity, 'null direction')}"
        if more == 0:
            return f"{words}, all of them gauge" if self.nullity else "no null direction"
        if more > 0:
            return f"{words}: {self.expected_nullity} are gauge, {more} are not determined"
        return f"{words}, fewer than the {self.expected_nullity} of the gauge"
