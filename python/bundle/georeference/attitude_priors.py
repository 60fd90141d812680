"""Priors on the attitude of an image, and their files: direction of gravity, orientation, heading.

The axes of the world are east, north, up; without positions, only up is defined. With R the
rotation of cam_from_world and sigma in radians, the priors add 1/2 rho(r^T r) to the cost of a
solve, with

    gravity:      r = (R (0, 0, -1) - measured direction) / sigma, for unit vectors,
    orientation:  r = W Log(Z^T R), along the axes of the world, Z the measured rotation,
    heading:      r = heading of the camera's axis - measured heading / sigma.

At an angle x between both directions, gravity's r has the length 2 sin(x / 2) / sigma: x / sigma
for small angles, and no pull by a direction that is upside down. Gravity leaves the turn about the
vertical, the position and the scale of the world free. Gravity with headings leaves position and
scale, and so do orientations. ``cpp/core/factors/attitude_factors.h`` has the derivations.

Yaw, pitch and roll turn the axes of a body (forward, right, down) from north, east, down, in this
order (aerospace; DJI's gimbal angles). The camera looks forward, and its x axis points to the
right:

    yaw     heading of the viewing direction, clockwise from north,
    pitch   above the horizon: -90 looks straight down,
    roll    about the viewing direction, clockwise as seen by the camera's user.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.base.arrays import as_array
from bundle.base.display import Display
from bundle.base.records import dataclass
from bundle.errors import InputError, brief
from bundle.georeference.text_lines import (
    ImageFinder,
    content_lines,
    headed_rows,
    image_rows,
    row_numbers,
)
from bundle.georeference.vector_priors import ImagePrior, three_numbers
from bundle.graphs.factors.factors import Factor
from bundle.graphs.factors.image_factors import (
    DOWN,
    FORWARD,
    DirectionFactor,
    HeadingFactor,
    RotationFactor,
)
from bundle.interface.option_fields import number
from bundle.model.rigid_motions import quaternion_from_matrix

Array = NDArray[np.float64]

LEAST_SIGMA, MOST_SIGMA = 1e-12, 1e12
"""Range of standard deviations in degrees, whose squares neither overflow nor vanish in sums."""


@dataclass(frozen=True, eq=False, repr=False)
class AttitudePrior(ImagePrior):
    """Base class of priors on the attitude of an image."""

    def factor(self, image_id: int) -> Factor:
        """Return the factor of a solve for the image with this id."""
        raise NotImplementedError

    def _direction(self, attribute: str) -> Array:
        name = f"{self.name}: {attribute}"
        vector = three_numbers(name, getattr(self, attribute))
        largest = float(np.abs(vector).max()) if np.isfinite(vector).all() else 0.0
        if not largest > 0:
            raise InputError(
                f"{name}: expected finite numbers that are not all zero, "
                f"found {brief(vector.tolist())}"
            )
        vector = vector / largest
        return np.asarray(vector / np.linalg.norm(vector))


@dataclass(frozen=True, eq=False, repr=False)
class GravityPrior(AttitudePrior):
    """Measured direction of gravity, from an accelerometer or a gimbal.

    Attributes:
        image: id or name of the image.
        direction: (3,) down in the camera's frame (x right, y down, z forward), of any length;
            stored with length 1. A level camera has (0, 1, 0).
        sigma_degrees: standard deviation, about each of two axes perpendicular to the direction.
        loss: robust loss of :class:`bundle.SolveOptions`.
        loss_scale: angle in sigmas beyond which the loss is robust; by default 2.448, which 5 % of
            good directions exceed.

    Raises:
        InputError: a value has a wrong type, shape or range; the message names the image.
    """

    direction: ArrayLike
    sigma_degrees: float

    noun = "gravity"
    num_residuals = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        self._set(direction=self._direction("direction"))
        sigma = as_sigma(f"{self.name}: sigma_degrees", self.sigma_degrees)
        self._set(sigma_degrees=sigma)

    def factor(self, image_id: int) -> DirectionFactor:
        """Return the factor of a solve for the image with this id."""
        sigma = math.radians(self.sigma_degrees)
        return DirectionFactor(
            ("image", image_id), self.direction, sigma, axis=DOWN, **self._robust
        )

    def _display(self) -> Display:
        down = ", ".join(f"{value:.6g}" for value in np.asarray(self.direction))
        return self._shown(("down", down), ("sigma", f"{self.sigma_degrees:g} degrees"))


@dataclass(frozen=True, eq=False, repr=False)
class OrientationPrior(AttitudePrior):
    """Measured rotation of an image in a world whose axes are east, north, up.

    Attributes:
        image: id or name of the image.
        rotation: (4,) quaternion qx qy qz qw of the rotation of cam_from_world, of any length;
            stored with length 1.
        sigma_degrees: standard deviation: one number, or (heading, tilt). The heading is the angle
            about up; the tilt applies to each horizontal axis.
        loss: robust loss of :class:`bundle.SolveOptions`.
        loss_scale: length of the residual in sigmas beyond which the loss is robust; by default
            2.795, which 5 % of good orientations exceed.

    Raises:
        InputError: a value has a wrong type, shape or range; the message names the image.
    """

    rotation: ArrayLike
    sigma_degrees: ArrayLike

    noun = "orientation"
    num_residuals = 3

    def __post_init__(self) -> None:
        super().__post_init__()
        name = f"{self.name}: rotation"
        rotation = as_array(name, self.rotation)
        if rotation.shape != (4,) or not np.isfinite(rotation).all() or not rotation.any():
            raise InputError(
                f"{name}: expected a quaternion qx qy qz qw, found {brief(rotation.tolist())}"
            )
        rotation = rotation / np.abs(rotation).max()
        self._set(rotation=rotation / np.linalg.norm(rotation))
        name = f"{self.name}: sigma_degrees"
        sigmas = np.atleast_1d(as_array(name, self.sigma_degrees))
        if sigmas.shape not in ((1,), (2,)):
            raise InputError(
                f"{name}: expected one number above 0, or (heading, tilt), "
                f"found {brief(self.sigma_degrees)}"
            )
        for sigma in sigmas.tolist():
            as_sigma(name, sigma)
        self._set(sigma_degrees=np.array([sigmas[0], sigmas[-1]]))

    @staticmethod
    def from_angles(
        image: int | str, yaw: float, pitch: float, roll: float, sigma_degrees: ArrayLike
    ) -> OrientationPrior:
        """Return the prior of yaw, pitch and roll in degrees; the module defines these angles."""
        rotation = quaternion_of_angles(np.array([[yaw, pitch, roll]], np.float64))[0]
        return OrientationPrior(image, rotation, sigma_degrees)

    def factor(self, image_id: int) -> RotationFactor:
        """Return the factor of a solve for the image with this id."""
        heading, tilt = np.radians(np.asarray(self.sigma_degrees))
        information = np.diag([tilt**-2, tilt**-2, heading**-2])
        return RotationFactor(("image", image_id), self.rotation, information, **self._robust)

    def _display(self) -> Display:
        rotation = ", ".join(f"{value:.6g}" for value in np.asarray(self.rotation))
        heading, tilt = np.asarray(self.sigma_degrees)
        return self._shown(
            ("cam_from_world", rotation), ("sigma", f"heading {heading:g}, tilt {tilt:g} degrees")
        )


@dataclass(frozen=True, eq=False, repr=False)
class HeadingPrior(AttitudePrior):
    """Measured heading of an image, from a compass.

    Attributes:
        image: id or name of the image.
        heading_degrees: heading of ``axis``, clockwise from north; the world's axes are east,
            north, up. Stored without whole turns.
        sigma_degrees: standard deviation.
        axis: (3,) axis in the camera's frame; by default the viewing direction. Use (0, -1, 0), the
            upper edge of the image, for cameras that look down.
        loss: robust loss of :class:`bundle.SolveOptions`.
        loss_scale: residual in sigmas beyond which the loss is robust; by default 1.96, which 5 %
            of good headings exceed.

    Raises:
        InputError: a value has a wrong type, shape or range; the message names the image.
    """

    heading_degrees: float
    sigma_degrees: float
    axis: ArrayLike = field(default=FORWARD, kw_only=True)

    noun = "heading"
    num_residuals = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        heading = number(f"{self.name}: heading_degrees", self.heading_degrees)
        self._set(heading_degrees=math.fmod(heading, 360))
        sigma = as_sigma(f"{self.name}: sigma_degrees", self.sigma_degrees)
        self._set(sigma_degrees=sigma)
        self._set(axis=self._direction("axis"))

    def factor(self, image_id: int) -> HeadingFactor:
        """Return the factor of a solve for the image with this id."""
        heading, sigma = math.radians(self.heading_degrees), math.radians(self.sigma_degrees)
        key = ("image", image_id)
        return HeadingFactor(key, heading, sigma, axis=self.axis, **self._robust)

    def _display(self) -> Display:
        sigma = f"{self.sigma_degrees:g} degrees"
        return self._shown(("heading", f"{self.heading_degrees:g} degrees"), ("sigma", sigma))


def as_sigma(name: str, value: Any) -> float:
    """Return a standard deviation in degrees."""
    return number(name, value, minimum=LEAST_SIGMA, maximum=MOST_SIGMA)


def quaternion_of_angles(angles: Array) -> Array:
    """Return (n, 4) quaternions of cam_from_world of (n, 3) yaw, pitch and roll in degrees."""
    radians = np.radians(np.fmod(angles, 360))
    (cy, cp, cr), (sy, sp, sr) = np.cos(radians).T, np.sin(radians).T
    # Rz(yaw) Ry(pitch) Rx(roll): forward, right, down of the body in columns, north, east, down.
    ned = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
    enu = np.stack([ned[1], ned[0], -ned[2]])  # (3, 3, n): rows of the world, columns of the body
    return quaternion_from_matrix(np.ascontiguousarray(enu[:, [1, 2, 0]].transpose(2, 1, 0)))


# Text files of attitudes, as docs/gravity.md describes them: ``LAYOUTS`` has their columns.


SIGMAS = ("sigma_heading", "sigma_tilt")
LAYOUTS = {
    ("yaw", "pitch", "roll"): SIGMAS,
    ("qx", "qy", "qz", "qw"): SIGMAS,
    ("qw", "qx", "qy", "qz"): SIGMAS,
    ("heading",): SIGMAS[:1],
}
"""Columns after the name, and the standard deviations that may follow."""


def read_gravity(
    path: str | os.PathLike[str], images: ImageFinder, sigma: float
) -> list[GravityPrior]:
    """Read directions of gravity.

    ``sigma``: standard deviation in degrees for lines without it.
    """

    def prior(place: str, image: int, words: Sequence[str]) -> GravityPrior:
        numbers = row_numbers(place, ("gx", "gy", "gz", "sigma"), words, required=3)
        if not np.any(numbers[:3]):
            raise InputError(f"{place}: expected a direction gx gy gz, found 0 0 0")
        given = numbers[3] if len(numbers) > 3 else sigma
        return GravityPrior(image, numbers[:3], _above_zero(place, "sigma", given))

    layout = "name gx gy gz [sigma]"
    return [prior(*row) for row in image_rows(path, images, content_lines(path), layout)]


def read_orientations(
    path: str | os.PathLike[str], images: ImageFinder, sigmas: tuple[float, float]
) -> list[AttitudePrior]:
    """Read orientations or headings.

    ``sigmas``: standard deviations of heading and tilt in degrees for lines without them.
    """
    columns, names, rows = headed_rows(
        path, images, LAYOUTS, "name yaw pitch roll [sigma_heading [sigma_tilt]]"
    )
    make = _maker(columns)

    def prior(place: str, image: int, words: Sequence[str]) -> AttitudePrior:
        numbers = row_numbers(place, names, words, required=len(columns))
        given = [
            _above_zero(place, name, value)
            for name, value in zip(SIGMAS, numbers[len(columns) :], strict=False)
        ]
        heading, tilt = (given * 2)[:2] if given else sigmas
        if columns[0].startswith("q") and not np.any(numbers[:4]):
            raise InputError(f"{place}: expected a quaternion, found 0 0 0 0")
        return make(image, numbers[: len(columns)], (heading, tilt))

    return [prior(*row) for row in rows]


def gravity_text(priors: Iterable[GravityPrior], name: Callable[[Any], str]) -> str:
    """Return the content of a file of gravity; ``name`` returns the name of an image."""
    lines = (
        _line(name(one.image), [*np.asarray(one.direction), one.sigma_degrees]) for one in priors
    )
    return "".join(["# name gx gy gz sigma_degrees\n", *lines])


def orientation_text(priors: Iterable[OrientationPrior], name: Callable[[Any], str]) -> str:
    """Return the content of a file of orientations; ``name`` returns the name of an image."""
    lines = (
        _line(name(one.image), [*np.asarray(one.rotation), *np.asarray(one.sigma_degrees)])
        for one in priors
    )
    return "".join([f"name qx qy qz qw {' '.join(SIGMAS)}\n", *lines])


def _line(name: str, numbers: Sequence[float]) -> str:
    word = f'"{name}"' if any(map(str.isspace, name)) else name
    return " ".join([word, *(repr(float(number)) for number in numbers)]) + "\n"


def _maker(
    columns: tuple[str, ...],
) -> Callable[[int, list[float], tuple[float, float]], AttitudePrior]:
    """Return the function that makes a prior of an image, its numbers and its sigmas."""
    if columns == ("heading",):
        return lambda image, numbers, sigmas: HeadingPrior(image, numbers[0], sigmas[0])
    if columns[0] == "yaw":
        return lambda image, numbers, sigmas: OrientationPrior(
            image, quaternion_of_angles(np.array([numbers]))[0], sigmas
        )
    order = [columns.index(name) for name in ("qx", "qy", "qz", "qw")]
    return lambda image, numbers, sigmas: OrientationPrior(
        image, [numbers[k] for k in order], sigmas
    )


def _above_zero(place: str, name: str, value: float) -> float:
    if not value > 0:
        raise InputError(f"{place}: {name}: expected degrees above 0, found {value:g}")
    return as_sigma(f"{place}: {name}", value)
