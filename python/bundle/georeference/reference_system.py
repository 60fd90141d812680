"""Coordinate reference systems of files: parsed, and transformed to WGS84 by PROJ.

All coordinates go to latitude, longitude and height on WGS84 first, never from one projection to
another, and from there into a local frame (``bundle.georeference.local_frame``): projected
coordinates are no Euclidean space. A UTM map shrinks its central meridian by 0.9996, 40 cm in a
kilometre, and turns north by the convergence of meridians.

Heights are another matter than the map. Where a system has a vertical axis of its own (EPSG:4979,
EPSG:7423, EPSG:32632+5773), PROJ transforms it. Where it has none (EPSG:32632, EPSG:4326), the
third number of a file is taken for metres above the WGS84 ellipsoid, as it stands: heights above
sea level are wrong by the geoid's undulation, up to 100 m, which is nearly the same all over a
survey and shifts it as a whole.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.errors import InputError, brief, first_line

if TYPE_CHECKING:
    from pyproj import CRS, Transformer

__all__ = ["WGS84", "ReferenceSystem"]

_UTM = re.compile(r"WGS\s*84[\s/]+UTM(?:\s+zone)?\s+(\d{1,2})\s*([NS])", re.IGNORECASE)
_EPSG = re.compile(r"epsg:\s*(\d+(?:\s*\+\s*\d+)?)", re.IGNORECASE)


@dataclass(frozen=True)
class ReferenceSystem:
    """A coordinate reference system.

    Attributes:
        name: "EPSG:32632", "EPSG:32632+5773" (with heights), a PROJ string that contains "+proj=",
            or "WGS84 UTM 32N".

    Raises:
        InputError: none of these, PROJ does not know it, or it has no place on the map.
    """

    name: str

    def __post_init__(self) -> None:
        _ = self._crs

    @property
    def has_height(self) -> bool:
        """Whether the third coordinate belongs to the system."""
        return len(self._crs.axis_info) == 3

    @property
    def notes(self) -> tuple[str, ...]:
        """What is lost on the way to WGS84: a sentence, or nothing."""
        return () if self._transformer[1] else (_UNKNOWN_SHIFT.format(self.name),)

    def to_geodetic(
        self, coordinates: ArrayLike, places: Sequence[str] | None = None
    ) -> NDArray[np.float64]:
        """Return (n, 3) latitude, longitude [degrees] and height [m] on WGS84.

        Args:
            coordinates: (n, 3) east, north, height, or longitude, latitude, height, in the units of
                the system, whatever order of axes its authority prescribes. Heights may be nan
                (unknown) and then are so in the result.
            places: what messages call each row; "position 0" and so on by default.

        Raises:
            InputError: coordinates out of the system's area.
        """
        x, y, z = np.asarray(coordinates, dtype=np.float64).reshape(-1, 3).T
        transformer, _ = self._transformer
        if self.has_height:
            known = np.nan_to_num(z) if not self._crs.is_geocentric else z
            longitude, latitude, height = transformer.transform(x, y, known)
            height = np.where(np.isnan(z), np.nan, height)
        else:
            longitude, latitude = transformer.transform(x, y)
            height = z
        good = np.isfinite(latitude) & np.isfinite(longitude)
        good &= (np.abs(latitude) <= 90) & (np.abs(longitude) <= 360) & ~np.isinf(height)
        if not good.all():
            row = int(np.argmin(good))
            place = f"position {row}" if places is None else places[row]
            raise InputError(
                f"{place}: expected coordinates within the area of {self.name}, "
                f"found {x[row]:.10g} {y[row]:.10g}"
            )
        return np.column_stack([latitude, (longitude + 180) % 360 - 180, height])

    @cached_property
    def _crs(self) -> CRS:
        import pyproj

        if not isinstance(self.name, str):
            raise InputError(
                f"coordinate reference system: expected text, found {brief(self.name)}"
            )
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of "+init=", that it is deprecated
                crs = pyproj.CRS.from_user_input(_definition(self.name))
        except pyproj.exceptions.CRSError as error:
            reason = first_line(error)
            raise InputError(f"{_expected(self.name)}; PROJ: {brief(reason)}") from None
        if not (crs.is_geographic or crs.is_projected or crs.is_geocentric):
            raise InputError(
                f"coordinate reference system {brief(self.name)}: expected one with places on the "
                f"map, found a {crs.type_name}"
            )
        return crs

    @cached_property
    def _transformer(self) -> tuple[Transformer, bool]:
        """Return the way to WGS84, and whether it accounts for all differences of datums."""
        import pyproj

        target = pyproj.CRS.from_epsg(4979 if self.has_height else 4326)
        for exact in (True, False):
            try:
                return pyproj.Transformer.from_crs(
                    self._crs, target, always_xy=True, allow_ballpark=not exact
                ), exact
            except pyproj.exceptions.ProjError as error:
                reason = first_line(error)
        raise InputError(
            f"coordinate reference system {brief(self.name)}: expected one that PROJ transforms to "
            f"WGS84, found none ({brief(reason)})"
        )

    def __getstate__(self) -> dict[str, str]:
        return {"name": self.name}


WGS84 = "EPSG:4326"
"""Longitude and latitude, as GPS receivers give them."""

_UNKNOWN_SHIFT = (
    "PROJ cannot shift {} to WGS84 exactly (its datum or a geoid grid is missing): positions are "
    "taken as if it needed no shift."
)


def _definition(name: str) -> str:
    """Return what PROJ understands.

    Raises:
        InputError: the name has none of the forms that files use.
    """
    text = name.strip().strip("'\"").strip()
    if match := _UTM.fullmatch(text):
        zone, south = int(match[1]), match[2].upper() == "S"
        if 1 <= zone <= 60:
            return f"EPSG:{32700 + zone if south else 32600 + zone}"
    elif match := _EPSG.fullmatch(text):
        return "EPSG:" + re.sub(r"\s", "", match[1])
    elif "+proj" in text or "+init" in text:
        return text
    raise InputError(_expected(name))


def _expected(name: str) -> str:
    return (
        "coordinate reference system: expected EPSG:CODE, a PROJ string (+proj=...) or "
        f"WGS84 UTM 32N (zone 1 to 60, N or S), found {brief(name)}"
    )
