"""OpenDroneMap's image geolocation file, ``geo.txt``.

The first line is the coordinate reference system, every other line an image::

    EPSG:4326
    # image         x            y          z       yaw pitch roll  h-acc v-acc
    DJI_0028.JPG    -91.9942096  46.8425213 198.609
    DJI_0032.JPG    -91.9938293  46.8424584 198.609 0   0     0     0.02  0.03

Numbers are identified by position, as in OpenDroneMap: accuracies follow the three angles, and an
incomplete group at the end of a line does not belong to the format. x is east or longitude, y north
or latitude; 0 and 0 mean a receiver without a fix. With the first line ``LOCAL``, coordinates are
metres in a frame of their own, its third axis up, and 0 and 0 a position like any other. A name
with blanks is in quotes, or between tabs if tabs separate all fields. Angles are checked and not
used: they have no effect on a position, and the images determine the attitude better.

Source: https://docs.opendronemap.org/geo/ and ``opendm/geo.py`` of OpenDroneMap.
"""

from __future__ import annotations

import os

import numpy as np

from bundle.base.words import plural
from bundle.errors import InputError, brief, shown
from bundle.georeference.gps_positions import GpsPositions, no_fix_notes
from bundle.georeference.odm_lines import parse_number, read_lines

_ANGLES = ("yaw", "pitch", "roll")
_ACCURACIES = ("horizontal accuracy", "vertical accuracy")


def read_geo_file(path: str | os.PathLike[str]) -> GpsPositions:
    """Read the positions of images from OpenDroneMap's geo.txt.

    Raises:
        InputError: the reference system is unknown, a line has missing or non-numeric values, an
            image has two lines, or a position is outside the system's area. The message is one
            line with file, line number, expected and found.
        OSError: the file cannot be read.
    """
    system, lines = read_lines(path, name_at=0)
    name = shown(path)
    seen: dict[str, int] = {}
    rows: list[list[float]] = []
    odd = 0
    for number, words in lines:
        place = f"{name}: line {number}"
        rows.append(_row(place, words))
        image = words[0]
        if image in seen:
            raise InputError(
                f"{place}: expected one line for each image, found {brief(image)} again (first "
                f"in line {seen[image]})"
            )
        seen[image] = number
        odd += len(words) in (5, 6, 8)
    if not rows:
        raise InputError(f"{name}: expected images after the first line, found 0")
    table = np.array(rows)
    lines_of = np.array(list(seen.values()))
    fixed = np.ones(len(table), bool) if system is None else ~system.is_no_fix(table[:, :3])
    without = [image for image, has_fix in zip(seen, fixed, strict=True) if not has_fix]
    images = tuple(image for image, has_fix in zip(seen, fixed, strict=True) if has_fix)
    table, lines_of = table[fixed], lines_of[fixed]
    geodetic, notes = table[:, :3], []
    if system is not None:
        geodetic = system.to_geodetic(geodetic, [f"{name}: line {line}" for line in lines_of])
        notes = [*system.notes, *system.area_notes(geodetic), *no_fix_notes(without, name)]
    if odd:
        notes.append(
            f"{plural(odd, 'line')} of {name} have numbers after the height that are "
            "neither three angles nor three angles and two accuracies; they are ignored."
        )
    return GpsPositions(
        names=images,
        geodetic=geodetic,
        accuracy=table[:, 3:],
        reference_system=None if system is None else system.name.strip("'\" "),
        source=name,
        notes=tuple(notes),
    )


def _row(place: str, words: list[str]) -> list[float]:
    """Return x, y, z and the two accuracies; nan if missing."""
    if len(words) < 3:
        raise InputError(
            f"{place}: expected image x y [z] [yaw pitch roll] [h-acc v-acc], "
            f"found {brief(' '.join(words))}"
        )
    x, y = (parse_number(place, name, word) for name, word in zip("xy", words[1:3], strict=True))
    z = parse_number(place, "z", words[3], unknown=True) if len(words) > 3 else np.nan
    accuracies = [np.nan, np.nan]
    if len(words) >= 7:
        for name, word in zip(_ANGLES, words[4:7], strict=True):
            parse_number(place, name, word, unknown=True)
    if len(words) >= 9:
        accuracies = [
            parse_number(place, name, word, unknown=True)
            for name, word in zip(_ACCURACIES, words[7:9], strict=True)
        ]
        for name, accuracy in zip(_ACCURACIES, accuracies, strict=True):
            if accuracy <= 0:
                raise InputError(
                    f"{place}: {name}: expected metres above 0, or nan, found {accuracy:g}"
                )
    return [x, y, z, *accuracies]
