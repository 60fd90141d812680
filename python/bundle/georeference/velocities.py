"""Velocities of a problem's images: priors, files, DJI's XMP, factors, residuals.

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
or downwards, so it is ignored.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.errors import InputError, shown
from bundle.georeference.control_point import parse_sigma
from bundle.georeference.measurements import FoundPriors, KnownPriors, MeasurementErrors, Solved
from bundle.georeference.text_lines import ImageFinder, headed_rows, row_numbers, rows_of_images
from bundle.georeference.vector_priors import VectorPrior
from bundle.graphs.factors.image_factors import VelocityFactor
from bundle.interface.georeference_options import ROBUST_SCALE, VELOCITY_SIGMA
from bundle.model.problem import Problem
from bundle.model.rigid_motions import rotation_matrices

SIGMAS = ("sigma_horizontal", "sigma_vertical")
NORTH_EAST_DOWN = ("north", "east", "down")
LAYOUTS: dict[tuple[str, ...], tuple[str, ...]] = dict.fromkeys(
    (("vx", "vy", "vz"), ("east", "north", "up"), NORTH_EAST_DOWN), SIGMAS
)
"""Columns after the name, and the standard deviations that may follow."""
VERTICAL = ("vz", "up", "down")


# Prior on the velocity of an image with a rolling shutter.
#
# While an image is read, its twist (w, v) moves the camera. With the readout rho as a share of a
# frame, f frames per second, and a the antenna in the camera frame, the antenna's velocity is
#
#     V = -f R^T (v + w x a) / rho,
#
# and the prior costs 1/2 rho(r^T r), r = L^-1 (V - measured), Sigma = L L^T, as for positions.
# ``cpp/core/factors/velocity_factor.h`` has the derivation.


@dataclass(frozen=True, eq=False, repr=False)
class VelocityPrior(VectorPrior):
    """Measured velocity of an image with a rolling shutter, for example from GPS (Doppler).

    Attributes:
        image: id or name of the image.
        velocity: (3,) velocity of the projection centre, or of the antenna, along the axes of the
            world: east, north, up for priors of :func:`bundle.georeference.gps_priors`. In length
            units per second (:attr:`bundle.RollingShutter.frame_rate` has the frames per second).
            If the third coordinate is nan, only the horizontal velocity counts.
        sigma: standard deviation: one number, (horizontal, vertical), or one per axis. An axis with
            an infinite sigma is ignored. Give either ``sigma`` or ``covariance``.
        covariance: (3, 3) symmetric positive definite, in squared units of the velocity.
        lever_arm: (3,) position of the antenna in the camera frame (x right, y down, z forward), in
            the length unit.
        loss: robust loss of :class:`bundle.SolveOptions`.
        loss_scale: length of the residual in sigmas beyond which the loss is robust; by default
            2.795, which 5 % of good velocities exceed.

    Raises:
        InputError: a value has a wrong type, shape or range; the message names the image.
    """

    velocity: ArrayLike
    sigma: ArrayLike | None = None

    noun = "velocity"

    def factor(self, image_id: int, camera_id: int, frame_rate: float) -> VelocityFactor:
        """Return the factor of a solve for the image and camera with these ids."""
        return VelocityFactor(
            ("image", image_id),
            ("twist", image_id),
            ("readout", camera_id),
            self.known / frame_rate,
            self.information * frame_rate**2,
            lever_arm=self.lever_arm,
            **self._robust,
        )


@dataclass(frozen=True)
class Velocities(KnownPriors):
    """Velocity priors that were read for a problem.

    Attributes:
        priors: priors for ``bundle.solve(problem, priors=...)``, of images by id.
    """

    priors: tuple[VelocityPrior, ...]

    def errors_of(self, result: Solved) -> VelocityErrors | None:
        """Return the residuals in a result."""
        return self.errors(result.problem)

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
    from bundle.georeference.exif_gps import files_of_images, read_dji

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


Array = NDArray[np.float64]


@dataclass(frozen=True)
class ProblemVelocities(FoundPriors):
    """Velocity priors, and their images in a problem."""

    priors: tuple[VelocityPrior, ...]  # priors in the order given
    rows: NDArray[np.int64]  # (n,) index of each prior's image

    @staticmethod
    def make(problem: Problem, priors: Sequence[VelocityPrior]) -> ProblemVelocities:
        """Find the image of each prior, and check that its motion gives a velocity."""
        given = tuple(priors)
        rows = rows_of_images(problem, given)
        shutter = problem.rolling_shutter
        for prior, row in zip(given, rows.tolist(), strict=True):
            camera = int(problem.image_camera[row])
            name = f"camera {problem.camera_ids[camera]}"
            if shutter is None or not shutter.is_rolling[camera]:
                raise InputError(
                    f"priors: {prior.name}: expected an image with a rolling shutter, found the "
                    f"global shutter of {name}"
                )
            if np.isnan(shutter.readout[camera]):
                raise InputError(
                    f"priors: {prior.name}: expected the readout of {name}, without which a twist "
                    "has no velocity, found an unknown one"
                )
            if np.isnan(shutter.frame_rate):
                raise InputError(
                    f"priors: {prior.name}: expected the frame rate of the video "
                    "(RollingShutter.frame_rate; --frame-rate), found an unknown one"
                )
        return ProblemVelocities(given, rows)

    def factors(self, problem: Problem) -> list[VelocityFactor]:
        """Return a factor for each prior, in order."""
        if problem.rolling_shutter is None:
            return []
        cameras, shutter = problem.image_camera[self.rows], problem.rolling_shutter
        ids = problem.image_ids[self.rows].tolist(), problem.camera_ids[cameras].tolist()
        return [
            prior.factor(image, camera, shutter.frame_rate)
            for prior, image, camera in zip(self.priors, *ids, strict=True)
        ]

    def residuals(self, problem: Problem) -> Array:
        """Return (n, 3) velocities in the problem minus measured ones; nan if unknown."""
        shutter = problem.rolling_shutter
        assert shutter is not None
        twists = shutter.twist[self.rows]
        levers = np.array([prior.lever_arm for prior in self.priors], np.float64).reshape(-1, 3)
        measured = np.array([prior.velocity for prior in self.priors], np.float64).reshape(-1, 3)
        speeds = twists[:, 3:] + np.cross(twists[:, :3], levers)
        per_second = shutter.frame_rate / shutter.readout[problem.image_camera[self.rows]]
        rotations = rotation_matrices(problem.cam_from_world[self.rows, :4])
        return np.asarray(
            -per_second[:, None] * np.einsum("nji,nj->ni", rotations, speeds) - measured
        )

    def errors(self, problem: Problem) -> VelocityErrors:
        """Return the residuals in a model."""
        residuals = self.residuals(problem)
        pairs = list(zip(self.priors, residuals, strict=True))
        whitened = np.array([prior.whiten(row) for prior, row in pairs]).reshape(-1, 3)
        counts = np.array([np.diag(prior.full_covariance) < 1e100 for prior in self.priors])
        images = tuple(
            ImageVelocity(
                problem.image_names[row] or str(problem.image_ids[row]),
                x,
                y,
                z,
                float(np.linalg.norm(whitened[k])),
            )
            for k, (row, (x, y, z)) in enumerate(
                zip(self.rows.tolist(), residuals.tolist(), strict=True)
            )
        )
        return VelocityErrors(images, float(np.sqrt((whitened**2).sum() / counts.sum())))


@dataclass(frozen=True)
class ImageVelocity:
    """Image with a velocity prior.

    Attributes:
        image: name of the image, or its id without names.
        x: velocity in the model minus the measured one along the world's first axis (east).
        y: the same along the second axis (north).
        z: the same along the third axis (up); nan if it was not measured.
        sigmas: length of the residual in standard deviations.
    """

    image: str
    x: float
    y: float
    z: float
    sigmas: float


@dataclass(frozen=True)
class VelocityErrors(MeasurementErrors):
    """Residuals of velocity priors in a model.

    Attributes:
        images: one entry per prior.
        rms_sigmas: root mean square of the residuals' coordinates in standard deviations; at most
            about 1 for right sigmas.
    """

    images: tuple[ImageVelocity, ...]
    rms_sigmas: float

    @property
    def median(self) -> float:
        """Median length of the residuals, metres per second."""
        xyz = np.array([(image.x, image.y, image.z) for image in self.images])
        return float(np.median(np.linalg.norm(np.nan_to_num(xyz), axis=1)))

    @property
    def sentence(self) -> str:
        """Describe the residuals in words."""
        return (
            f"Velocities of {plural(len(self.images), 'image')}: median difference "
            f"{self.median:.2g} m/s, {self.rms_sigmas:.2f} sigmas (rms)."
        )

    @property
    def sentences(self) -> list[str]:
        """The sentence, for reports."""
        return [self.sentence]

    @property
    def entries(self) -> dict[str, Any]:
        """Entries of the JSON report."""
        return {"velocities": self.asdict()}

    def asdict(self) -> dict[str, Any]:
        """Return the content of the JSON report."""
        return {
            "rms_sigmas": self.rms_sigmas,
            "median": self.median,
            "images": [dataclasses.asdict(image) for image in self.images],
        }
