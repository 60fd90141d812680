"""Ground control points in reports: a table of their errors."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from bundle.base.words import pixels, plural
from bundle.errors import shown
from bundle.georeference.alignment_result import ControlPointError, metres, root_mean_square
from bundle.georeference.point_check import LEAST_REDUNDANCY
from bundle.reports.sections import Section, Table


def control_points(points: Sequence[ControlPointError], *, adjusted: bool = False) -> list[Section]:
    """Return the errors of control and check points; empty without points.

    After a solve (``adjusted``) the table has sigmas, only the length of each leave-one-out error,
    and the size of an error that would be found.
    """
    if not points:
        return []
    cells = [
        (
            shown(point.name),
            "suspect" if point.suspect else point.role,
            str(point.num_images),
            *map(metres, point.residual),
            *(
                [
                    _sigmas(point),
                    plain_metres(float(np.linalg.norm(_known(point.leave_one_out)))),
                    _detectable(point),
                ]
                if adjusted
                else map(metres, point.leave_one_out)
            ),
            pixels(point.pixels),
        )
        for point in points
    ]
    for kind in ("control", "check"):
        chosen = [point for point in points if point.role == kind]
        if chosen:
            px = np.sqrt(np.mean([point.pixels**2 for point in chosen]))
            rms = map(plain_metres, root_mean_square(point.residual for point in chosen))
            label, count = f"total rms {kind}", plural(len(chosen), "point")
            empty = [""] * 3
            cells.append((label, count, "", *rms, *empty, pixels(px)))
    head = ["control point", "role", "images", "east [m]", "north", "up"]
    head += ["sigma", "left out", "found from"] if adjusted else ["without: east", "north", "up"]
    return [Section(tables=[Table.of((*head, "[px]"), cells, left=2)])]


def suspicions(points: Iterable[ControlPointError]) -> list[str]:
    """Return one sentence per point with a probable gross error, one for points without a check."""
    points = tuple(points)
    unchecked = [shown(point.name) for point in points if point.is_unchecked]
    said = [
        f"{', '.join(unchecked)} cannot be checked: the other measurements hardly predict "
        f"{'it' if len(unchecked) == 1 else 'them'}."
    ]
    return (said if unchecked else []) + [
        f"{shown(point.name)} is probably wrong: the other points place it "
        f"{', '.join(_offsets(point.leave_one_out))} of its coordinates."
        for point in points
        if point.suspect
    ]


def plain_metres(value: float) -> str:
    """Return metres with three decimals; "-" if unknown."""
    return "-" if np.isnan(value) else f"{value:.3f}"


def _detectable(point: ControlPointError) -> str:
    """Return the size of an error that a test finds; "-" if no test can."""
    return plain_metres(point.detectable) if point.redundancy >= LEAST_REDUNDANCY else "-"


def _sigmas(point: ControlPointError) -> str:
    """Return the horizontal and vertical sigma as "0.02/0.05"."""
    east, _, up = point.sigma
    return f"{east:g}/{'-' if np.isnan(up) else f'{up:g}'}"


def _known(residual: Iterable[float]) -> list[float]:
    """Return the coordinates that are not NaN; a single NaN if all are NaN."""
    known = [value for value in residual if not np.isnan(value)]
    return known or [float("nan")]


def _offsets(residual: Iterable[float]) -> list[str]:
    """Return the coordinates as texts such as "-4.081 m east"."""
    named = zip(residual, ("east", "north", "up"), strict=True)
    return [f"{metres(value)} m {axis}" for value, axis in named if not np.isnan(value)]
