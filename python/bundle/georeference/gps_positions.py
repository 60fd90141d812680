"""Measured positions of images: geo.txt, tables, COLMAP's database, OpenSfM; images by name."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import few, plural
from bundle.errors import InputError, brief, shown
from bundle.georeference.control_point import Sigma
from bundle.georeference.local_frame import LocalFrame, frame_of
from bundle.georeference.reference_system import ReferenceSystem
from bundle.georeference.text_lines import (
    LOCAL,
    UNIT,
    ImageIndex,
    parse_number,
    read_lines,
    read_table,
    system_of,
)
from bundle.io.database_images import open_database
from bundle.io.formats.file_values import Node, parsed, read_json
from bundle.model.problem import Problem

EXIF_TAGS = "EXIF tags"  # prefix of the source of positions that come from the images themselves


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

    def exchanged(self) -> GpsPositions | None:
        """Return the positions with the first two given coordinates swapped; None if invalid."""
        if self.reference_system is None:
            return None
        geodetic = ReferenceSystem(self.reference_system).exchanged(self.geodetic)
        return None if geodetic is None else replace(self, geodetic=geodetic)

    def with_sigmas(self, default: Sigma, scale: Sigma) -> GpsPositions:
        """Return the positions with the given or default standard deviations times a factor."""
        own = np.where(np.isnan(self.accuracy), default, self.accuracy)
        return replace(self, accuracy=own * scale)

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
    note = (
        f"{plural(len(names), 'position')} of {source} at 0 0, as receivers without a fix write: "
    )
    return (f"{note}{few(map(shown, names))}.",) * bool(names)


def matched(index: ImageIndex, positions: GpsPositions) -> dict[int, int]:
    """Return the position of each image that has one, by rows."""
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
    notes = [*counted_images(without, "of the model without a position")]
    extra = [name for name in positions.names if index.find(name) is None]
    if extra:
        notes.append(f"{plural(len(extra), 'position')} of images that are not in the model.")
    notes += case_notes(index, extra)
    return notes


def counted_images(names: list[str], what: str) -> tuple[str, ...]:
    """Return a note that counts images and names three of them; empty without any."""
    return (f"{plural(len(names), 'image')} {what}: {few(map(shown, names))}.",) * bool(names)


def case_notes(index: ImageIndex, names: Iterable[str]) -> list[str]:
    """Return a sentence on unknown names that differ from image names only in case, if any."""
    pairs = [(name, index.differing_in_case(name)) for name in dict.fromkeys(names)]
    alike = [(name, other) for name, other in pairs if other is not None]
    if not alike:
        return []
    name, other = alike[0]
    return [
        f"{plural(len(alike), 'name')} of these differ from names of the model only in "
        f"upper and lower case: {shown(name)} and {shown(str(other))}."
    ]


# OpenDroneMap's image geolocation file, ``geo.txt``, and tables; docs/positions.md describes both.
#
# Numbers of geo.txt are identified by position, as in OpenDroneMap; an incomplete group at the end
# of a line does not belong to the format. Angles are checked and not used: the images determine the
# attitude better.
#
# Source: https://docs.opendronemap.org/geo/ and ``opendm/geo.py`` of OpenDroneMap.

TITLES = {
    "image": "image imagename sourcefile label filename name file photo",
    "x": "longitude xlongitude gpslongitude lon lng long easting xeasting xeast east rechtswert x",
    "y": "latitude ylatitude gpslatitude lat northing ynorthing ynorth north hochwert y",
    "z": "ellipsoidalheight altitude zaltitude gpsaltitude alt height elevation höhe hoehe z",
    **{angle: angle for angle in ("yaw", "pitch", "roll")},
    "horizontal accuracy": "horizontalaccuracy accuracyhorizontal accuracyhorz hacc accuracyxy "
    "hrms sigmah sigmaxy sigmax sde accuracyxyz accuracy sigma",
    "vertical accuracy": "verticalaccuracy accuracyvertical accuracyvert vacc accuracyz "
    "vrms sigmav sigmaz sdu accuracyxyz accuracy sigma",
}
"""Words of a line of geo.txt, with the letters of their titles in tables, preferred ones first."""
_METRES = {"us": 1200 / 3937, "ft": 0.3048, "cm": 0.01, "mm": 0.001, None: 1.0}
_METASHAPE = re.compile(r'CoordinateSystem: .*AUTHORITY\["EPSG","(\d+)"\]\]$')


def read_geo_file(path: str | os.PathLike[str]) -> GpsPositions:
    """Read the positions of images from OpenDroneMap's geo.txt, or from a table.

    Raises:
        InputError: the reference system is unknown, a column is missing, a line has missing or
            non-numeric values, an image has two lines, or a position is outside the system's area.
            The message is one line with file, line number, expected and found.
        OSError: the file cannot be read.
    """
    name = shown(path)
    system, lines, table, notes = read_positions(path, TITLES)
    fixed = np.ones(len(table), bool) if system is None else ~system.is_no_fix(table[:, :3])
    without = [image for image, has_fix in zip(lines, fixed, strict=True) if not has_fix]
    images = tuple(image for image, has_fix in zip(lines, fixed, strict=True) if has_fix)
    geodetic, accuracy = table[fixed, :3], table[fixed, 3:]
    if system is not None:
        geodetic = system.to_geodetic(geodetic, [f"{name}: line {lines[one]}" for one in images])
        notes += [*system.notes, *system.area_notes(geodetic), *no_fix_notes(without, name)]
    return GpsPositions(
        names=images,
        geodetic=geodetic,
        accuracy=accuracy,
        reference_system=None if system is None else system.name.strip("'\" "),
        source=name,
        notes=tuple(notes),
    )


def read_positions(
    path: str | os.PathLike[str], known: Mapping[str, str]
) -> tuple[ReferenceSystem | None, dict[str, int], NDArray[np.float64], list[str]]:
    """Return the reference system, the line of each name, its numbers, and notes.

    ``known``: as ``TITLES``. Numbers: (n, 5) x, y, z in units of the system, two accuracies [m].
    """
    what, name = next(iter(known)), shown(path)
    wanted = f": add a first line with the system of {what} east north height, such as EPSG:25832, "
    wanted += f"or titles such as {what},latitude,longitude,height"
    titled = _table(path, known)
    system, lines, titles, notes = titled or (*read_lines(path, 0, wanted), [*known], [])
    seen: dict[str, int] = {}
    rows: list[NDArray[np.float64]] = []
    odd = 0
    for number, words in lines:
        place = f"{name}: line {number}"
        rows.append(_row(place, words, titles))
        if words[0] in seen:
            raise InputError(
                f"{place}: expected one line for each {what}, found {brief(words[0])} again (first "
                f"in line {seen[words[0]]})"
            )
        seen[words[0]] = number
        odd += len(words) in (5, 6, 8)
    if not rows:
        raise InputError(f"{name}: expected {what}s after the first line, found 0")
    table = np.array(rows)
    units = [*([1.0] * 3 if system is None else system.units), 1.0, 1.0]
    used = [titles[column] for column in (1, 2, 3, 7, 8)]
    factors = np.array([*map(_factor, used, units)])
    table *= factors
    changed = np.flatnonzero((factors != 1) & np.isfinite(table).any(axis=0))
    if len(changed):
        columns = few(dict.fromkeys(shown(used[column]) for column in changed))
        notes.append(f"Columns of {name} that are converted from the units of titles: {columns}.")
    if odd:
        notes.append(
            f"{plural(odd, 'line')} of {name} have numbers after the height that are neither three "
            "angles nor three angles and two accuracies; they are ignored."
        )
    return system, seen, table, notes


def _factor(title: str, unit: float) -> float:
    """Return the factor from the unit that a title names to the unit of its axis, both [m]."""
    metres = _METRES[found.lastgroup] if (found := UNIT.search(title)) else unit
    is_same = unit < 0.1 or abs(metres / unit - 1) < 1e-5  # degrees; the two feet
    return 1.0 if is_same else metres / unit


def _row(place: str, words: list[str], titles: list[str]) -> NDArray[np.float64]:
    """Return x, y, z and the two accuracies; nan if missing."""
    if len(words) < 3:
        raise InputError(
            f"{place}: expected {titles[0]} x y [z] [yaw pitch roll] [h-acc v-acc], "
            f"found {brief(' '.join(words))}"
        )
    row = np.full(len(TITLES), np.nan)
    end = 9 if len(words) >= 9 else 7 if len(words) >= 7 else 4
    for column, word in enumerate(words[1:end], 1):
        row[column] = parse_number(place, titles[column], word, unknown=column > 2)
        if column > 6 and row[column] <= 0:
            raise InputError(f"{place}: {titles[column]}: expected a number above 0, found {word}")
    return row[[1, 2, 3, 7, 8]]


def _table(
    path: str | os.PathLike[str], known: Mapping[str, str]
) -> tuple[ReferenceSystem | None, list[tuple[int, list[str]]], list[str], list[str]] | None:
    """Return reference system, words of geo.txt, their titles, and notes; None without titles."""
    table = read_table(path, known)
    if table is None:
        return None
    place, _, titles, letters, columns, *_ = table
    hemispheres = [k for k, title in enumerate(letters) if re.search("l(at|ong)ituderef$", title)]
    systems = ["EPSG:4326"] * bool(re.search("lon|lng", letters[columns[1]]))
    for line in table.above:
        code = _METASHAPE.search(line)
        systems += [f"EPSG:{code[1]}"] if code else [line] * (line[0] != "#")
    if min(columns[:3]) < 0 or not systems:
        what = next(iter(known))
        raise InputError(
            f"{place}: expected columns {what}, longitude and latitude, or {what}, x and y below a "
            f"line with their reference system such as EPSG:32632 or {LOCAL}, found {few(titles)}"
        )
    rows = []
    for number, fields in table.rows:
        name, *numbers = (fields[column] if column >= 0 else "" for column in columns)
        for column in hemispheres:
            axis = int("lat" in letters[column])
            if numbers[axis] and fields[column][:1] in tuple("SsWw"):  # South, West
                numbers[axis] = f"-{numbers[axis].lstrip('-')}"
        if any(numbers[:2]):
            words = [number.replace(",", table.comma) or "nan" for number in numbers]
            rows.append((number, [name, *words]))
    used = {*columns, *hemispheres}
    unused = [title for column, title in enumerate(titles) if title and column not in used]
    note = f"Columns of {shown(path)} without a use: {few(map(shown, unused))}."
    used_titles = [titles[column] for column in columns]
    return system_of(place, systems[-1]), rows, used_titles, [note] * bool(unused)


# GPS positions of COLMAP's database: the table pose_priors.
#
# A prior in WGS84 (coordinate_system 0) has latitude, longitude and height, and a covariance in
# metres of east, north, up, where it is known; a Cartesian one (1) has x, y, z in metres, z up. The
# table of COLMAP 4 refers to an image by corr_data_id, that of COLMAP 3.10 and 3.11 by image_id.
# Blobs are doubles, nan where unknown.
#
# Source: src/colmap/scene/database_sqlite.cc and geometry/pose_prior.h of COLMAP.

_WGS84 = 0
_CARTESIAN = 1
_SYSTEMS = {-1: "undefined", _WGS84: "WGS84", _CARTESIAN: "Cartesian"}
_CAMERA = 0  # corr_sensor_type of a camera; an IMU has another one


def read_database_gps(path: Path) -> GpsPositions:
    """Read the positions of the images of a COLMAP database."""
    name = shown(path)
    with open_database(path) as database:
        columns = [row[1] for row in database.execute("PRAGMA table_info(pose_priors)")]
        if "position" not in columns:
            raise InputError(
                f"{name}: expected COLMAP's table pose_priors, found a database without it"
            )
        key = "corr_data_id" if "corr_data_id" in columns else "image_id"
        of_cameras = f" AND corr_sensor_type = {_CAMERA}" if "corr_sensor_type" in columns else ""
        rows = database.execute(
            "SELECT images.name, position, position_covariance, coordinate_system "
            f"FROM pose_priors JOIN images ON images.image_id = pose_priors.{key}{of_cameras} "
            "ORDER BY images.image_id"
        ).fetchall()
    names, geodetic, accuracy, without, common = [], [], [], 0, None
    for image, position, covariance, system in rows:
        place = f"{name}: pose_priors: {shown(str(image))}"
        where = _doubles(position, 3, f"{place}: position")
        if not np.isfinite(where[:2]).all():
            without += 1
            continue
        common = system if common is None else common
        if system not in (_WGS84, _CARTESIAN) or system != common:
            found = _SYSTEMS.get(system, brief(system))
            wanted = "WGS84 or Cartesian" if common == system else f"{_SYSTEMS.get(common)}"
            raise InputError(f"{place}: expected {wanted} coordinates, found {found}")
        if system == _WGS84 and (abs(where[0]) > 90 or abs(where[1]) > 360):
            raise InputError(
                f"{place}: expected latitude and longitude in degrees, found {where[0]:g}, "
                f"{where[1]:g}"
            )
        variances = np.diag(_doubles(covariance, 9, f"{place}: position_covariance").reshape(3, 3))
        known = (variances > 0) & np.isfinite(variances)
        horizontal = np.sqrt(variances[:2].mean()) if known[:2].all() else np.nan
        vertical = np.sqrt(variances[2]) if known[2] else np.nan
        names.append(str(image))
        geodetic.append(where)
        accuracy.append((horizontal, vertical))
    if not names:
        raise InputError(f"{name}: expected positions in pose_priors, found 0")
    return GpsPositions(
        tuple(names),
        np.array(geodetic),
        np.array(accuracy),
        reference_system="WGS84" if common == _WGS84 else None,
        source=name,
        notes=(f"{plural(without, 'pose prior')} without a position.",) * (without > 0),
    )


def _doubles(blob: object, count: int, place: str) -> NDArray[np.float64]:
    """Return the numbers of a blob; nan without one."""
    if blob is None:
        return np.full(count, np.nan)
    if not isinstance(blob, bytes) or len(blob) != 8 * count:
        found = f"{len(blob)} bytes" if isinstance(blob, bytes) else brief(blob)
        raise InputError(f"{place}: expected {8 * count} bytes, found {found}")
    return np.frombuffer(blob, "<f8")


# Positions of an OpenSfM project.
#
# ``gps_position`` of a shot is the measured position in the frame of its reconstruction
# (``opensfm_frame.py``), and ``gps_dop`` the standard deviation in metres that OpenSfM gives it.

RECONSTRUCTION = "reconstruction.json"
REFERENCE = "reference_lla.json"
_NO_POINTS = 2**31  # an entry that no file has: the reader skips all points
_NO_FIX = 1e5  # gps_dop in metres from which a shot has no position; OpenSfM writes 999999


def read_opensfm_gps(path: Path) -> GpsPositions:
    """Read the GPS positions of the shots of reconstruction.json, or of the project's folder."""
    file = path / RECONSTRUCTION if path.is_dir() else path
    node = parsed(_core.read_opensfm(file, _NO_POINTS)["rest"], file)
    rows: dict[str, tuple[Any, float]] = {}
    without = 0
    for reconstruction in node.entries("OpenSfM's reconstructions, or a table (CSV)"):
        frame = None
        for name, shot in reconstruction.get("shots").items():
            position, dop = shot.find("gps_position"), shot.find("gps_dop")
            if position is None or position.value is None:
                continue
            sigma = np.nan if dop is None or dop.value is None else dop.number()
            if not sigma < _NO_FIX and not np.isnan(sigma):
                without += 1
                continue
            if sigma <= 0:
                shot.get("gps_dop").fail("metres above 0")
            frame = frame or _reference(reconstruction, file)
            rows[name] = (frame.to_geodetic(position.numbers(3))[0], sigma)
    if not rows:
        raise InputError(f"{shown(file)}: expected shots with gps_position, found 0")
    return GpsPositions(
        names=tuple(rows),
        geodetic=np.array([position for position, _ in rows.values()]),
        accuracy=np.array([(sigma, sigma) for _, sigma in rows.values()]),
        reference_system="WGS84",
        source=shown(file),
        notes=(f"{plural(without, 'shot')} without a GPS fix (gps_dop above {_NO_FIX:g} m).",)
        * (without > 0),
    )


def _reference(reconstruction: Node, file: Path) -> LocalFrame:
    """Return the frame of a reconstruction: its reference_lla, or that of the file beside it."""
    node = reconstruction.find("reference_lla")
    beside = file.parent / REFERENCE
    if (node is None or node.value is None) and beside.is_file():
        node = read_json(beside)
    if node is None or node.value is None:
        raise InputError(
            f"{reconstruction.place}: expected reference_lla, the origin of gps_position, here or "
            f"in {REFERENCE}, found no such member or file"
        )
    return frame_of(node)
