"""Local Cartesian coordinates: east, north, up about an origin on WGS84; those of OpenSfM.

With the geocentric coordinates X of a place (PROJ's ``cart``) and X0 of the origin at latitude phi
and longitude lambda, PROJ's ``topocentric`` step gives

    [e]   [     -sin(lambda)            cos(lambda)           0     ]
    [n] = [-sin(phi) cos(lambda)  -sin(phi) sin(lambda)   cos(phi)  ] (X - X0)
    [u]   [ cos(phi) cos(lambda)   cos(phi) sin(lambda)   sin(phi)  ]

(EPSG method 9837). It is a rigid motion, so that distances are 3-D distances in metres everywhere.
The up axis is the normal of the ellipsoid at the origin only. At a distance d, a point on the
ellipsoid is d^2 / 2R below zero, 8 cm at one kilometre.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.base.arrays import at
from bundle.base.records import dataclass
from bundle.errors import InputError, shown
from bundle.interface.option_fields import number
from bundle.io.formats.file_values import Node
from bundle.model.problem import Problem
from bundle.model.pycolmap.problem_source import imported_source

if TYPE_CHECKING:
    from pyproj import Transformer

Array = NDArray[np.float64]

LARGEST_HEIGHT = 1e9
"""Largest height in metres, beyond the moon; above it, coordinates lose micrometres."""


@dataclass(frozen=True)
class LocalFrame:
    """East, north, up in metres about an origin on WGS84.

    Attributes:
        latitude: latitude of the origin, degrees north, -90 to 90.
        longitude: longitude of the origin, degrees east, -360 to 360.
        height: height of the origin above the ellipsoid, metres.

    Raises:
        InputError: a value is not numeric or out of range.
    """

    latitude: float
    longitude: float
    height: float = 0.0

    def __post_init__(self) -> None:
        for name, largest in (("latitude", 90), ("longitude", 360), ("height", LARGEST_HEIGHT)):
            given = getattr(self, name)
            value = number(f"origin: {name}", given, minimum=-largest, maximum=largest)
            object.__setattr__(self, name, value)

    @staticmethod
    def about(geodetic: ArrayLike) -> LocalFrame:
        """Return the frame about the middle of some places.

        The origin is the componentwise median of the ellipsoid normals of the places. It is robust
        against a minority of gross errors, and is also valid at the date line and at the poles. The
        height is the median of the known heights; if none is known, the origin is on the ellipsoid.

        Args:
            geodetic: (n, 3) latitude, longitude [degrees], height [m] or nan; n at least 1.
        """
        geodetic = np.asarray(geodetic, dtype=np.float64).reshape(-1, 3)
        if not len(geodetic):
            raise InputError("origin: expected at least one position, found 0")
        latitude, longitude, height = geodetic.T
        known = ~np.isnan(height)
        middle = float(np.median(height[known])) if known.any() else 0.0
        phi, lam = np.radians(latitude), np.radians(longitude)
        normals = [np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), np.sin(phi)]
        x, y, z = (float(np.median(axis)) for axis in normals)
        return LocalFrame(
            float(np.degrees(np.arctan2(z, np.hypot(x, y)))),
            float(np.degrees(np.arctan2(y, x))),
            middle,
        )

    @property
    def pipeline(self) -> str:
        """PROJ's operation from longitude, latitude [degrees], height [m] to east, north, up."""
        return (
            "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
            "+step +proj=cart +ellps=WGS84 +step +proj=topocentric +ellps=WGS84 "
            f"+lat_0={self.latitude!r} +lon_0={self.longitude!r} +h_0={self.height!r}"
        )

    def to_enu(self, geodetic: ArrayLike) -> Array:
        """Return (n, 3) east, north, up [m] of places.

        Args:
            geodetic: (n, 3) latitude, longitude [degrees], height [m]. If the height is nan, east
                and north are computed at the height of the origin, and up is nan.
        """
        latitude, longitude, height = np.asarray(geodetic, dtype=np.float64).reshape(-1, 3).T
        unknown = np.isnan(height)
        known = np.where(unknown, self.height, height)
        enu = np.column_stack(self._transformer.transform(longitude, latitude, known))
        enu[unknown, 2] = np.nan
        return enu

    def to_geodetic(self, enu: ArrayLike) -> Array:
        """Return (n, 3) latitude, longitude [degrees], height [m] of (n, 3) east, north, up [m]."""
        east, north, up = np.asarray(enu, dtype=np.float64).reshape(-1, 3).T
        longitude, latitude, height = self._transformer.transform(
            east, north, up, direction="INVERSE"
        )
        return np.column_stack([latitude, longitude, height])

    def asdict(self) -> dict[str, float]:
        """Return latitude, longitude and height by name."""
        return asdict(self)

    @cached_property
    def _transformer(self) -> Transformer:
        import pyproj  # start-up: loads slowly

        return pyproj.Transformer.from_pipeline(self.pipeline)

    def __getstate__(self) -> dict[str, Any]:
        return self.asdict()


# Frame of an OpenSfM project (opensfm/io.py, opensfm/geo.py): ``reference_lla`` is the origin.


def is_opensfm(path: Path) -> bool:
    """Return True for the folder of a project and for a JSON file, False for a table."""
    if path.is_dir():
        return True
    with path.open("rb") as file:
        return file.read(64).lstrip(b"\xef\xbb\xbf \t\r\n")[:1] in (b"[", b"{")


def frame_of(node: Node) -> LocalFrame:
    """Return the frame about a reference_lla."""
    values = (node.get(name).number() for name in ("latitude", "longitude", "altitude"))
    with at(node.place):
        return LocalFrame(*values)


# ``reference_lla`` and each ``gps_position`` are wrong after a move: they are computed about the
# origin of the new frame, or dropped if it has no known origin.


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


def frame_sentences(place: Mapping[str, Any]) -> list[str]:
    """Return where a model with this georeference is; empty if it is not on the earth."""
    system, origin = place.get("reference_system"), place.get("origin")
    if not system or not isinstance(origin, Mapping):
        return []
    at = ", ".join(f"{name} {str(value)[:12]}" for name, value in origin.items())
    return [f"Coordinates: metres east, north, up about {at}; given in {shown(str(system))}."]
