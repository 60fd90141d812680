"""Excitation of the accelerometer, on which the observability of scale depends.

An accelerometer measures metres only while the acceleration changes. The standard deviation of
|a| - |g| measures these changes. At rest, on a straight road or in a hover it contains only noise.
Scale and accelerometer bias are then not separable.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from bundle.base.arrays import Array, as_array, check_values
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.errors import InputError

HEALTHY, UNOBSERVABLE = 0.5, 0.05  # m/s^2


@dataclass(frozen=True, repr=False)
class Excitation(Displayed):
    """Change of the acceleration over some samples.

    Attributes:
        spread: standard deviation of |a| - |g|, in m/s^2.
        verdict: "healthy" above 0.5 m/s^2; "unobservable" below 0.05: the samples do not determine
            the scale, so hold it constant; "marginal" between.
        num_samples: number of samples.
    """

    spread: float
    verdict: str
    num_samples: int

    def _display(self) -> Display:
        return Display(
            title=f"Excitation: {self.verdict}",
            facts=(
                ("std(|a| - g)", f"{self.spread:.3g} m/s^2 of {self.num_samples} samples"),
                ("bounds", f"healthy above {HEALTHY:g}, unobservable below {UNOBSERVABLE:g}"),
            ),
        )


def excitation(accel: ArrayLike) -> Excitation:
    """Return the excitation of accelerometer samples, with a verdict on the scale.

    Args:
        accel: (n, 3) m/s^2, specific force, all samples of a window; at least 2.

    Raises:
        InputError: the shape is wrong, numbers are not finite, or there are fewer than 2 samples.
    """
    samples = as_array("accel", accel)
    if samples.ndim != 2 or samples.shape[1] != 3 or len(samples) < 2:
        raise InputError(f"accel: expected shape (n, 3) with n of 2 or more, found {samples.shape}")
    spread = float(np.sqrt(np.einsum("ij,ij->i", samples, samples)).std())
    check_values("accel", samples, Array(("n", 3), "finite"))
    if spread > HEALTHY:
        verdict = "healthy"
    else:
        verdict = "unobservable" if spread < UNOBSERVABLE else "marginal"
    return Excitation(spread, verdict, len(samples))
