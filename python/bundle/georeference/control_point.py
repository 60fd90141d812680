"""Ground control points and scale bars: surveyed targets, their pixels, and known lengths."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import field
from typing import Any, NamedTuple

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.errors import InputError, brief, shown
from bundle.interface.georeference_options import ROBUST_SCALE, ROBUST_SCALES, SCALE_BAR_SIGMA
from bundle.interface.option_fields import choice, number
from bundle.interface.options import LOSSES

ROLES = ("control", "check")
SMALLEST, LARGEST = 1e-9, 1e9
"""Standard deviations outside these limits lose their squares in rounding."""
FARTHEST = 1e12  # largest coordinate in metres


class Sigma(NamedTuple):
    """Standard deviations of a surveyed position, in metres."""

    horizontal: float
    vertical: float


GCP_SIGMA = Sigma(0.02, 0.02)
"""Default sigma of surveyed positions. Horizontal and vertical sigmas are equal: if sigmas are far
too small, a smaller horizontal sigma would make the fit tilt the model.
"""


class Measurement(NamedTuple):
    """Measurement of a target in an image.

    Attributes:
        image: name of the image.
        x: pixels from the left edge of the image: the centre of the first pixel is (0.5, 0.5).
        y: pixels from the upper edge.
        sigma: standard deviation of x and of y in pixels; None: in an alignment its default, in a
            solve 0.5.
    """

    image: str
    x: float
    y: float
    sigma: float | None = None


@dataclass(frozen=True, kw_only=True)
class GroundControlPoint:
    """Surveyed target.

    Attributes:
        name: unique among the targets.
        position: (3,) x, y, z in ``reference_system``: east or longitude, north or latitude,
            height; nan for an unknown height.
        measurements: measurements in images, each (image, x, y) or (image, x, y, sigma); see
            :class:`Measurement`. Images that are not in the model are ignored.
        sigma: standard deviation of each coordinate in metres: one number, or horizontal and
            vertical; None: default of the alignment, 0.02 m in a solve.
        role: "control", or "check": a check point is compared with the model and never moves it.
        reference_system: "EPSG:32632", a PROJ string or "WGS84 UTM 32N"; None: a Cartesian frame in
            metres, which becomes the frame of the model.
        loss: robust loss of the distance from ``position`` in a solve, a loss of
            :class:`bundle.SolveOptions`; an alignment has its own loss.
        loss_scale: length of the residual in sigmas beyond which the loss is robust.

    Raises:
        InputError: a value has a wrong type or range; the message names the target.
    """

    name: str
    position: tuple[float, float, float]
    measurements: tuple[Measurement, ...]
    sigma: Sigma | None = None
    role: str = "control"
    reference_system: str | None = None
    loss: str = "trivial"
    loss_scale: float = ROBUST_SCALE

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.strip() or not self.name.isprintable():
            raise InputError(f"name: expected text for a control point, found {brief(self.name)}")
        here = f"control point {self.name}"
        object.__setattr__(self, "position", _position(here, self.position))
        object.__setattr__(self, "measurements", _measurements(here, self.measurements))
        object.__setattr__(self, "role", choice(f"{here}: role", self.role, ROLES))
        object.__setattr__(self, "loss", choice(f"{here}: loss", self.loss, LOSSES))
        scale = number(f"{here}: loss_scale", self.loss_scale, above=0)
        object.__setattr__(self, "loss_scale", scale)
        if self.sigma is not None:
            object.__setattr__(self, "sigma", parse_sigma(f"{here}: sigma", self.sigma))
        if self.reference_system is not None and not isinstance(self.reference_system, str):
            raise InputError(
                f"{here}: reference_system: expected text or None, "
                f"found {brief(self.reference_system)}"
            )


def parse_sigma(name: str, value: Any, unit: str = "metres") -> Sigma:
    """Return standard deviations from a number, a pair, "0.02" or "0.02/0.05"."""
    parts: Any = value
    if isinstance(value, str):
        try:
            parts = [float(part) for part in value.split("/")]
        except ValueError:
            parts = []
    elif not isinstance(value, tuple | list):
        parts = [value]
    if not 1 <= len(parts) <= 2:
        raise InputError(
            f"{name}: expected {unit}, such as 0.02 or 0.02/0.05 (horizontal/vertical), "
            f"found {brief(value)}"
        )
    horizontal, vertical = (
        number(name, part, minimum=SMALLEST, maximum=LARGEST) for part in (parts[0], parts[-1])
    )
    return Sigma(horizontal, vertical)


def parse_pixel_sigma(name: str, value: Any) -> float:
    """Return the standard deviation of a measurement in pixels."""
    return number(name, value, minimum=SMALLEST, maximum=LARGEST)


def _position(here: str, given: Any) -> tuple[float, float, float]:
    numbers = _items(f"{here}: position", given)
    if len(numbers) != 3:
        raise InputError(f"{here}: position: expected 3 numbers, found {brief(given)}")
    x, y = (_coordinate(here, value) for value in numbers[:2])
    unknown = isinstance(numbers[2], float) and math.isnan(numbers[2])
    return x, y, math.nan if unknown else _coordinate(here, numbers[2])


def _coordinate(here: str, value: Any) -> float:
    return number(f"{here}: position", value, minimum=-FARTHEST, maximum=FARTHEST)


def _measurements(here: str, given: Any) -> tuple[Measurement, ...]:
    measurements: dict[str, Measurement] = {}
    for entry in _items(f"{here}: measurements", given):
        parts = _items(f"{here}: measurements", entry)
        if not 3 <= len(parts) <= 4 or not isinstance(parts[0], str) or not parts[0]:
            raise InputError(
                f"{here}: measurements: expected (image, x, y) or (image, x, y, sigma) each, "
                f"found {brief(entry)}"
            )
        image, *numbers = parts
        if image in measurements:
            raise InputError(f"{here}: expected one measurement per image, found two in {image}")
        x, y = (number(f"{here}: {image}: pixel", value) for value in numbers[:2])
        sigma = numbers[2] if len(numbers) > 2 else None
        if sigma is not None:
            sigma = parse_pixel_sigma(f"{here}: {image}: sigma", sigma)
        measurements[image] = Measurement(image, x, y, sigma)
    return tuple(measurements.values())


def _items(name: str, given: Any) -> list[Any]:
    if isinstance(given, str | bytes) or not isinstance(given, Iterable):
        raise InputError(f"{name}: expected a sequence, found {brief(given)}")
    return list(given)


Key = tuple[str, int]
End = str | Key


@dataclass(frozen=True, repr=False)
class ScaleBar(Displayed):
    """Known distance between two places of a model.

    Attributes:
        a: name of a control point or of an image, or ``("point", id)`` or ``("image", id)``.
        b: the other place, likewise.
        distance: metres, or the unit of the model.
        sigma: standard deviation of the distance.
        role: "control", or "check": a check bar is compared with the model and never changes it.
        loss: robust loss of :class:`bundle.SolveOptions`.
        loss_scale: residual in sigmas beyond which the loss is robust.

    Raises:
        InputError: a value has a wrong type or range, or both places are the same.
    """

    a: End
    b: End
    distance: float
    sigma: float = SCALE_BAR_SIGMA
    role: str = "control"
    loss: str = field(default="trivial", kw_only=True)
    loss_scale: float = field(default=ROBUST_SCALES[1], kw_only=True)

    def __post_init__(self) -> None:
        for end in (self.a, self.b):
            if not isinstance(end, str) and (not isinstance(end, tuple) or len(end) != 2):
                raise InputError(
                    f'scale bar: expected names, ("point", id) or ("image", id), found {brief(end)}'
                )
        if self.a == self.b:
            raise InputError(f"{self.name}: expected two places, found the same twice")
        for name in ("distance", "sigma"):
            value = number(f"{self.name}: {name}", getattr(self, name), above=0)
            object.__setattr__(self, name, value)
        choice(f"{self.name}: role", self.role, ROLES)
        choice(f"{self.name}: loss", self.loss, LOSSES)

    @property
    def name(self) -> str:
        """The bar in messages."""
        return f"scale bar {self.words}"

    @property
    def words(self) -> str:
        """Both places."""
        ends = (end if isinstance(end, str) else f"{end[0]} {end[1]}" for end in (self.a, self.b))
        return " - ".join(map(shown, ends))

    def _display(self) -> Display:
        return Display(title=f"{self.name}: {self.distance:g} +- {self.sigma:g}, {self.role}")
