"""Ground control points of files; docs/align.md describes the formats.

ODM's ``gcp_list.txt`` has lines ``x y z px py image [label] [extras]``; lines with equal
coordinates are one target, as in ODM, labelled or not. In ODM the centre of the first pixel is
(0, 0): OpenSfM, which reads the list for it, normalizes x by (x + 0.5 - width / 2) / max(width,
height) (``opensfm.features.normalized_image_coordinates``). Here, as in COLMAP, this centre is
(0.5, 0.5): half a pixel is added to each coordinate. ODM ignores everything after the image's name,
also the extras: ``sigma=H[/V]``, ``check``, ``pixel_sigma=PX``.

``ground_control_points.json`` of an OpenSfM project has latitudes and longitudes, and measurements
in normalised coordinates: pixels from the centre over max(width, height).

Tables have marks in pixels from the upper left corner, as Pix4D's: "(0, 0) is the top left corner
of the top left pixel" (Open Photogrammetry Format, control points). The names of points tell orders
without titles apart; points need titles, because Pix4D's have latitude or longitude first.
Metashape's XML of markers has both: ids and labels of cameras and markers, ``reference`` of each
marker, its ``location`` in cameras, and the WKT of the reference system.
"""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterable, Iterator
from dataclasses import field, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import at, check_distinct, check_type
from bundle.base.paths import as_path, is_path
from bundle.base.records import dataclass
from bundle.base.words import few, plural
from bundle.errors import InputError, brief, nearest, shown
from bundle.georeference.control_point import (
    GroundControlPoint,
    Measurement,
    Sigma,
    parse_pixel_sigma,
    parse_sigma,
)
from bundle.georeference.gps_positions import TITLES, read_positions
from bundle.georeference.local_frame import is_opensfm
from bundle.georeference.reference_system import ReferenceSystem
from bundle.georeference.text_lines import (
    LOCAL,
    ImageIndex,
    content_lines,
    parse_number,
    read_lines,
    read_table,
    system_of,
)
from bundle.io.formats.file_values import Node, read_json
from bundle.model.problem import Problem

PIXEL_SHIFT = 0.5
"""Shift from pixel coordinates with origin at the centre of the first pixel to COLMAP's."""

CHECK = "check"
POINTS, LIST = "ground_control_points.json", "gcp_list.txt"
"""Files of an OpenSfM project."""
_EPSG = re.compile(r'AUTHORITY\["EPSG",\s*"(\d+)"\]\]$')
_ROW = ("x", "y", "z", "horizontal accuracy", "vertical accuracy")
_TRUE = ("1", "true")  # values of Metashape's attributes
_KEYS = ("sigma", "pixel_sigma")
_FIELDS = "x y z px py image [label]"
_BOTH = "; of tables give both: POINTS,MARKS"
_MARKS = {
    "image": "image imagename camera cameraname cameralabel photo photoname filename file",
    "point": "point pointname pointlabel marker markername markerlabel gcp gcpname gcplabel target "
    "targetname punktnummer punkt label name",
    "px": "px pixelx xpixel xpx imagex ximage imageu u column x",
    "py": "py pixely ypixel ypx imagey yimage imagev v row y",
}
"""Columns of marks, with the letters of their titles, preferred ones first."""
_POINTS = {"label": f"{_MARKS['point']} id"} | {k: v for k, v in TITLES.items() if k != "image"}
_ORDERS = [0, 1, 2, 3], [1, 0, 2, 3], [0, 3, 1, 2]
"""Columns of image, point, px and py in tables of marks without titles."""

_Found = tuple[tuple[GroundControlPoint, ...], tuple[str, ...]]  # with notes
_Markers = tuple[
    ReferenceSystem | None, dict[str, str], NDArray[np.float64], list[str], list[list[str]]
]
"""System, place of each name, (n, 5) as :func:`read_positions`, check points, marks."""


@dataclass
class _Target:
    """Values of a target in the lines so far."""

    position: tuple[float, float, float]
    line: int
    name: str = ""
    sigma: Sigma | None = None
    role: str = "control"
    measurements: dict[str, Measurement] = field(default_factory=dict)


