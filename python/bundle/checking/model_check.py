"""Columns and statistics of the reprojection residuals of one camera model."""

from __future__ import annotations

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.checking.evidence import Finding
from bundle.checking.jacobian_deviation import Array
from bundle.checking.residual_blocks import Block, Column
from bundle.checking.tally import MOST_KEPT, Tally
from bundle.model.cameras import camera_models, param_kinds

POSE = tuple(f"{part} {axis}" for part in ("rotation", "translation") for axis in "xyz")
TWIST = tuple(f"twist {part}{axis}" for part in "wv" for axis in "xyz")
POINT = ("point x", "point y", "point z")


@dataclass(eq=False)
class ModelCheck:
    """Check of the observations of one camera model.

    Attributes:
        name: COLMAP's name of the model.
        source: columns of the core's Jacobian that belong to this model.
        tally: statistics of its Jacobians.
        offsets: by observation, the rotation vector at which it was checked.
        findings: mistakes found so far.
        num_params: number of the model's parameters.
        wrong: observations with a mistake, at most MOST_KEPT.
        right: observations without a mistake, at most MOST_KEPT.
    """

    name: str
    source: NDArray[np.intp]
    tally: Tally
    offsets: dict[int, Array] = field(default_factory=dict)
    num_params: int = 0
    findings: list[Finding] = field(default_factory=list)
    wrong: list[int] = field(default_factory=list)
    right: list[int] = field(default_factory=list)

    @staticmethod
    def make(name: str, tolerance: float, *, rolls: bool = False) -> ModelCheck:
        """Return an empty check with the columns of a camera model, and of twists if it rolls."""
        params = camera_models()[name]
        columns = [Column(text, text.partition(" ")[0]) for text in POSE]
        columns += [
            Column(f"{name} {param}", kind.replace("_", " "))
            for param, kind in zip(params, param_kinds(name), strict=True)
        ]
        after = [Column(text, "twist") for text in TWIST if rolls]
        after += [Column(text, "point") for text in POINT]
        source = np.arange(len(columns) + len(after))
        source[len(columns) :] = np.arange(-len(after), 0)  # after columns of other models
        check = ModelCheck(name, source, Tally(columns + after, tolerance))
        check.num_params = len(params)
        return check

    def look_at(self, wrong: NDArray[np.int64], right: NDArray[np.int64]) -> None:
        """Keep some observations for a page."""
        for kept, new in ((self.wrong, wrong), (self.right, right)):
            kept += new[: max(MOST_KEPT - len(kept), 0)].tolist()

    @property
    def looked_at(self) -> list[int]:
        """Observations of which a page shows the errors."""
        return self.wrong + self.right

    @property
    def blocks(self) -> list[Block]:
        """Blocks of columns for the signatures."""
        size = len(self.tally.columns)
        return [
            Block("rotation", 0, 3, "vector"),
            Block("rotation", 0, 3, "tangent"),
            Block("translation", 3, 6),
            Block("pose", 0, 6),
            Block(f"{self.name} parameters", 6, 6 + self.num_params),
            *([Block("twist", size - 9, size - 3)] if size > 9 + self.num_params else []),
            Block("point", size - 3, size),
        ]
