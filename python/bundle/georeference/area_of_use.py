"""The area in which a coordinate reference system is used, as PROJ's database has it.

Coordinates outside of it are seldom meant, but some are: national surveys use one zone of UTM for a
country that is wider (EPSG:25833 in Norway, 13 degrees beyond). So they are noted, and refused
where another reading of the same numbers lies within the area, or where they are farther away.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from pyproj import CRS

__all__ = ["FARTHEST", "MARGIN", "SURE", "AreaOfUse"]

Array = NDArray[np.float64]

MARGIN = 1.0
"""Degrees beyond the area that nobody minds."""
FARTHEST = 20.0
"""Degrees beyond the area at which nothing can be meant."""
SURE = 70
"""Per cent of PROJ's confidence that a text without a code is a system of its database."""


@dataclass(frozen=True)
class AreaOfUse:
    """A rectangle of longitudes and latitudes, in degrees.

    Attributes:
        west: the western end; east of ``east`` where the area has the date line within.
        south: the southern end.
        east: the eastern end.
        north: the northern end.
    """

    west: float
    south: float
    east: float
    north: float

    @staticmethod
    def of(crs: CRS) -> AreaOfUse | None:
        """Return the area of a system, of its map where it has heights as well; None: unknown."""
        import pyproj

        flat = crs.sub_crs_list[0] if crs.sub_crs_list else crs
        area = flat.area_of_use
        if area is None and "+proj=utm" in flat.to_string():
            code = flat.to_epsg(min_confidence=SURE)
            area = pyproj.CRS.from_epsg(code).area_of_use if code else None
        return None if area is None else AreaOfUse(*area.bounds)

    def beyond(self, geodetic: Array) -> Array:
        """Return how many degrees (n, 2 or more) latitudes and longitudes are outside."""
        latitude, longitude = geodetic[:, 0], geodetic[:, 1]
        width = (self.east - self.west) % 360 or 360.0
        from_west = (longitude - self.west) % 360
        across = np.where(from_west <= width, 0.0, np.minimum(from_west - width, 360 - from_west))
        along = np.maximum(self.south - latitude, latitude - self.north)
        beyond: Array = np.maximum(across, np.maximum(along, 0.0))
        return beyond

    def __str__(self) -> str:
        return f"{self.west:g} to {self.east:g} E, {self.south:g} to {self.north:g} N"
