"""Positions and the images of a model that they belong to, by name."""

from __future__ import annotations

from collections.abc import Iterable

from bundle.base.words import plural
from bundle.errors import InputError, brief, shown
from bundle.georeference.gps_positions import GpsPositions
from bundle.georeference.image_index import ImageIndex
from bundle.model.problem import Problem

__all__ = ["case_notes", "matched", "too_few", "unmatched_notes"]


def matched(index: ImageIndex, positions: GpsPositions) -> dict[int, int]:
    """Return the position of each image that has one, by their rows.

    Raises:
        InputError: two positions are of one image, or two images have the name of one.
    """
    rows: dict[int, int] = {}
    for position, name in enumerate(positions.names):
        row = index.find(name, f"{positions.source}: ")
        if row is None:
            continue
        if row in rows:
            raise InputError(
                f"{positions.source}: expected one position for each image of the model, found "
                f"{brief(positions.names[rows[row]])} and {brief(name)} for the same one"
            )
        rows[row] = position
    return rows


def too_few(problem: Problem, positions: GpsPositions, found: int, fewest: int) -> InputError:
    """Return the error of positions that are not enough."""
    hint = ""
    if not found and len(positions):
        here, there = shown(problem.image_names[0]), shown(positions.names[0])
        hint = f": the model has images such as {here}, the positions {there}"
    index = ImageIndex(problem)
    for name in positions.names:
        other = index.differing_in_case(name)
        if other is not None and index.find(name) is None:
            hint = f": {shown(name)} differs from {shown(other)} of the model in its case"
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
        notes.append(f"{plural(len(extra), 'position')} of images that the model does not have.")
    notes += case_notes(index, extra)
    return notes


def case_notes(index: ImageIndex, names: Iterable[str]) -> list[str]:
    """Return a sentence on names, not found, that differ from images' in their case, or none."""
    pairs = [(name, index.differing_in_case(name)) for name in dict.fromkeys(names)]
    alike = [(name, other) for name, other in pairs if other is not None]
    if not alike:
        return []
    name, other = alike[0]
    return [
        f"{plural(len(alike), 'name')} of these differ from names of the model in case only, which "
        f"counts: {shown(name)} for {shown(str(other))}."
    ]
