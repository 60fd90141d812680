"""Points of a model and their surveyed positions, each with its covariance."""

from __future__ import annotations

from dataclasses import field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Correspondences:
    """Points of a model and their surveyed positions.

    Attributes:
        source: (n, 3) in the model.
        target: (n, 3) east, north, up [m]; up is nan if unknown.
        target_covariance: (n, 3, 3) [m^2].
        source_covariance: (n, 3, 3) in squared units of the model; zero by default.
        offset: (n, 3) vector from the point of the model to the surveyed point, in metres along the
            axes of the model; zero by default.
    """

    source: Array
    target: Array
    target_covariance: Array
    source_covariance: Array = field(default_factory=lambda: np.zeros(0))
    offset: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        count = len(self.source)
        for name, shape in (("source_covariance", (count, 3, 3)), ("offset", (count, 3))):
            if getattr(self, name).size == 0:
                object.__setattr__(self, name, np.zeros(shape))

    def __len__(self) -> int:
        return len(self.source)

    def rows(self, chosen: NDArray[Any]) -> Correspondences:
        """Return the chosen rows as new correspondences."""
        return Correspondences(
            self.source[chosen],
            self.target[chosen],
            self.target_covariance[chosen],
            self.source_covariance[chosen],
            self.offset[chosen],
        )

    @staticmethod
    def joined(first: Correspondences, second: Correspondences) -> Correspondences:
        """Return the concatenation of two sets of correspondences."""
        return Correspondences(
            np.concatenate([first.source, second.source]),
            np.concatenate([first.target, second.target]),
            np.concatenate([first.target_covariance, second.target_covariance]),
            np.concatenate([first.source_covariance, second.source_covariance]),
            np.concatenate([first.offset, second.offset]),
        )
