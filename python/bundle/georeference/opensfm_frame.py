"""Frame of an OpenSfM project, and its data in a moved frame.

The coordinates of a reconstruction are east, north, up in metres about its ``reference_lla``
(latitude, longitude, altitude), by the same transformation as :class:`LocalFrame`.

Source: opensfm/io.py, opensfm/geo.py of https://github.com/mapillary/OpenSfM.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bundle.base.arrays import at
from bundle.georeference.local_frame import LocalFrame
from bundle.io.formats.file_values import Node
from bundle.model.problem import Problem
from bundle.model.pycolmap.problem_source import imported_source


def is_opensfm(path: Path) -> bool:
    """Return True for the folder of a project and for a JSON file, False for a table."""
    if path.is_dir():
        return True
    with path.open("rb") as file:
        return file.read(64).lstrip(b"\xef\xbb\xbf \t\r\n")[:1] in (b"[", b"{")


def frame_of(node: Node) -> LocalFrame:
    """Return the frame about a reference_lla.

    Raises:
        InputError: a value is missing or invalid.
    """
    values = (node.get(name).number() for name in ("latitude", "longitude", "altitude"))
    with at(node.place):
        return LocalFrame(*values)


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