def read_gcp_list(path: str | os.PathLike[str]) -> tuple[GroundControlPoint, ...]:
    """Read the ground control points of a file; unnamed ones become "target 1" and so on.

    Raises:
        InputError: the content does not follow the format; the message is one line with file and
            line number.
        OSError: the file cannot be read.
    """
    path = as_path(path)
    wanted = f"; then a line for each mark in an image: {_FIELDS}{_BOTH}"
    system, rows = read_lines(path, name_at=5, wanted=wanted)
    targets: dict[tuple[str, ...], _Target] = {}
    for line, words in rows:
        _read_line(f"{shown(path)}: line {line}", line, words, targets)
    if not targets:
        raise InputError(f"{shown(path)}: expected lines of {_FIELDS}, found 0")
    _name_targets(path, targets)
    places = [f"{shown(path)}: line {target.line}" for target in targets.values()]
    if system is not None:
        system.to_geodetic(np.array([target.position for target in targets.values()]), places)
    return tuple(
        GroundControlPoint(
            name=target.name,
            position=target.position,
            measurements=tuple(target.measurements.values()),
            sigma=target.sigma,
            role=target.role,
            reference_system=None if system is None else system.name,
        )
        for target in targets.values()
    )


def _read_line(
    place: str, line: int, words: list[str], targets: dict[tuple[str, ...], _Target]
) -> None:
    if len(words) < 6:
        raise InputError(f"{place}: expected {_FIELDS}, found {plural(len(words), 'word')}{_BOTH}")
    x, y, z, px, py = (
        parse_number(place, name, word, unknown=name == "z")
        for name, word in zip(("x", "y", "z", "px", "py"), words[:5], strict=True)
    )
    # Equal numbers in any notation; nan is equal to nan.
    target = targets.setdefault(tuple(map(repr, (x, y, z))), _Target((x, y, z), line))
    label, settings, check = _extras(place, words[6:])
    if check:
        target.role = "check"
    if label and target.name not in ("", label):
        raise InputError(
            f"{place}: expected label {target.name}, because line {target.line} has the same "
            f"coordinates, found {brief(label)}"
        )
    target.name = target.name or label
    if "sigma" in settings:
        sigma = parse_sigma(f"{place}: sigma", settings["sigma"])
        if target.sigma not in (None, sigma):
            raise InputError(
                f"{place}: sigma: expected the value of an earlier line of the same target, "
                f"found {settings['sigma']}"
            )
        target.sigma = sigma
    pixel_sigma = None
    if "pixel_sigma" in settings:
        found = parse_number(place, "pixel_sigma", settings["pixel_sigma"])
        pixel_sigma = parse_pixel_sigma(f"{place}: pixel_sigma", found)
    image = words[5]
    if image in target.measurements:
        raise InputError(
            f"{place}: expected one measurement of a target per image, found a second measurement "
            f"in {brief(image)}"
        )
    target.measurements[image] = Measurement(image, px + PIXEL_SHIFT, py + PIXEL_SHIFT, pixel_sigma)


def _extras(place: str, words: list[str]) -> tuple[str, dict[str, str], bool]:
    """Return the label, the settings, and True if the target is marked as a check point."""
    settings: dict[str, str] = {}
    others: list[str] = []
    for word in words:
        key, equals, value = word.partition("=")
        if not equals:
            others.append(word)
        elif key in _KEYS:
            settings[key] = value
        else:
            meant = nearest(key, _KEYS) or f"; expected {' or '.join(_KEYS)}"
            raise InputError(f"{place}: there is no setting {brief(key)}{meant}")
    labels = [word for word in others if word != CHECK]
    return labels[0] if labels else "", settings, len(labels) < len(others)


def _name_targets(path: Path, targets: dict[tuple[str, ...], _Target]) -> None:
    """Name the targets without a label, and refuse a label that two places have."""
    lines: dict[str, int] = {}
    for index, target in enumerate(targets.values(), start=1):
        target.name = target.name or f"target {index}"
        if target.name in lines:
            raise InputError(
                f"{shown(path)}: line {target.line}: label {target.name} has other coordinates "
                f"in line {lines[target.name]}"
            )
        lines[target.name] = target.line


