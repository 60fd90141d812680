"""Control points and positions as given by users, transformed into one local frame."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from bundle.base.arrays import check_distinct, check_type
from bundle.base.paths import as_path, is_path
from bundle.errors import InputError, brief, nearest
from bundle.georeference.control_point import GroundControlPoint, parse_sigma
from bundle.georeference.exif_gps import read_exif_gps
from bundle.georeference.gcp_list import read_gcp_list
from bundle.georeference.gps_positions import (
    GpsPositions,
    read_database_gps,
    read_geo_file,
    with_fix,
)
from bundle.georeference.local_frame import LocalFrame
from bundle.georeference.opensfm_frame import is_opensfm, read_opensfm_gcps, read_opensfm_gps
from bundle.georeference.reference_system import ReferenceSystem
from bundle.io.database_images import is_database
from bundle.model.problem import Problem

EXIF = "exif"


class Frame:
    """Frame of a georeferenced model.

    Attributes:
        reference_system: reference system of the coordinates, or None if they are Cartesian.
        origin: origin of east, north, up: in the middle of the control points (check points have no
            influence), or of the positions without control points.
        control_points: (n, 3) positions of the targets; up is nan if unknown.
        positions: (m, 3) positions of images.
        notes: sentences on inexact data.

    Raises:
        InputError: some coordinates have a reference system and others do not.
    """

    def __init__(
        self, points: tuple[GroundControlPoint, ...], positions: GpsPositions | None
    ) -> None:
        self.notes: tuple[str, ...] = positions.notes if positions is not None else ()
        self.origin: LocalFrame | None = None
        self.reference_system: str | None = None
        self.control_points = np.array([point.position for point in points]).reshape(-1, 3)
        self.positions = np.zeros((0, 3))
        systems = list(dict.fromkeys(point.reference_system for point in points))
        if positions is not None:
            systems += [positions.reference_system] if not points else []
        local = positions is not None and positions.reference_system is None
        if None in systems or local:
            if any(system is not None for system in systems) or (positions is not None) > local:
                raise InputError(
                    "gcps: expected a reference system for each control point, because other "
                    "points or GPS positions have one, found None"
                    if not local
                    else "gps: expected control points in the same Cartesian frame as the "
                    f"positions, found {', '.join(str(one) for one in systems)}"
                )
            if positions is not None:
                self.positions = positions.geodetic
            return
        geodetic = np.empty_like(self.control_points)
        for name in systems if points else ():
            system = ReferenceSystem(str(name))
            of_it = [row for row, point in enumerate(points) if point.reference_system == name]
            geodetic[of_it] = system.to_geodetic(self.control_points[of_it])
            notes = (*system.notes, *system.area_notes(geodetic[of_it]))
            self.notes += tuple(note for note in notes if note not in self.notes)
        decisive = geodetic[[point.role == "control" for point in points]] if points else geodetic
        if not len(decisive):
            decisive = positions.geodetic if positions is not None else geodetic
        self.origin = LocalFrame.about(decisive)
        self.reference_system = ", ".join(map(str, systems))
        self.control_points = self.origin.to_enu(geodetic)
        if positions is not None:
            self.positions = self.origin.to_enu(positions.geodetic)


def given_control_points(gcps: Any, problem: Problem) -> tuple[GroundControlPoint, ...]:
    """Return control points from objects or from a file; an empty list for None.

    Raises:
        InputError: the argument does not contain control points, or names repeat.
        OSError: the file cannot be read.
    """
    if gcps is None:
        return ()
    if is_path(gcps):
        path = as_path(gcps, "gcps")
        return read_opensfm_gcps(path, problem) if is_opensfm(path) else read_gcp_list(path)
    try:
        points = tuple(gcps)
    except TypeError:
        raise InputError(f"gcps: expected a path or control points, found {brief(gcps)}") from None
    for point in points:
        check_type("gcps", point, GroundControlPoint, "GroundControlPoints")
    check_distinct("gcps: expected unique names", (point.name for point in points))
    if not points:
        raise InputError("gcps: expected at least one control point, found 0")
    return points


def with_check_points(
    points: tuple[GroundControlPoint, ...], names: Iterable[str]
) -> tuple[GroundControlPoint, ...]:
    """Return the points with some of them changed to check points.

    Raises:
        InputError: a name is not the name of a point.
    """
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


def given_gps(
    gps: str | os.PathLike[str] | GpsPositions | None,
    images: str | os.PathLike[str] | None,
    problem: Problem,
) -> GpsPositions | None:
    """Return positions from an object, a file or the images' EXIF tags; None for None.

    Raises:
        InputError: a file or an argument is wrong.
        OSError: a path cannot be read.
    """
    if gps == EXIF:
        if images is None:
            raise InputError('images: expected the folder of the images for "exif", found None')
        return read_exif_gps(images, problem.image_names)
    if images is not None:
        raise InputError(f'images: expected gps="exif" together with it, found {brief(gps)}')
    if gps is None or isinstance(gps, GpsPositions):
        return None if gps is None else with_fix(gps)
    if is_path(gps):
        path = as_path(gps, "gps")
        if is_database(path):
            return with_fix(read_database_gps(path))
        return with_fix(read_opensfm_gps(path)) if is_opensfm(path) else read_geo_file(path)
    raise InputError(f'gps: expected "exif", a path or GpsPositions, found {brief(gps)}')


def scaled_gps(
    gps: str | os.PathLike[str] | GpsPositions | None,
    images: str | os.PathLike[str] | None,
    problem: Problem,
    gps_sigma: Any,
    gps_sigma_scale: Any,
) -> GpsPositions | None:
    """Return positions as :func:`given_gps` does, all with standard deviations times a factor.

    Args:
        gps: as in :func:`given_gps`.
        images: as in :func:`given_gps`.
        problem: problem of the images.
        gps_sigma: standard deviations of positions without their own.
        gps_sigma_scale: horizontal and vertical factors.
    """
    default = parse_sigma("gps_sigma", gps_sigma)
    scale = parse_sigma("gps_sigma_scale", gps_sigma_scale, unit="a factor")
    positions = given_gps(gps, images, problem)
    if positions is None:
        return None
    own = np.where(np.isnan(positions.accuracy), default, positions.accuracy)
    return replace(positions, accuracy=own * scale)
