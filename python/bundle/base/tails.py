"""Tails of the F and chi-squared distributions, quantiles of Student's t and chi squared.

With x = m / (m + k f), the probability that F with k and m degrees of freedom exceeds f is the
regularised incomplete beta function I_x(m/2, k/2), computed by its continued fraction (Press et
al.: Numerical Recipes, section 6.4). Without a limit of m, k F has a chi-squared distribution:
Q(k/2, k f / 2) with Q(1/2, y) = erfc(sqrt(y)), Q(1, y) = exp(-y) and
Q(a + 1, y) = Q(a, y) + y^a exp(-y) / Gamma(a + 1).
"""

from __future__ import annotations

import math

MOST_FREEDOM = 1e6  # degrees of freedom above which F is a chi-squared distribution to six digits


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


def student_quantile(z: float, freedom: int) -> float:
    """Return the t that Student's |t| exceeds as often as a standard normal value exceeds z >= 0.

    Without a degree of freedom: z.
    """
    tail, low, high = chi2_tail(z * z, 1), z, 1e9 if freedom >= 1 else z
    for _ in range(100):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if f_tail(middle**2, 1, freedom) > tail else (low, middle)
    return high


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


# Quantiles of chi squared by degrees of freedom.
#
# Tables hold exact values (SciPy's ``chi2.isf``), so that solves do not need SciPy. For many
# degrees of freedom, the approximation of E. Wilson and M. Hilferty (1931) is used: the cube root
# of chi2 / k is nearly normal, with mean 1 - 2 / (9 k) and variance 2 / (9 k).

ONE_IN_2000 = {3: 17.72999622894616, 6: 24.102798994983747}
"""99.95 % quantiles: limit of a squared error that one correct edge in 2000 exceeds."""

ONE_IN_A_MILLION = {
    1: 23.928126976934827, 2: 27.631021115928547, 3: 30.664849706213598,
    4: 33.37684158171984, 5: 35.888186879672865, 6: 38.25833637720969,
}  # fmt: skip
"""Quantiles at 1 - 1e-6: limit of a squared error that one correct edge in a million exceeds."""

_MEDIANS = {
    1: 0.454936423119572, 2: 1.386294361119891, 3: 2.3659738843753377,
    4: 3.3566939800333224, 5: 4.351460191095526, 6: 5.348120627447118,
}  # fmt: skip

_NORMAL_QUANTILE = 3.2905267314918945  # 99.95 % quantile of the standard normal distribution
_NORMAL_ONE_IN_A_MILLION = 4.753424308822899  # the one at 1 - 1e-6


def chi2_quantile(degrees: int) -> float:
    """Return the 99.95 % quantile of chi2, accurate to a percent (Wilson and Hilferty)."""
    return _quantile(degrees, _NORMAL_QUANTILE)


def chi2_limit(degrees: int) -> float:
    """Return the quantile at 1 - 1e-6; infinite without degrees of freedom."""
    if degrees < 1:
        return float("inf")
    return ONE_IN_A_MILLION.get(degrees) or _quantile(degrees, _NORMAL_ONE_IN_A_MILLION)


def chi2_bound(degrees: float, probability: float) -> float:
    """Return the value that chi2 exceeds with a small probability.

    It is exact for one degree of freedom, and that of Wilson and Hilferty for more.
    """
    from statistics import NormalDist  # slow, and most solves need the tables alone

    if degrees == 1:
        return NormalDist().inv_cdf(1 - probability / 2) ** 2
    return _quantile(degrees, NormalDist().inv_cdf(1 - probability))


def chi2_median(degrees: int) -> float:
    """Return the median."""
    return _MEDIANS.get(degrees) or _quantile(degrees, 0.0)


def chi2_interval(degrees: float, is_certain: bool = False) -> tuple[float, float]:
    """Return the interval of 99.9 % of all values, or of all but 2 in a million."""
    normal = _NORMAL_ONE_IN_A_MILLION if is_certain else _NORMAL_QUANTILE
    return _quantile(degrees, -normal), _quantile(degrees, normal)


def _quantile(degrees: float, normal: float) -> float:
    if degrees < 1:
        return 0.0
    variance = 2 / (9 * degrees)
    return float(degrees * max(1 - variance + normal * variance**0.5, 0.0) ** 3)
