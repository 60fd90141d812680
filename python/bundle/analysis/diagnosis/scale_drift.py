"""By how much a solve scaled the world.

Images and points alone do not hold the scale. A solve without that gauge fixed may shrink the world
a little at each step, geometrically: the cost has no say in it, but far along numbers lose digits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bundle.solving.result import Result

__all__ = ["ScaleDrift", "scale_drift"]


@dataclass(frozen=True)
class ScaleDrift:
    """The scale of a world after a solve.

    Attributes:
        factor: spread of the camera centres after, by that before.
        num_steps: accepted steps of the solve, at least 1.
    """

    factor: float
    num_steps: int

    @property
    def per_step(self) -> float:
        """The geometric mean of the factors of the steps."""
        return float(self.factor ** (1.0 / self.num_steps))


def scale_drift(result: Result) -> ScaleDrift | None:
    """Return by how much a solve scaled the world; None where it was aligned or has no extent."""
    before, after = (
        float(np.linalg.norm(centers - centers.mean(axis=0)))
        for centers in (
            result.initial_problem.projection_centers,
            result.problem.projection_centers,
        )
    )
    if not before > 0 or result.similarity is not None:
        return None
    accepted = np.asarray(result.iterations["step_is_successful"], bool)
    return ScaleDrift(after / before, max(int(accepted[1:].sum()), 1))
