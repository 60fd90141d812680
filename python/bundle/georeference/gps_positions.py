"""Positions of images as a file or a camera's receiver gives them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from bundle.base.display import Display, Displayed
from bundle.base.words import plural
from bundle.errors import shown

__all__ = ["EXIF_TAGS", "GpsPositions", "no_fix_notes", "with_fix"]


EXIF_TAGS = "EXIF tags"
"""Prefix of the source of positions that images have themselves."""


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

    @property
    def is_exif(self) -> bool:
        """True where receivers wrote the positions, and nobody a table."""
        return self.source.startswith(EXIF_TAGS)

    def _display(self) -> Display:
        heights = int(np.isfinite(self.geodetic[:, 2]).sum())
        own = int(np.isfinite(self.accuracy).any(axis=1).sum())
        facts = (
            ("source", f"{self.source} ({self.reference_system})"),
            ("images", f"{len(self)}, {heights} with a height, {own} with an accuracy"),
            *(("note", note) for note in self.notes),
        )
        return Display(title=f"GPS positions of {plural(len(self), 'image')}", facts=facts)


def with_fix(positions: GpsPositions) -> GpsPositions:
    """Return the positions without those at latitude and longitude 0: receivers without a fix."""
    fixed = ~(np.asarray(positions.geodetic)[:, :2] == 0).all(axis=1)
    if fixed.all():
        return positions
    without = [name for name, kept in zip(positions.names, fixed, strict=True) if not kept]
    return replace(
        positions,
        names=tuple(name for name, kept in zip(positions.names, fixed, strict=True) if kept),
        geodetic=positions.geodetic[fixed],
        accuracy=positions.accuracy[fixed],
        notes=(*positions.notes, *no_fix_notes(without, positions.source)),
    )


def no_fix_notes(names: Sequence[str], source: str) -> tuple[str, ...]:
    """Return a sentence on images whose position is 0 0, or none."""
    if not names:
        return ()
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return (
        f"{plural(len(names), 'position')} of {source} at 0 0, as receivers without a fix write: "
        f"{', '.join(map(shown, names[:3]))}{more}.",
    )
