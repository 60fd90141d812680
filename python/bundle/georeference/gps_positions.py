"""Positions of images as a file or a camera's receiver gives them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bundle.display import Display, Displayed
from bundle.words import plural

__all__ = ["GpsPositions"]


@dataclass(frozen=True, eq=False, repr=False)
class GpsPositions(Displayed):
    """Measured positions of images on the earth.

    Attributes:
        names: n names of images.
        geodetic: (n, 3) latitude, longitude [degrees] and height [m] on WGS84; height nan where it
            is unknown.
        accuracy: (n, 2) horizontal and vertical standard deviation [m], nan where the source has
            none. The horizontal one is that of east and of north.
        reference_system: the coordinates came in it.
        source: where they came from, as messages name it.
        notes: sentences on what was ignored or is inexact.
    """

    names: tuple[str, ...]
    geodetic: NDArray[np.float64]
    accuracy: NDArray[np.float64]
    reference_system: str
    source: str
    notes: tuple[str, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.names)

    def _display(self) -> Display:
        heights = int(np.isfinite(self.geodetic[:, 2]).sum())
        own = int(np.isfinite(self.accuracy).any(axis=1).sum())
        facts = (
            ("source", f"{self.source} ({self.reference_system})"),
            ("images", f"{len(self)}, {heights} with a height, {own} with an accuracy"),
            *(("note", note) for note in self.notes),
        )
        return Display(title=f"GPS positions of {plural(len(self), 'image')}", facts=facts)