def read_opensfm_gcps(path: Path, problem: Problem) -> tuple[GroundControlPoint, ...]:
    """Read ground_control_points.json; of a project's folder, this file and gcp_list.txt.

    ``problem``: problem with the sizes of the images. Other images are ignored, as in OpenSfM.
    """
    if not path.is_dir():
        return _control_points(read_json(path), problem)
    points: tuple[GroundControlPoint, ...] = ()
    if (path / POINTS).is_file():
        points += _control_points(read_json(path / POINTS), problem)
    if (path / LIST).is_file():
        points += read_gcp_list(path / LIST)
    if not points:
        raise InputError(
            f"{shown(path)}: expected {POINTS} or {LIST} in the folder, found no such file"
        )
    return points


def _control_points(node: Node, problem: Problem) -> tuple[GroundControlPoint, ...]:
    index = ImageIndex(problem, f"{node.place}: ")
    points = []
    for point in node.get("points").entries():
        position = point.find("position")
        if position is None or not position.value:
            continue  # a tie point without coordinates
        height = position.find("altitude")
        x, y = position.get("longitude").number(), position.get("latitude").number()
        z = np.nan if height is None or height.value is None else height.number()
        measurements = {}
        for seen in point.get("observations").entries():
            row = index.find(seen.get("shot_id").text(), f"{seen.place}: ")
            if row is None or seen.find("projection") is None:
                continue
            size = problem.camera_sizes[problem.image_camera[row]]
            if not size.all():
                seen.fail("an image of known size (--image-size W,H)")
            if row in measurements:
                seen.fail("one measurement of a point per image")
            u, v = (seen.get("projection").numbers(2) * size.max() + size / 2).tolist()
            measurements[row] = Measurement(problem.image_names[row], u, v)
        role = point.find("role")
        is_check = role is not None and "metrics" in str(role.value).lower()
        with at(point.place):
            found = GroundControlPoint(
                name=str(point.get("id").value),
                position=(x, y, z),
                measurements=tuple(measurements.values()),
                role="check" if is_check else "control",
                reference_system="WGS84",
            )
        points.append(found)
    if not points:
        raise InputError(f"{node.place}: expected points with a position, found 0")
    return tuple(points)


def read_gcp_tables(points: Path, marks: Path | None = None) -> _Found:
    """Read control points from tables of points and of marks, or from Metashape's XML of both."""
    if marks is None:
        system, places, table, checks, pairs = _read_markers(points)
        notes: list[str] = []
    else:
        system, lines, table, notes = read_positions(points, _POINTS)
        places = {name: f"{shown(points)}: line {line}" for name, line in lines.items()}
        checks, pairs = [], [*_read_marks(marks, lines)]
    if system is not None:
        system.to_geodetic(table[:, :3], [*places.values()])
    measurements: dict[str, dict[str, Measurement]] = {name: {} for name in places}
    for place, image, name, *pixel in pairs:
        if name not in places:
            meant = nearest(name, [*places]) or f"; expected some of {few(map(shown, places))}"
            raise InputError(f"{place}: {shown(points)} has no point {brief(name)}{meant}")
        if image in measurements[name]:
            twice = f"a second one of {brief(name)} in {brief(image)}"
            raise InputError(f"{place}: expected one mark of a point per image, found {twice}")
        px, py = (parse_number(place, *one) for one in zip(("px", "py"), pixel, strict=True))
        measurements[name][image] = Measurement(image, px, py)
    found = []
    for (name, place), (x, y, z, *both) in zip(places.items(), table.tolist(), strict=True):
        sigmas = [sigma for sigma in both if not np.isnan(sigma)]
        with at(place):
            point = GroundControlPoint(
                name=name,
                position=(x, y, z),
                measurements=tuple(measurements[name].values()),
                sigma=Sigma(sigmas[0], sigmas[-1]) if sigmas else None,
                role=CHECK if name in checks else "control",
                reference_system=None if system is None else system.name,
            )
        found += [point] * bool(point.measurements)
    unmarked = [shown(name) for name, seen in measurements.items() if not seen]
    without = f"{plural(len(unmarked), 'point')} of {shown(points)} without marks: {few(unmarked)}."
    return tuple(found), (*notes, *[without] * bool(unmarked))


