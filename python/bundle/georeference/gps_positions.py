"""Measured positions of images from a file or from EXIF tags, and their images by name."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import field, replace

import numpy as np
from numpy.typing import NDArray

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.errors import InputError, brief, shown
from bundle.georeference.image_index import ImageIndex
from bundle.model.problem import Problem

EXIF_TAGS = "EXIF tags"
"""Prefix of the source of positions that come from the images themselves."""


@dataclass(frozen=True, eq=False, repr=False)
class GpsPositions(Displayed):
    """Measured positions of images on the earth.

    Attributes:
        names: names of the n images.
        geodetic: (n, 3) latitude, longitude [degrees] and height [m] on WGS84, or Cartesian
            coordinates [m], the third one up; the height is nan if unknown.
        accuracy: (n, 2) horizontal and vertical standard deviation [m], nan if unknown. The
            horizontal one applies to east and to north.
        reference_system: reference system of the given coordinates; None if they are Cartesian.
        source: name of the source for messages.
        notes: sentences on ignored or inexact data.
    """

    names: tuple[str, ...]
    geodetic: NDArray[np.float64]
    accuracy: NDArray[np.float64]
    reference_system: str | None
    source: str
    notes: tuple[str, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.names)

    @property
    def is_exif(self) -> bool:
        """True if the positions come from the images' EXIF tags and not from a table."""
        return self.source.startswith(EXIF_TAGS)

    def _display(self) -> Display:
        heights = int(np.isfinite(self.geodetic[:, 2]).sum())
        own = int(np.isfinite(self.accuracy).any(axis=1).sum())
        facts = (
            ("source", f"{self.source} ({self.reference_system or 'Cartesian'})"),
            ("images", f"{len(self)}, {heights} with a height, {own} with an accuracy"),
            *(("note", note) for note in self.notes),
        )
        return Display(title=f"GPS positions of {plural(len(self), 'image')}", facts=facts)


def with_fix(positions: GpsPositions) -> GpsPositions:
    """Remove positions at latitude and longitude 0, which receivers write without a fix."""
    fixed = ~(np.asarray(positions.geodetic)[:, :2] == 0).all(axis=1)
    if positions.reference_system is None or fixed.all():
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
    """Return a sentence on images whose position is 0 0; an empty tuple without such images."""
    if not names:
        return ()
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return (
        f"{plural(len(names), 'position')} of {source} at 0 0, as receivers without a fix write: "
        f"{', '.join(map(shown, names[:3]))}{more}.",
    )


def matched(index: ImageIndex, positions: GpsPositions) -> dict[int, int]:
    """Return the position of each image that has one, by rows.

    Raises:
        InputError: two positions belong to one image, or a position's name fits several images.
    """
    rows: dict[int, int] = {}
    for position, name in enumerate(positions.names):
        row = index.find(name, f"{positions.source}: ")
        if row is None:
            continue
        if row in rows:
            raise InputError(
                f"{positions.source}: expected one position for each image of the model, found "
                f"{brief(positions.names[rows[row]])} and {brief(name)} for the same image"
            )
        rows[row] = position
    return rows


def too_few(problem: Problem, positions: GpsPositions, found: int, fewest: int) -> InputError:
    """Return the error for too few positions."""
    hint = ""
    if not found and len(positions):
        here, there = shown(problem.image_names[0]), shown(positions.names[0])
        hint = f": the model has images such as {here}, the positions {there}"
    index = ImageIndex(problem)
    for name in positions.names:
        other = index.differing_in_case(name)
        if other is not None and index.find(name) is None:
            hint = (
                f": {shown(name)} differs from {shown(other)} of the model in upper and lower case"
            )
            break
    return InputError(
        f"gps: expected positions of at least {plural(fewest, 'image')} of the model, "
        f"found {found} in {positions.source}{hint}"
    )


def unmatched_notes(
    problem: Problem, index: ImageIndex, positions: GpsPositions, chosen: Iterable[int]
) -> list[str]:
    """Return sentences on images without a position, and on positions without an image."""
    with_one = set(chosen)
    without = [name for row, name in enumerate(problem.image_names) if row not in with_one]
    notes = []
    if without:
        more = f" and {len(without) - 3} more" if len(without) > 3 else ""
        notes.append(
            f"{plural(len(without), 'image')} of the model without a position: "
            f"{', '.join(map(shown, without[:3]))}{more}."
        )
    extra = [name for name in positions.names if index.find(name) is None]
    if extra:
        notes.append(f"{plural(len(extra), 'position')} of images that are not in the model.")
    notes += case_notes(index, extra)
    return notes


def case_notes(index: ImageIndex, names: Iterable[str]) -> list[str]:
    """Return a sentence on unknown names that differ from image names in case only, if any."""
    pairs = [(name, index.differing_in_case(name)) for name in dict.fromkeys(names)]
    alike = [(name, other) for name, other in pairs if other is not None]
    if not alike:
        return []
    name, other = alike[0]
    return [
        f"{plural(len(alike), 'name')} of these differ from names of the model only in "
        f"upper and lower case: {shown(name)} and {shown(str(other))}."
    ]
