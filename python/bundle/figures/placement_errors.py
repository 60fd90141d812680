"""Errors of a model at measured positions and control points, from georeference.json."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.model.problem import Problem


@dataclass(frozen=True, eq=False)
class PlacedImage:
    """Image with a measured position.

    Attributes:
        name: name of the image.
        position: (3,) position of the camera in the model, east, north, up [m]; NaN if the model
            has no image of this name.
        residual: (3,) model minus measurement, east, north, up [m]; NaN if unknown.
        sigmas: length of the residual in standard deviations; NaN if unknown.
        used: True if the measurement had an influence.
    """

    name: str
    position: NDArray[np.float64]
    residual: NDArray[np.float64]
    sigmas: float
    used: bool


@dataclass(frozen=True, eq=False)
class PlacedTarget:
    """Control or check point.

    Attributes:
        name: name of the target.
        role: "control", "check" or "unused".
        num_images: number of images that observe it.
        residual: (3,) model minus survey, east, north, up [m]; NaN if unknown.
        left_out: (3,) the same if only the other points georeference the model.
        sigma: (3,) standard deviation of the survey [m]; NaN for an unknown height.
        pixels: root mean square of its reprojection errors.
        suspect: True if a gross error is likely.
    """

    name: str
    role: str
    num_images: int
    residual: NDArray[np.float64]
    left_out: NDArray[np.float64]
    sigma: NDArray[np.float64]
    pixels: float
    suspect: bool


@dataclass(frozen=True, eq=False)
class Placement:
    """Georeference of a model, and its errors at measured positions.

    Attributes:
        reference_system: coordinate system of the input; None for Cartesian coordinates.
        images: images with a measured position.
        targets: control and check points.
    """

    reference_system: str | None
    images: tuple[PlacedImage, ...]
    targets: tuple[PlacedTarget, ...]

    def rms(self, kind: str) -> NDArray[np.float64]:
        """Return root mean squares: east, north, up, horizontal and total [m].

        Args:
            kind: "control", "check" or "gps"; "gps" includes only used positions.

        Returns:
            (5,) root mean squares; NaN where no target or image of this kind has a residual.
        """
        if kind == "gps":
            rows = [image.residual for image in self.images if image.used]
        else:
            rows = [target.residual for target in self.targets if target.role == kind]
        table = np.array(rows, float).reshape(-1, 3)
        squares = np.full(3, math.nan)
        for axis in range(3):
            known = table[np.isfinite(table[:, axis]), axis]
            if len(known):
                squares[axis] = (known**2).mean()
        horizontal = squares[0] + squares[1]
        every = horizontal + (squares[2] if np.isfinite(squares[2]) else 0.0)
        result: NDArray[np.float64] = np.sqrt(np.array([*squares, horizontal, every]))
        return result


def placement(problem: Problem, record: Mapping[str, Any]) -> Placement:
    """Return the content of a ``georeference.json``.

    Args:
        problem: problem in the frame that the record describes.
        record: content of the file, or ``asdict()`` of a :class:`Georeference`.

    Raises:
        InputError: the record has another form.
    """
    centers = problem.projection_centers
    index = {name: place for place, name in enumerate(problem.image_names)}
    try:
        images = tuple(
            PlacedImage(
                name=str(entry["image"]),
                position=centers[index[entry["image"]]]
                if entry["image"] in index
                else np.full(3, math.nan),
                residual=_triple(entry["residual_enu"]),
                sigmas=_number(entry.get("sigmas")),
                used=bool(entry["used"]),
            )
            for entry in record["gps"]
        )
        targets = tuple(
            PlacedTarget(
                name=str(entry["name"]),
                role=str(entry["role"]),
                num_images=len(entry.get("images", ())),
                residual=_triple(entry["residual_enu"]),
                left_out=_triple(entry.get("residual_leave_one_out_enu", [None] * 3)),
                sigma=_triple(entry["sigma"]),
                pixels=_number(entry["residual_px"]),
                suspect=bool(entry["suspect"]),
            )
            for entry in record["gcps"]
        )
        system = record["reference_system"]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            "georeference: expected what georeference.json of bundle refine holds, found "
            f"{type(error).__name__} at {error}"
        ) from None
    return Placement(None if system is None else str(system), images, targets)


def _triple(values: Sequence[float | None]) -> NDArray[np.float64]:
    triple = np.array([_number(value) for value in values])
    if triple.shape != (3,):
        raise ValueError(f"{len(triple)} coordinates")
    return triple


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
