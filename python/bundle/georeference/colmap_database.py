"""GPS positions of COLMAP's database: the table pose_priors.

A prior in WGS84 (coordinate_system 0) has latitude, longitude and height, and a covariance in
metres of east, north, up, where it is known; a Cartesian one (1) has x, y, z in metres, z up. The
table of COLMAP 4 refers to an image by corr_data_id, that of COLMAP 3.10 and 3.11 by image_id.
Blobs are doubles, nan where unknown.

Source: src/colmap/scene/database_sqlite.cc and geometry/pose_prior.h of COLMAP.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bundle.base.words import plural
from bundle.errors import InputError, brief, shown
from bundle.georeference.gps_positions import GpsPositions
from bundle.io.database_images import open_database

_WGS84 = 0
_CARTESIAN = 1
_SYSTEMS = {-1: "undefined", _WGS84: "WGS84", _CARTESIAN: "Cartesian"}
_CAMERA = 0
"""corr_sensor_type of a camera; an IMU has another one."""


def read_database_gps(path: Path) -> GpsPositions:
    """Read the positions of the images of a COLMAP database.

    Raises:
        InputError: the database is damaged, or has no positions, or positions in several systems.
        OSError: the file cannot be read.
    """
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
        names=tuple(names),
        geodetic=np.array(geodetic),
        accuracy=np.array(accuracy),
        reference_system="WGS84" if common == _WGS84 else None,
        source=name,
        notes=(f"{plural(without, 'pose prior')} without a position.",) if without else (),
    )


def _doubles(blob: object, count: int, place: str) -> NDArray[np.float64]:
    """Return the numbers of a blob; nan without one."""
    if blob is None:
        return np.full(count, np.nan)
    if not isinstance(blob, bytes) or len(blob) != 8 * count:
        found = f"{len(blob)} bytes" if isinstance(blob, bytes) else brief(blob)
        raise InputError(f"{place}: expected {8 * count} bytes, found {found}")
    return np.frombuffer(blob, "<f8")
