"""Factor by which a solve scaled the world.

Images and points alone do not determine the scale. A solve without a fixed scale may shrink the
world a little at each step, geometrically. The cost does not change, but after many steps numbers
lose digits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bundle.solving.result import Result

__all__ = ["ScaleDrift", "scale_drift"]


@dataclass(frozen=True)
class ScaleDrift:
    """Scale of a world after a solve.

    Attributes:
        factor: ratio of the spread of the camera centres after and before the solve.
        num_steps: accepted steps of the solve, at least 1.
    """

    factor: float
    num_steps: int

    @property
    def per_step(self) -> float:
        """Geometric mean of the factors of the steps."""
        return float(self.factor ** (1.0 / self.num_steps))


def scale_drift(result: Result) -> ScaleDrift | None:
    """Return the scale change by a solve; None if aligned or without extent."""
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
