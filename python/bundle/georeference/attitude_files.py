"""Text files of attitudes: directions of gravity, orientations, headings.

:mod:`.image_lines` has the rules for words and names. Gravity has one line for each image: down in
the camera's frame (right, down, forward; any length) and a standard deviation in degrees, which may
be missing::

    IMG_0001.jpg   0.02  0.99  0.10   0.5
    IMG_0002.jpg  -0.01  9.79  0.55

The first line of orientations names the columns. It is one of these, with or without the columns of
standard deviations in degrees (``sigma_tilt`` alone may be missing, too)::

    name  yaw pitch roll   sigma_heading sigma_tilt
    name  qx qy qz qw      sigma_heading sigma_tilt
    name  qw qx qy qz      sigma_heading sigma_tilt
    name  heading          sigma_heading

Angles are degrees; ``attitude_priors`` defines yaw, pitch and roll. Quaternions are cam_from_world
rotations, as COLMAP has them, in a world of east, north, up. The heading is that of the viewing
direction.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from bundle.errors import InputError
from bundle.georeference.attitude_priors import (
    AttitudePrior,
    GravityPrior,
    HeadingPrior,
    OrientationPrior,
    as_sigma,
    quaternion_of_angles,
)
from bundle.georeference.image_index import ImageFinder
from bundle.georeference.text_lines import content_lines, headed_rows, image_rows, row_numbers

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

    Args:
        sigma: standard deviation in degrees for lines without it.

    Raises:
        InputError: the file has no line, a line has other words, an image is unknown or has two
            lines, a direction is zero, or a standard deviation is not above 0.
        OSError: the file cannot be read.
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

    Args:
        sigmas: standard deviations of heading and tilt in degrees for lines without them.

    Raises:
        InputError: the header is unknown, or as :func:`read_gravity`.
        OSError: the file cannot be read.
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
