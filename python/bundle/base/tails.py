"""Tails of the F and chi-squared distributions.

With x = m / (m + k f), the probability that F with k and m degrees of freedom exceeds f is the
regularised incomplete beta function I_x(m/2, k/2), computed by its continued fraction (Press et
al.: Numerical Recipes, section 6.4). Without a limit of m, k F has a chi-squared distribution:
Q(k/2, k f / 2) with Q(1/2, y) = erfc(sqrt(y)), Q(1, y) = exp(-y) and
Q(a + 1, y) = Q(a, y) + y^a exp(-y) / Gamma(a + 1).
"""

from __future__ import annotations

import math

MOST_FREEDOM = 1e6
"""Degrees of freedom above which F is a chi-squared distribution to six digits."""


def chi2_tail(value: float, freedom: int) -> float:
    """Return the probability that chi squared exceeds a value."""
    half = 0.5 * value
    if not half > 0:
        return 1.0
    exponent = 0.5 if freedom % 2 else 1.0
    tail = math.erfc(math.sqrt(half)) if freedom % 2 else math.exp(-half)
    while exponent < 0.5 * freedom:
        tail += math.exp(exponent * math.log(half) - half - math.lgamma(exponent + 1))
        exponent += 1
    return tail


def f_tail(value: float, numerator: int, freedom: float) -> float:
    """Return the probability that F exceeds a value; infinite `freedom`: chi squared / numerator.

    Below one degree of freedom, which has no meaning, the probability is 1.
    """
    if not freedom >= 1 or not value > 0:
        return 1.0
    if freedom > MOST_FREEDOM:
        return chi2_tail(numerator * value, numerator)
    a, b = 0.5 * freedom, 0.5 * numerator
    x = freedom / (freedom + numerator * value)
    if x < (a + 1) / (a + b + 2):
        return _beta_front(a, b, x) * _beta_fraction(a, b, x) / a
    return 1.0 - _beta_front(a, b, x) * _beta_fraction(b, a, 1 - x) / b


def _beta_front(a: float, b: float, x: float) -> float:
    whole = math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b)
    return math.exp(whole + a * math.log(x) + b * math.log1p(-x)) if x < 1 else 0.0


def _beta_fraction(a: float, b: float, x: float) -> float:
    """Return the continued fraction of the incomplete beta function by Lentz's method."""
    result = d = 1 / _not_zero(1 - (a + b) * x / (a + 1))
    c = 1.0
    for m in range(1, 10_000):
        even = m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m))
        odd = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1))
        for term in (even, odd):
            d = 1 / _not_zero(1 + term * d)
            c = _not_zero(1 + term / c)
            result *= c * d
        if abs(c * d - 1) < 1e-14:
            break
    return result


def _not_zero(value: float) -> float:
    return value if abs(value) > 1e-300 else 1e-300
