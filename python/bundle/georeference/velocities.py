"""Velocities of a problem's images, from a text file or from DJI's XMP.

The first line of a file names the columns, with or without those of standard deviations
(``sigma_vertical`` alone may be missing, too)::

    name  vx vy vz           sigma_horizontal sigma_vertical
    name  east north up      sigma_horizontal sigma_vertical
    name  north east down    sigma_horizontal sigma_vertical

:mod:`.image_lines` has the rules for words and names. Numbers are metres per second; the vertical
one may be ``nan``. vx, vy, vz are along the axes of the model that is written: east, north, up
after ``--gps`` or ``--gcp``.

DJI's XMP has the speeds to the north (``FlightXSpeed``) and to the east (``FlightYSpeed``) in
metres per second, as a multiple of 0.1. The manuals do not say whether ``FlightZSpeed`` is upwards
or downwards, so it does not count.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.errors import InputError, shown
from bundle.georeference.control_point import parse_sigma
from bundle.georeference.image_finder import ImageFinder
from bundle.georeference.image_lines import headed_rows, row_numbers
from bundle.georeference.prior_images import rows_of_images
from bundle.georeference.problem_velocities import ProblemVelocities, VelocityErrors
from bundle.georeference.velocity_prior import VelocityPrior
from bundle.interface.georeference_options import ROBUST_SCALE, VELOCITY_SIGMA
from bundle.model.problem import Problem

SIGMAS = ("sigma_horizontal", "sigma_vertical")
NORTH_EAST_DOWN = ("north", "east", "down")
LAYOUTS: dict[tuple[str, ...], tuple[str, ...]] = dict.fromkeys(
    (("vx", "vy", "vz"), ("east", "north", "up"), NORTH_EAST_DOWN), SIGMAS
)
"""Columns after the name, and the standard deviations that may follow."""
VERTICAL = ("vz", "up", "down")


@dataclass(frozen=True)
class Velocities:
    """Velocity priors that were read for a problem.

    Attributes:
        priors: priors for ``bundle.solve(problem, priors=...)``, of images by id.
    """

    priors: tuple[VelocityPrior, ...]

    def errors(self, problem: Problem) -> VelocityErrors | None:
        """Return the residuals in a model; None if a solve left the readout undetermined."""
        rows = rows_of_images(problem, self.priors)
        shutter = problem.rolling_shutter
        if shutter is None or np.isnan(shutter.readout[problem.image_camera[rows]]).any():
            return None
        return ProblemVelocities(self.priors, rows).errors(problem)


def read_velocities(
    problem: Problem,
    velocities: str | os.PathLike[str],
    *,
    images: str | os.PathLike[str] | None = None,
    velocity_sigma: Any = VELOCITY_SIGMA,
    antenna: ArrayLike = (0.0, 0.0, 0.0),
    prior_loss: str = "trivial",
    prior_loss_scale: float = ROBUST_SCALE,
) -> Velocities:
    """Read measured velocities of a problem's images with rolling shutters.

    Args:
        problem: problem of the images.
        velocities: path of a file (:mod:`bundle.georeference.velocities`), or "xmp" for DJI's
            speeds.
        images: folder of the images, for "xmp".
        velocity_sigma: standard deviation in metres per second, a number or (horizontal, vertical),
            for velocities without their own.
        antenna: (3,) position of the receiver in the camera frame, x right, y down, z forward,
            metres.
        prior_loss: robust loss of each velocity's residual.
        prior_loss_scale: sigmas beyond which the loss is robust.

    Raises:
        InputError: a file or an argument is wrong, an image has a global shutter, or its readout or
            the frame rate is unknown.
        OSError: a file cannot be read.
    """
    default = parse_sigma("velocity_sigma", velocity_sigma, "metres per second")
    sigma = (default.horizontal, default.vertical)
    settings = {"lever_arm": antenna, "loss": prior_loss, "loss_scale": prior_loss_scale}
    if velocities == "xmp":
        priors = _from_xmp(problem, images, sigma, settings)
    else:
        priors = _from_file(velocities, ImageFinder(problem), sigma, settings)
    ProblemVelocities.make(problem, priors)
    return Velocities(tuple(priors))


def velocity_text(priors: Iterable[VelocityPrior], name: Callable[[Any], str]) -> str:
    """Return the content of a file; ``name`` converts an image to its word."""
    lines = [f"name vx vy vz {' '.join(SIGMAS)}\n"]
    for prior in priors:
        word = name(prior.image)
        word = f'"{word}"' if any(map(str.isspace, word)) else word
        numbers = [*np.asarray(prior.velocity), *np.asarray(prior.sigma)[1:]]
        lines.append(" ".join([word, *(repr(float(number)) for number in numbers)]) + "\n")
    return "".join(lines)


def _from_file(
    path: str | os.PathLike[str],
    images: ImageFinder,
    sigma: tuple[float, float],
    settings: dict[str, Any],
) -> list[VelocityPrior]:
    example = f"name vx vy vz [{SIGMAS[0]} [{SIGMAS[1]}]]"
    columns, names, rows = headed_rows(path, images, LAYOUTS, example)

    def prior(place: str, image: int, words: Sequence[str]) -> VelocityPrior:
        numbers = row_numbers(place, names, words, required=3, unknown=VERTICAL)
        velocity, own = numbers[:3], numbers[3:]
        for column, value in zip(SIGMAS, own, strict=False):
            if not value > 0:
                raise InputError(f"{place}: {column}: expected m/s above 0, found {value:g}")
        if columns == NORTH_EAST_DOWN:
            velocity = [velocity[1], velocity[0], -velocity[2]]
        return VelocityPrior(image, velocity, own or sigma, **settings)

    return [prior(*row) for row in rows]


def _from_xmp(
    problem: Problem,
    folder: str | os.PathLike[str] | None,
    sigma: tuple[float, float],
    settings: dict[str, Any],
) -> list[VelocityPrior]:
    """Return the priors of images with a rolling shutter and with speeds."""
    from bundle.georeference.dji_xmp import read_dji
    from bundle.georeference.exif_gps import files_of_images

    if folder is None:
        raise InputError("images: expected the folder of the images, for velocities xmp")
    files, _ = files_of_images(folder, problem.image_names)
    shutter = problem.rolling_shutter
    priors = []
    for row, name in enumerate(problem.image_names):
        if name not in files:
            continue
        if shutter is not None and not shutter.is_rolling[problem.image_camera[row]]:
            continue
        record = read_dji(files[name])
        if math.isfinite(record.east) and math.isfinite(record.north):
            velocity = (record.east, record.north, math.nan)
            priors.append(VelocityPrior(int(problem.image_ids[row]), velocity, sigma, **settings))
    if not priors:
        raise InputError(
            f"{shown(folder)}: expected DJI's speeds in the XMP of images with a rolling shutter, "
            f"found 0 in {plural(len(files), 'file')}"
        )
    return priors
