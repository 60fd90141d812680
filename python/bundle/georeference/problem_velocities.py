"""Velocity priors of a problem: their images, factors, and residuals."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.errors import InputError
from bundle.georeference.prior_images import rows_of_images
from bundle.georeference.velocity_prior import VelocityPrior
from bundle.graphs.factors.twist_factors import VelocityFactor
from bundle.model.problem import Problem
from bundle.model.rotations import rotation_matrices

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ProblemVelocities:
    """Velocity priors, and their images in a problem.

    Attributes:
        priors: priors in the order given.
        rows: (n,) index of each prior's image.
    """

    priors: tuple[VelocityPrior, ...]
    rows: NDArray[np.int64]

    @staticmethod
    def make(problem: Problem, priors: Sequence[VelocityPrior]) -> ProblemVelocities:
        """Find the image of each prior, and check that its motion gives a velocity.

        Raises:
            InputError: an image is not in the problem or has two priors, its shutter is global, its
                readout is unknown, or the frame rate is.
        """
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
class VelocityErrors:
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

    def asdict(self) -> dict[str, Any]:
        """Return the content of the JSON report."""
        return {
            "rms_sigmas": self.rms_sigmas,
            "median": self.median,
            "images": [dataclasses.asdict(image) for image in self.images],
        }