def _read_markers(path: Path) -> _Markers:
    """Read Metashape's XML; markers that are not enabled are check points."""
    try:
        chunk = ElementTree.parse(path).getroot().find("chunk")
    except ElementTree.ParseError as error:
        raise InputError(f"{shown(path)}: expected XML, found {error}") from None
    labels, places, rows, checks, marks = {}, {}, [], [], []
    for marker in () if chunk is None else chunk.iterfind("markers//marker"):
        name, given = marker.get("label", ""), marker.find("reference")
        if given is None or "x" not in given.attrib:
            continue  # a tie point
        labels[marker.get("id")] = name
        place = f"{shown(path)}: marker {name}"
        if name in places:
            raise InputError(f"{place}: expected one marker of each label, found two")
        places[name] = place
        both = given.get("sxyz", "nan")
        sigmas = given.get("sxy", both), given.get("sz", both)
        words = zip(_ROW, (*(given.get(axis, "nan") for axis in "xyz"), *sigmas), strict=True)
        rows.append([parse_number(place, *word, unknown=True) for word in words])
        checks += [name] * (given.get("enabled", "1") not in _TRUE)
    if chunk is None or not rows:
        raise InputError(
            f"{shown(path)}: expected markers with coordinates (Export Markers), found 0"
        )
    cameras = {one.get("id"): one.get("label", "") for one in chunk.iterfind("cameras//camera")}
    for seen in chunk.iterfind("frames/frame/markers/marker"):
        name = labels.get(seen.get("marker_id"), "")
        for mark in seen.iterfind("location") if name else ():
            if mark.get("valid", "1") in _TRUE:
                image = cameras.get(mark.get("camera_id")) or f"camera {mark.get('camera_id')}"
                marks.append([places[name], image, name, mark.get("x", ""), mark.get("y", "")])
    text = chunk.findtext("reference", "").strip()
    code = _EPSG.search(text)
    word = f"EPSG:{code[1]}" if code else LOCAL if text.startswith("LOCAL_CS") else text
    return system_of(f"{shown(path)}: reference", word), places, np.array(rows), checks, marks


def _read_marks(path: Path, points: Collection[str]) -> Iterator[list[str]]:
    """Yield the place, image, point, px and py of each mark."""
    wanted, table = ", ".join(_MARKS), read_table(path, _MARKS)
    rows, comma = (content_lines(path), ",") if table is None else (table.rows, table.comma)
    if table is None:
        columns = max(_ORDERS, key=lambda at: sum(w[at[1]] in points for _, w in rows if w[3:]))
    elif min(columns := table.columns) < 0:
        raise InputError(f"{table.place}: expected columns {wanted}, found {few(table.titles, 9)}")
    for line, words in rows:
        place = f"{shown(path)}: line {line}"
        if len(words) < len(_MARKS):
            raise InputError(f"{place}: expected {wanted}, found {plural(len(words), 'word')}")
        image, point, *pixel = (words[column] for column in columns)
        yield [place, image, point, *(word.replace(",", comma) for word in pixel)]


def given_control_points(gcps: Any, problem: Problem) -> _Found:
    """Return control points from objects or files, and notes; an empty list for None."""
    if gcps is None:
        return (), ()
    if is_path(gcps):
        path = as_path(gcps, "gcps")
        if "," in str(path) and not path.exists():
            return read_gcp_tables(*(as_path(one, "gcps") for one in str(path).split(",", 1)))
        if path.suffix.lower() == ".xml":
            return read_gcp_tables(path)
        return read_opensfm_gcps(path, problem) if is_opensfm(path) else read_gcp_list(path), ()
    try:
        points = tuple(gcps)
    except TypeError:
        raise InputError(f"gcps: expected a path or control points, found {brief(gcps)}") from None
    for point in points:
        check_type("gcps", point, GroundControlPoint, "GroundControlPoints")
    check_distinct("gcps: expected unique names", (point.name for point in points))
    if not points:
        raise InputError("gcps: expected at least one control point, found 0")
    return points, ()


def with_check_points(
    points: tuple[GroundControlPoint, ...], names: Iterable[str]
) -> tuple[GroundControlPoint, ...]:
    """Return the points with some of them changed to check points."""
    if isinstance(names, str):
        raise InputError(f"check_points: expected a sequence of names, found {brief(names)}")
    wanted = list(names)
    known = [point.name for point in points]
    for name in wanted:
        if name not in known:
            meant = nearest(str(name), known) or f"; expected some of {', '.join(known)}"
            raise InputError(f"check_points: there is no control point {brief(name)}{meant}")
    return tuple(
        replace(point, role="check") if point.name in wanted else point for point in points
    )
