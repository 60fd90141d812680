"""Result of an alignment: the moved problem, and its residuals."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import number, pixels, plural
from bundle.errors import shown
from bundle.georeference.local_frame import LocalFrame
from bundle.georeference.point_check import LEAST_REDUNDANCY
from bundle.georeference.similarity import Similarity
from bundle.interface.tabular import Tabular
from bundle.model.problem import Problem

Triple = tuple[float, float, float]

UNKNOWN: Triple = (float("nan"),) * 3
DETECTABLE = 4.6  # sigmas of an error that the test of a point finds with a probability of 80 %


@dataclass(frozen=True)
class ControlPointError:
    """Ground control point after an alignment.

    Attributes:
        name: name of the target.
        role: "control", "check", or "unused" (in fewer than two images of the model).
        num_images: images of the model that observe it.
        residual: (3,) model minus survey, east, north, up [m]; nan if unknown.
        leave_one_out: (3,) residual if the model is aligned without this point; equal to `residual`
            for a check point; nan if the other points do not determine the alignment.
        sigma: (3,) standard deviations of the survey [m]; nan for an unknown height.
        pixels: root mean square reprojection error of the triangulated target.
        images: name, and error in x and y [pixels], of each measurement.
        suspect: True if a gross error is likely; see ``bundle.georeference.survey``.
        reason: reason why the point is unused; "" if it is used.
        redundancy: share of its error that the residual shows after a solve; nan if unknown.
        position: (3,) position of the survey, east, north, up [m]; nan if unknown.
    """

    name: str
    role: str
    num_images: int
    residual: Triple
    leave_one_out: Triple
    sigma: Triple
    pixels: float
    images: tuple[tuple[str, float, float], ...]
    suspect: bool
    reason: str = ""
    redundancy: float = float("nan")
    position: Triple = UNKNOWN

    @staticmethod
    def of(entry: Mapping[str, Any]) -> ControlPointError:
        """Return the point of an entry of ``georeference.json``; see :meth:`asdict`."""
        images = [(one["image"], *one["residual_px"]) for one in entry.get("images", ())]
        return ControlPointError(
            name=str(entry["name"]),
            role=str(entry["role"]),
            num_images=len(images),
            residual=_triple(entry["residual_enu"]),
            leave_one_out=_triple(entry.get("residual_leave_one_out_enu", UNKNOWN)),
            sigma=_triple(entry["sigma"]),
            pixels=_number(entry["residual_px"]),
            images=tuple((str(name), _number(x), _number(y)) for name, x, y in images),
            suspect=bool(entry["suspect"]),
            redundancy=_number(entry.get("redundancy")),
            position=_triple(entry.get("position_enu", UNKNOWN)),
        )

    @property
    def used(self) -> bool:
        """True if its error counts: without a gross error, in two images or more."""
        return self.role != "unused" and not self.suspect

    @property
    def is_unchecked(self) -> bool:
        """True if the other measurements do not check the point."""
        return self.redundancy < LEAST_REDUNDANCY

    @property
    def detectable(self) -> float:
        """Error [m] along the least certain axis that a test finds in 80 % of the cases.

        It is 4.6 sigma / sqrt(redundancy): a chi-squared test with 3 degrees of freedom at 0.1 %.
        """
        largest = max((one for one in self.sigma if not np.isnan(one)), default=float("nan"))
        return DETECTABLE * largest / np.sqrt(self.redundancy) if self.redundancy > 0 else np.inf

    def asdict(self) -> dict[str, Any]:
        """Return the entry of this point in ``georeference.json``."""
        return {
            "name": self.name,
            "role": self.role,
            "position_enu": list(self.position),
            "residual_enu": list(self.residual),
            "residual_leave_one_out_enu": list(self.leave_one_out),
            "residual_px": self.pixels,
            "sigma": list(self.sigma),
            "suspect": self.suspect,
            **({} if np.isnan(self.redundancy) else {"redundancy": self.redundancy}),
            "images": [{"image": name, "residual_px": [x, y]} for name, x, y in self.images],
        }


@dataclass(frozen=True)
class ImageError:
    """Image of a model and its measured position.

    Attributes:
        name: name of the image.
        residual: (3,) model minus measurement, east, north, up [m], or in the frame and the length
            unit of the other model; nan for an unknown height, or without a measurement.
        used: False without a prior, or if it had no influence, for example because of a robust
            loss.
        sigmas: length of the residual in standard deviations; nan if unknown.
        position: (3,) position in the model; nan if unknown.
    """

    name: str
    residual: Triple
    used: bool
    sigmas: float = float("nan")
    position: Triple = UNKNOWN

    @staticmethod
    def of(entry: Mapping[str, Any], position: NDArray[np.float64]) -> ImageError:
        """Return the image of an entry of ``georeference.json`` at a position in the model."""
        return ImageError(
            name=str(entry["image"]),
            residual=_triple(entry["residual_enu"]),
            used=bool(entry["used"]),
            sigmas=_number(entry.get("sigmas")),
            position=as_triple(position),
        )

    @property
    def role(self) -> str:
        """Role: "image", or "unused"."""
        return "image" if self.used else "unused"


@dataclass(frozen=True, repr=False)
class Alignment(Displayed, Tabular):
    """Aligned problem.

    Attributes:
        problem: problem with moved poses and points, in metres or the length unit of the other
            model.
        similarity: similarity from the frame of the input to the new one.
        reference_system: reference system of the coordinates; None without one.
        origin: origin of the local frame east, north, up; None in the frame of another model.
        control_points: every target in the given order.
        positions: measured positions of images in the given order.
        shared_images: images of the other model, if it determined the alignment.
        notes: remarks, one sentence each.
        sigma0: residuals in sigmas relative to their degrees of freedom; nan for another model and
            without degrees of freedom.
    """

    problem: Problem
    similarity: Similarity
    reference_system: str | None
    origin: LocalFrame | None
    control_points: tuple[ControlPointError, ...]
    positions: tuple[ImageError, ...]
    shared_images: tuple[ImageError, ...]
    notes: tuple[str, ...]
    sigma0: float = float("nan")

    def rms(self, kind: str = "control") -> Triple:
        """Return the root mean square of residuals east, north, up; nan without residuals.

        Args:
            kind: "control", "check", "gps" or "shared_images".
        """
        if kind in ("control", "check"):
            return root_mean_square(p.residual for p in self.control_points if p.role == kind)
        images = self.positions if kind == "gps" else self.shared_images
        return root_mean_square(image.residual for image in images)

    @property
    def suspects(self) -> tuple[str, ...]:
        """Names of control and check points that probably have a gross error."""
        return tuple(point.name for point in self.control_points if point.suspect)

    def asdict(self) -> dict[str, Any]:
        """Return the content of ``georeference.json``.

        ``similarity`` maps a point x of the input to scale * rotation @ x + translation, metres
        east, north, up of ``origin``. ``pipeline`` is PROJ's operation from longitude, latitude and
        height to these metres. ``rms_enu`` belongs to the control points; without control points,
        to the positions or to the shared images.
        """
        kinds = ("control", "gps", "shared_images")
        counted = [kind for kind in kinds if not np.isnan(self.rms(kind)[0])]
        return {
            "reference_system": self.reference_system,
            "origin": self.origin.asdict() if self.origin else None,
            "pipeline": self.origin.pipeline if self.origin else None,
            "similarity": self.similarity.asdict(),
            "gps": [_image(image) for image in self.positions],
            "gcps": [point.asdict() for point in self.control_points],
            "shared_images": [_image(image) for image in self.shared_images],
            "rms_enu": list(self.rms(counted[0])) if counted else None,
            "rms_enu_check": list(self.rms("check")),
            "sigma0": self.sigma0,
            "notes": list(self.notes),
        }

    def _display(self) -> Display:
        controls = sum(point.role == "control" for point in self.control_points)
        facts = [("scale", number(self.similarity.scale))]
        if self.control_points:
            facts += [
                ("control points", f"{controls} of {len(self.control_points)}"),
                ("suspects", ", ".join(self.suspects) or "none"),
            ]
        for label, images in (("positions", self.positions), ("shared", self.shared_images)):
            if images:
                facts.append((label, plural(len(images), "image")))
        (table,) = point_errors(self.control_points) or (Display(title=""),)
        return replace(table, title="Alignment", facts=tuple(facts))


def metres(value: float) -> str:
    """Return metres to the millimetre, with their sign; "-" if unknown."""
    return "-" if np.isnan(value) else f"{value:+.3f}"


def as_triple(values: NDArray[np.float64]) -> Triple:
    """Return the three numbers of an array."""
    east, north, up = values.tolist()
    return east, north, up


def _triple(values: Sequence[float | None]) -> Triple:
    east, north, up = map(_number, values)
    return east, north, up


def _number(value: float | None) -> float:
    return float("nan") if value is None else float(value)


def root_mean_square(residuals: Iterable[Triple]) -> Triple:
    """Return the root mean square of each column, ignoring nan; nan without numbers."""
    rows = np.array(list(residuals), dtype=float).reshape(-1, 3)
    squares = [column[~np.isnan(column)] ** 2 for column in rows.T]
    return as_triple(np.sqrt([one.mean() if len(one) else np.nan for one in squares]))


def _image(image: ImageError) -> dict[str, Any]:
    return {"image": image.name, "residual_enu": list(image.residual), "used": image.used}


# Reports of control points: their errors, and those that are probably wrong.


def point_errors(
    points: Sequence[ControlPointError], *, adjusted: bool = False
) -> tuple[Display, ...]:
    """Return the table of control and check points; empty without points.

    ``adjusted``: True after a solve: the table has sigmas, only the length of each leave-one-out
    error, and the size of an error that would be found.
    """
    if not points:
        return ()
    cells = [
        (
            shown(point.name),
            "suspect" if point.suspect else point.role,
            str(point.num_images),
            *map(metres, point.residual),
            *(
                [
                    _sigmas_of(point),
                    plain_metres(float(np.linalg.norm(_known_of(point.leave_one_out)))),
                    "-" if point.is_unchecked else plain_metres(point.detectable),
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
    title = "Control points"
    return (Display(title=title, head=(*head, "[px]"), rows=tuple(cells), left=2),)


def is_contradiction(points: Iterable[ControlPointError]) -> bool:
    """Return True if most control points fail their test: then no single one is wrong."""
    used = [point.suspect for point in points if point.role == "control"]
    return 2 * sum(used) > len(used)


def suspicions(points: Iterable[ControlPointError]) -> list[str]:
    """Return one sentence per point with a probable gross error, one for points without a check.

    If most points fail, one sentence on all of them replaces the first.
    """
    points = tuple(points)
    unchecked = [shown(point.name) for point in points if point.is_unchecked]
    said = [
        f"{', '.join(unchecked)} cannot be checked: the other measurements hardly predict "
        f"{'it' if len(unchecked) == 1 else 'them'}."
    ] * bool(unchecked)
    if is_contradiction(points):
        used = [point.suspect for point in points if point.role == "control"]
        return [
            *said,
            f"{sum(used)} of {plural(len(used), 'control point')} contradict the others: no single "
            "one is wrong, but their sigmas are too small.",
        ]
    return said + [
        f"{shown(point.name)} is probably wrong: the other points place it "
        f"{', '.join(_offsets(point.leave_one_out))} of its coordinates."
        for point in points
        if point.suspect
    ]


def plain_metres(value: float) -> str:
    """Return metres with three decimals; "-" if unknown."""
    return "-" if np.isnan(value) else f"{value:.3f}"


def _sigmas_of(point: ControlPointError) -> str:
    """Return the horizontal and vertical sigma as "0.02/0.05"."""
    east, _, up = point.sigma
    return f"{east:g}/{'-' if np.isnan(up) else f'{up:g}'}"


def _known_of(residual: Iterable[float]) -> list[float]:
    """Return the coordinates that are not NaN; a single NaN if all are NaN."""
    known = [value for value in residual if not np.isnan(value)]
    return known or [float("nan")]


def _offsets(residual: Iterable[float]) -> list[str]:
    """Return the coordinates as texts such as "-4.081 m east"."""
    named = zip(residual, ("east", "north", "up"), strict=True)
    return [f"{metres(value)} m {axis}" for value, axis in named if not np.isnan(value)]
