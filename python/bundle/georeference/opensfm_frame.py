"""Positions and control points of an OpenSfM project, and its data in a moved frame.

The coordinates of a reconstruction are east, north, up in metres about its ``reference_lla``
(latitude, longitude, altitude), by the same transformation as :class:`LocalFrame`. In this frame,
``gps_position`` of a shot is the measured position, and ``gps_dop`` the standard deviation in
metres that OpenSfM gives it. ``ground_control_points.json`` has latitudes and longitudes, and
measurements in normalised coordinates: pixels from the centre over max(width, height).

Source: opensfm/io.py, opensfm/geo.py of https://github.com/mapillary/OpenSfM.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import bundle._core as _core
from bundle.base.arrays import at
from bundle.base.words import plural
from bundle.errors import InputError, shown
from bundle.georeference.control_point import GroundControlPoint, Measurement
from bundle.georeference.gcp_list import read_gcp_list
from bundle.georeference.gps_positions import GpsPositions
from bundle.georeference.image_index import ImageIndex
from bundle.georeference.local_frame import LocalFrame
from bundle.io.formats.file_values import Node, parsed, read_json
from bundle.model.problem import Problem
from bundle.model.pycolmap.problem_source import imported_source

RECONSTRUCTION = "reconstruction.json"
REFERENCE = "reference_lla.json"
POINTS = "ground_control_points.json"
LIST = "gcp_list.txt"
_NO_POINTS = 2**31  # an entry that no file has: the reader skips all points
_NO_FIX = 1e5
"""gps_dop in metres from which a shot has no position; OpenSfM writes 999999."""


def is_opensfm(path: Path) -> bool:
    """Return True for the folder of a project and for a JSON file, False for a table."""
    if path.is_dir():
        return True
    with path.open("rb") as file:
        return file.read(64).lstrip(b"\xef\xbb\xbf \t\r\n")[:1] in (b"[", b"{")


def read_opensfm_gps(path: Path) -> GpsPositions:
    """Read the GPS positions of the shots of reconstruction.json, or of the project's folder.

    Raises:
        InputError: a value is invalid, or ``reference_lla`` is missing.
        OSError: the file cannot be read.
    """
    file = path / RECONSTRUCTION if path.is_dir() else path
    node = parsed(_core.read_opensfm(file, _NO_POINTS)["rest"], file)
    rows: dict[str, tuple[Any, float]] = {}
    without = 0
    for reconstruction in node.entries():
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
        if without
        else (),
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


def frame_of(node: Node) -> LocalFrame:
    """Return the frame about a reference_lla.

    Raises:
        InputError: a value is missing or invalid.
    """
    values = (node.get(name).number() for name in ("latitude", "longitude", "altitude"))
    with at(node.place):
        return LocalFrame(*values)


def read_opensfm_gcps(path: Path, problem: Problem) -> tuple[GroundControlPoint, ...]:
    """Read ground_control_points.json; of a project's folder, this file and gcp_list.txt.

    Args:
        path: path of the file or folder.
        problem: problem with the sizes of the images. Other images are ignored, as in OpenSfM.

    Raises:
        InputError: a value is invalid, or the folder has neither file.
        OSError: a file cannot be read.
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


# OpenSfM's data of a model that was moved to another frame.
#
# ``reference_lla`` of reconstruction.json is the origin of its coordinates, and ``gps_position`` of
# a shot is a position in them. After a move both would be wrong: they are computed about the origin
# of the new frame, or dropped if the new frame has no known origin.


def without_origin(problem: Problem) -> Problem:
    """Return a moved problem without the OpenSfM data that refer to the old frame."""
    source = imported_source(problem)
    if source is None or not source.data.get("reference_lla"):
        return problem
    data = dict(source.data)
    data["moved_from"] = data.pop("reference_lla")
    return _with_data(problem, data)


def with_origin(problem: Problem, origin: LocalFrame | None) -> Problem:
    """Return a moved problem whose OpenSfM data are about the origin of its new frame."""
    source = imported_source(problem)
    if source is None or origin is None or not source.data.get("moved_from"):
        return problem
    data = dict(source.data)
    old = frame_of(Node(data.pop("moved_from"), "reference_lla"))
    data["reference_lla"] = {
        "latitude": origin.latitude,
        "longitude": origin.longitude,
        "altitude": origin.height,
    }
    data["shots"] = {name: _shot(shot, old, origin) for name, shot in data["shots"].items()}
    return _with_data(problem, data)


def _shot(shot: Mapping[str, Any], old: LocalFrame, new: LocalFrame) -> dict[str, Any]:
    position = shot.get("gps_position")
    if not isinstance(position, list):
        return dict(shot)
    moved = new.to_enu(old.to_geodetic(Node(position, "gps_position").numbers(3)))[0]
    return {**shot, "gps_position": moved.tolist()}


def _with_data(problem: Problem, data: Mapping[str, Any]) -> Problem:
    source = imported_source(problem)
    assert source is not None
    return problem._moved(source=dataclasses.replace(source, data=data))
