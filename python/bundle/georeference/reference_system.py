"""Coordinate reference systems of files, their transformation to WGS84 by PROJ, and area of use.

All coordinates are transformed to latitude, longitude and height on WGS84, and from there into a
local frame (docs/align.md). Heights of systems without a vertical axis (EPSG:32632, EPSG:4326) are
used unchanged as metres above the WGS84 ellipsoid: those above the sea then shift all points of a
survey by nearly the same undulation of the geoid, up to 100 m.

If most coordinates of a file are outside the system's area of use (PROJ's database), the numbers
usually have another meaning: swapped columns, degrees, or the zone of the other hemisphere. Each is
tried. Some national surveys use one UTM zone for a wider country (EPSG:25833 in Norway, up to 13
degrees outside): such coordinates get a note, and are refused if another interpretation is within
the area, or if they are too far away.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.base.arrays import check_type
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.errors import InputError, brief, first_line

if TYPE_CHECKING:  # start-up: pyproj loads slowly
    from pyproj import CRS, Transformer


Array = NDArray[np.float64]

MARGIN = 1.0  # largest distance from the area, in degrees, without a note
FARTHEST = 20.0  # distance from the area, in degrees, from which coordinates are refused
SURE = 70
"""Smallest confidence of PROJ, in percent, to match a text without a code to a system of its
database.
"""


@dataclass(frozen=True)
class AreaOfUse:
    """Rectangle of longitudes and latitudes in degrees."""

    west: float  # western end; greater than ``east`` if the area contains the date line
    south: float  # southern end
    east: float  # eastern end
    north: float  # northern end

    @staticmethod
    def of(crs: CRS) -> AreaOfUse | None:
        """Return the horizontal area of a system; None if unknown."""
        import pyproj  # start-up: loads slowly

        flat = crs.sub_crs_list[0] if crs.sub_crs_list else crs
        area = flat.area_of_use
        if area is None and "+proj=utm" in flat.to_string():
            code = flat.to_epsg(min_confidence=SURE)
            area = pyproj.CRS.from_epsg(code).area_of_use if code else None
        return None if area is None else AreaOfUse(*area.bounds)

    def beyond(self, geodetic: Array) -> Array:
        """Return the distance in degrees of (n, 2 or more) latitudes and longitudes to the area."""
        latitude, longitude = geodetic[:, 0], geodetic[:, 1]
        width = (self.east - self.west) % 360 or 360.0
        from_west = (longitude - self.west) % 360
        across = np.where(from_west <= width, 0.0, np.minimum(from_west - width, 360 - from_west))
        along = np.maximum(self.south - latitude, latitude - self.north)
        beyond: Array = np.maximum(across, np.maximum(along, 0.0))
        return beyond

    def __str__(self) -> str:
        return f"{self.west:g} to {self.east:g} E, {self.south:g} to {self.north:g} N"


_UTM = re.compile(r"WGS\s*84[\s/]+UTM(?:\s+zone)?\s+(\d{1,2})\s*([NS])", re.IGNORECASE)
_EPSG = re.compile(r"epsg:\s*(\d+(?:\s*\+\s*\d+)?)", re.IGNORECASE)


@dataclass(frozen=True)
class ReferenceSystem:
    """Coordinate reference system.

    Attributes:
        name: "EPSG:32632", "EPSG:32632+5773" (with heights), a PROJ string that contains "+proj=",
            "WGS84 UTM 32N", or "WGS84" for longitude and latitude.

    Raises:
        InputError: the name has another form, is unknown to PROJ, or its system does not have
            horizontal coordinates.
    """

    name: str

    def __post_init__(self) -> None:
        _ = self._crs

    @property
    def has_height(self) -> bool:
        """True if the system defines the third coordinate."""
        return len(self._crs.axis_info) == 3

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on losses and assumptions of the transformation to WGS84."""
        lost = (_UNKNOWN_SHIFT.format(self.name),) * (not self._transformer[1])
        feet = 0.3 < self.units[0] < 0.31 and not self.has_height
        return (*lost, _METRES.format(self.name)) if feet else lost

    def to_geodetic(
        self, coordinates: ArrayLike, places: Sequence[str] | None = None
    ) -> NDArray[np.float64]:
        """Return (n, 3) latitude, longitude [degrees] and height [m] on WGS84.

        Args:
            coordinates: (n, 3) east, north, height, or longitude, latitude, height, in the units of
                the system, independent of the axis order of its authority. Heights may be nan
                (unknown) and stay nan.
            places: name of each row for messages; "position 0" and so on by default.

        Raises:
            InputError: a coordinate cannot be transformed, or most are outside the system's area.
        """
        given = np.asarray(coordinates, dtype=np.float64).reshape(-1, 3)
        geodetic = self._transformed(given)
        wrong = ~_is_on_earth(geodetic)
        if not wrong.any():
            beyond = self._beyond(geodetic)
            if np.mean(beyond > MARGIN) <= 0.5:
                return geodetic
            wrong = beyond > MARGIN
            if np.median(beyond) <= FARTHEST and not self._meant(given[wrong]):
                return geodetic
        row = int(np.argmax(wrong))
        place = f"position {row}" if places is None else places[row]
        area = "" if self._area is None else f" ({self._area})"
        raise InputError(
            f"{place}: expected coordinates within the area of {self.name}{area}, found "
            f"{given[row, 0]:.10g} {given[row, 1]:.10g}{self._meant(given[wrong])}"
        )

    def area_notes(self, geodetic: NDArray[np.float64]) -> tuple[str, ...]:
        """Return a sentence on places outside the system's area of use, if there are any."""
        outside = int((self._beyond(geodetic) > MARGIN).sum())
        note = f"{plural(outside, 'position')} of {len(geodetic)} outside of the area of use of "
        return (f"{note}{self.name} ({self._area}).",) * bool(outside)

    def is_no_fix(self, coordinates: ArrayLike) -> NDArray[np.bool_]:
        """Return the mask of (n, 3) coordinates at 0 0, as receivers without a fix write."""
        given = np.asarray(coordinates, dtype=np.float64).reshape(-1, 3)
        zero: NDArray[np.bool_] = (given[:, :2] == 0).all(axis=1)
        if self._crs.is_projected and zero.any():
            there = self._transformed(np.zeros((1, 3)))
            zero &= not _is_on_earth(there).all() or self._beyond(there)[0] > MARGIN
        return zero

    def exchanged(self, geodetic: ArrayLike) -> NDArray[np.float64] | None:
        """Return places with the first two coordinates swapped; None if these are invalid."""
        places = np.asarray(geodetic, dtype=np.float64).reshape(-1, 3)
        transformer, _ = self._transformer
        if self._crs.is_geocentric:
            return None
        height = np.nan_to_num(places[:, 2])
        inverse = transformer.transform(places[:, 1], places[:, 0], height, direction="INVERSE")
        x, y = inverse[:2]
        return self._readable(np.column_stack([y, x, places[:, 2]]))

    def is_within(self, coordinates: ArrayLike) -> bool:
        """Return True if most coordinates are within the area of use."""
        return self._readable(np.asarray(coordinates, dtype=np.float64).reshape(-1, 3)) is not None

    @property
    def units(self) -> list[float]:
        """Return the units of x, y and height in metres (of degrees in radians)."""
        return [axis.unit_conversion_factor for axis in self._crs.axis_info] + [1.0][
            self.has_height :
        ]

    def _transformed(self, given: NDArray[np.float64]) -> NDArray[np.float64]:
        x, y, z = given.T
        transformer, _ = self._transformer
        if self.has_height:
            known = np.nan_to_num(z) if not self._crs.is_geocentric else z
            longitude, latitude, height = transformer.transform(x, y, known)
            height = np.where(np.isnan(z), np.nan, height)
        else:
            longitude, latitude = transformer.transform(x, y)
            height = z
        within = np.isfinite(longitude) & (np.abs(longitude) <= 360)
        longitude = np.where(within, (np.where(within, longitude, 0) + 180) % 360 - 180, np.inf)
        return np.column_stack([latitude, longitude, height])

    def _beyond(self, geodetic: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.zeros(len(geodetic)) if self._area is None else self._area.beyond(geodetic)

    def _readable(self, given: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return the places of coordinates; None if most of them are outside the area."""
        geodetic = self._transformed(given)
        if not _is_on_earth(geodetic).all() or np.median(self._beyond(geodetic)) > MARGIN:
            return None
        return geodetic

    def _meant(self, given: NDArray[np.float64]) -> str:
        """Return a likely interpretation of coordinates outside the area, or ""."""
        if self._crs.is_geocentric:
            return ""
        if self._crs.is_projected and (np.abs(given[:, :2]) <= [180, 180]).all():
            return "; they look like degrees (EPSG:4326)" if given[:, :2].any() else ""
        if self._readable(given[:, [1, 0, 2]]) is not None:
            return "; columns 1 and 2 fit when exchanged"
        zone = self._crs.utm_zone
        if zone and not self.has_height and self._crs.to_epsg(min_confidence=SURE):
            code = {"S": 32600, "N": 32700}[zone[-1]] + int(zone[:-1])
            if ReferenceSystem(f"EPSG:{code}")._readable(given) is not None:
                half = {"S": "northern", "N": "southern"}[zone[-1]]
                return f"; they fit EPSG:{code}, the {half} half of the zone"
        return ""

    @cached_property
    def _area(self) -> AreaOfUse | None:
        return AreaOfUse.of(self._crs)

    @cached_property
    def _crs(self) -> CRS:
        import pyproj  # start-up: loads slowly

        check_type("coordinate reference system", self.name, str, "text")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # "+init=" is deprecated
                crs = pyproj.CRS.from_user_input(_definition(self.name))
        except pyproj.exceptions.CRSError as error:
            reason = first_line(error)
            raise InputError(f"{_expected(self.name)}; PROJ: {brief(reason)}") from None
        if not (crs.is_geographic or crs.is_projected or crs.is_geocentric):
            raise InputError(
                f"coordinate reference system {brief(self.name)}: expected a system with "
                f"horizontal coordinates, found a {crs.type_name}"
            )
        return crs

    @cached_property
    def _transformer(self) -> tuple[Transformer, bool]:
        """Return the transformation to WGS84, and True if it includes all datum shifts."""
        import pyproj  # start-up: loads slowly

        target = pyproj.CRS.from_epsg(4979 if self.has_height else 4326)
        for exact in (True, False):
            try:
                return pyproj.Transformer.from_crs(
                    self._crs, target, always_xy=True, allow_ballpark=not exact
                ), exact
            except pyproj.exceptions.ProjError as error:
                reason = first_line(error)
        raise InputError(
            f"coordinate reference system {brief(self.name)}: expected a system that PROJ can "
            f"transform to WGS84, found {brief(reason)}"
        )

    def __getstate__(self) -> dict[str, str]:
        return {"name": self.name}


WGS84 = "EPSG:4326"  # longitude and latitude, as GPS receivers output them

_UNKNOWN_SHIFT = (
    "PROJ cannot shift {} to WGS84 exactly (its datum or a geoid grid is missing): "
    "positions are used without a shift."
)
_METRES = "The map {} is in feet, but has no heights: these are used as metres."


def _definition(name: str) -> str:
    text = name.strip().strip("'\"").strip()
    if re.fullmatch(r"WGS\s*84", text, re.IGNORECASE):
        return WGS84
    if match := _UTM.fullmatch(text):
        zone, south = int(match[1]), match[2].upper() == "S"
        if 1 <= zone <= 60:
            return f"EPSG:{32700 + zone if south else 32600 + zone}"
    elif match := _EPSG.fullmatch(text):
        return "EPSG:" + re.sub(r"\s", "", match[1])
    elif "+proj" in text or "+init" in text:
        return text
    raise InputError(_expected(name))


def _is_on_earth(geodetic: NDArray[np.float64]) -> NDArray[np.bool_]:
    latitude, longitude, height = geodetic.T
    with np.errstate(invalid="ignore"):
        good: NDArray[np.bool_] = np.isfinite(longitude) & (np.abs(latitude) <= 90)
        good &= ~np.isinf(height)
    return good


def _expected(name: str) -> str:
    return (
        "coordinate reference system: expected EPSG:CODE, a PROJ string (+proj=...) or "
        f"WGS84 UTM 32N (zone 1 to 60, N or S) or WGS84, found {brief(name)}"
    )
