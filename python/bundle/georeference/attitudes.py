"""Attitude priors of a problem's images from files, and their residuals in a result."""

from __future__ import annotations

import dataclasses
import math
import os
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.display import Display
from bundle.base.records import dataclass
from bundle.base.words import few, noun, plural
from bundle.errors import InputError, shown
from bundle.georeference.attitude_priors import (
    AttitudePrior,
    GravityPrior,
    read_gravity,
    read_orientations,
)
from bundle.georeference.control_point import parse_sigma
from bundle.georeference.measurements import KnownPriors, MeasurementErrors, Solved
from bundle.georeference.problem_attitudes import (
    MEDIAN,
    TUKEY,
    Agreement,
    AttitudesOfKind,
    ProblemAttitudes,
    log,
)
from bundle.georeference.similarity import Similarity, moved
from bundle.georeference.text_lines import ImageFinder
from bundle.interface.georeference_options import GRAVITY_SIGMA, ORIENTATION_SIGMA, ROBUST_SCALES
from bundle.interface.option_fields import choice, number
from bundle.interface.options import LOSSES
from bundle.model.problem import Problem
from bundle.model.rigid_motions import rotation_matrices

Array = NDArray[np.float64]

MOST_NAMED = 3
MOST_IMAGES = 5  # number of listed images that disagree
KEYS = {"gravity": "gravity", "orientation": "orientations", "heading": "headings"}
"""Entries of the JSON report, by the noun of the measurements."""
FALSE_ALARM = 1e-3  # probability that any of n good measurements counts as wrong
FEWEST = 5  # number of measurements from which their residuals, not their sigmas, give the spread
FEWEST_SPREAD = 3  # number of measurements below which their sigmas alone give the spread
KEPT = 3.717  # length of a residual in scales below which it counts as one of the agreeing ones
TILT = 3.0  # factor of the sigma by which the axes of a model that cannot turn may be wrong
SMALLEST_TILT = math.radians(1)


@dataclass(frozen=True)
class ImageAttitude:
    """Image with an attitude prior."""

    image: str  # name of the image, or its id without names
    degrees: float  # angle between the model and the measurement
    apart: float  # the same angle in a model that is turned to the robust mean of the measurements
    sigmas: float  # length of the residual in standard deviations
    # True if observations tie the image, or another one of its rig's frame, to the model
    used: bool
    agrees: bool  # False if the measurement contradicts most others


@dataclass(frozen=True)
class AttitudeErrors:
    """Residuals of the priors of one kind in a model.

    Attributes:
        noun: "gravity", "orientation" or "heading".
        images: one entry per prior.
        rms_sigmas: root mean square of the coordinates of used images' residuals in standard
            deviations; 1 for right sigmas.
        ratio: median length of the residuals about their robust mean, over that of right sigmas.
        sigma: median standard deviation in degrees.
        off: degrees between the model and the robust mean of the measurements.
        within: bound of the error of the vertical (of the orientation, the heading) of all images
            but the suspects in degrees, which holds with 95 % if the measurements have independent
            errors: `off`, which is known, and the uncertainty of the robust mean.
    """

    noun: str
    images: tuple[ImageAttitude, ...]
    rms_sigmas: float
    ratio: float
    sigma: float
    off: float
    within: float

    @property
    def median(self) -> float:
        """Median angle in degrees."""
        return float(np.median([image.degrees for image in self.images]))

    @property
    def suspects(self) -> tuple[ImageAttitude, ...]:
        """Images whose measurement contradicts most others, the worst first."""
        wrong = [image for image in self.images if not image.agrees]
        return tuple(sorted(wrong, key=lambda image: -image.degrees))

    @property
    def sentence(self) -> str:
        """Describe the accuracy of the model in words."""
        verb = {
            "gravity": "Upright",
            "orientation": "Oriented",
            "heading": "Headings right",
        }[self.noun]
        count = plural(len(self.images), "image")
        about = " about the model's z axis" if self.noun == "heading" else ""
        wrong = [shown(image.image) for image in self.suspects]
        those = noun(len(wrong), "which contradicts", "which contradict")
        apart = f" (without {few(wrong, MOST_NAMED)}, {those} the others)"
        return (
            f"{verb} within {_rounded_up(self.within)} degrees{about}{apart if wrong else ''}: "
            f"{self.noun} of {count}, median angle {self.median:.2g} degrees."
        )

    def asdict(self) -> dict[str, Any]:
        """Return the content of the JSON report."""
        return {
            "within": self.within,
            "off": self.off,
            "rms_sigmas": self.rms_sigmas,
            "median_degrees": self.median,
            "images": [dataclasses.asdict(image) for image in self.images],
        }

    @staticmethod
    def of(group: AttitudesOfKind, problem: Problem, free: Problem | None = None) -> AttitudeErrors:
        """Return the residuals of the priors of a kind.

        Args:
            group: the priors.
            problem: the model.
            free: the same model as it is without the priors; None: the priors did not bend it.
        """
        size = group.kind.num_residuals
        tied = group.tied(problem)
        kept = group.of_tied(problem)
        judged = problem if free is None else _turned_to(problem, free, kept)
        found = kept.agreement(judged)
        # Residuals about the mean of the majority: a wrong measurement cannot hide by its
        # influence.
        ratio = float(np.median(found.lengths)) / MEDIAN[size]
        agrees = _agreeing(group, judged, found)
        error = _radius(size, found, kept.sigmas)
        off = math.acos(min(1.0, max(-1.0, (float(np.trace(found.rotation)) - 1) / 2)))
        angles, sigmas = group.angles(problem), group.whitened(problem)
        apart = group.angles(judged, found.rotation)
        images = tuple(
            ImageAttitude(
                problem.image_names[row] or str(problem.image_ids[row]),
                float(angles[k]),
                float(apart[k]),
                float(sigmas[k]),
                bool(tied[k]),
                bool(agrees[k]),
            )
            for k, row in enumerate(group.rows.tolist())
        )
        return AttitudeErrors(
            noun=group.kind.noun,
            images=images,
            rms_sigmas=float(np.sqrt((kept.whitened(problem) ** 2).mean() / size)),
            ratio=ratio,
            sigma=math.degrees(float(np.median(group.sigmas))),
            off=math.degrees(off),
            within=min(math.degrees(off + error), 180.0),
        )


def _rounded_up(value: float) -> str:
    """Round a bound up to two digits."""
    if not 0 < value < math.inf:
        return f"{value:.2g}"
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.ceil(value / unit - 1e-9) * unit:.3g}"


def _agreeing(group: AttitudesOfKind, problem: Problem, found: Agreement) -> NDArray[np.bool_]:
    """Return (n,) False for measurements that contradict most others."""
    size = group.kind.num_residuals
    ratio = float(np.median(found.lengths)) / MEDIAN[size]
    lengths = np.linalg.norm(group.turns(problem, found.rotation) / group.sigmas, axis=1)
    agrees: NDArray[np.bool_] = lengths <= _largest(size, len(found.lengths)) * max(1.0, ratio)
    return agrees


def _turned_to(problem: Problem, free: Problem, group: AttitudesOfKind) -> Problem:
    """Rotate the free model to the world of the other by the mean rotation of its good images.

    The rotation is the one nearest to the sum of R_i^T R'_i over the images that do not contradict
    the others.
    """
    chosen = np.ones(problem.num_images, bool)
    chosen[group.rows[~_agreeing(group, free, group.agreement(free))]] = False
    seen = np.bincount(problem.observation_image, minlength=problem.num_images) > 0
    rows = np.flatnonzero(chosen & seen)
    if not len(rows):
        return problem
    first, second = (rotation_matrices(one.cam_from_world[rows, :4]) for one in (problem, free))
    u, _, vt = np.linalg.svd(np.einsum("nji,njk->ik", first, second))
    turn = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    return moved(free, Similarity(1.0, turn, np.zeros(3)))


def _radius(size: int, found: Agreement, sigmas: Array) -> float:
    """Return the 95 % quantile of the error of a robust mean, in radians.

    The variance of one coordinate of the mean comes from n residuals a_i in sigmas. With Tukey's
    weights w_i, and at least five residuals,

        n / (n - 1) sum w a^2 / (size (sum w - 1)) / sum w / sigma^2;

    with three or four, where each one decides, the sandwich of the estimating equation psi = w a
    (Huber 1981), with k measurements within 3.717 scales and u_i = (a_i / (4.685 scale))^2,

        k / (k - 1) sum w^2 a^2 / sigma^2 / size / (sum (1 - u) (1 - 3 u) / sigma^2)^2;

    with fewer, the stated sigmas. Few residuals hardly determine their spread. With m degrees of
    freedom, the squared length over that of the residuals has, for two coordinates, the F
    distribution with 2 and m degrees: P(F > x) = (1 + 2 x / m)^(-m / 2), and m (0.05^(-2 / m) - 1)
    takes the place of chi squared's -2 log 0.05. The same factor serves for one and three
    coordinates. Three measurements, one of them bad, determine nothing: the angle is infinite.
    """
    lengths, weights = found.lengths, found.weights
    count, weight = len(lengths), float(weights.sum())
    precision = 1 / sigmas**2
    squares = float((weights * lengths**2).sum())
    plain = 1 / (weights[:, None] * precision).sum(axis=0)
    if count < FEWEST_SPREAD:
        variance = float(plain.max()) * max(squares / (size * weight), 1.0)
        return ROBUST_SCALES[size] * math.sqrt(variance)
    if count >= FEWEST:
        freedom = size * (weight - 1)
        variance = float(plain.max()) * squares / freedom * count / (count - 1)
    else:
        scale = max(1.0, float(np.median(lengths)) / MEDIAN[size])
        u = (lengths / (TUKEY * scale)) ** 2
        kept = int((lengths <= KEPT * scale).sum())
        slope = (np.where(u < 1, (1 - u) * (1 - 3 * u), 0)[:, None] * precision).sum(axis=0)
        if kept < FEWEST_SPREAD or not (slope > 0).all():
            return math.inf
        spread = ((weights * lengths) ** 2)[:, None] * precision
        freedom = size * (kept - 1)
        variance = float((spread.sum(axis=0) / slope**2).max()) / size * kept / (kept - 1)
    wider = freedom * math.expm1(-2 / freedom * math.log(0.05)) / (-2 * math.log(0.05))
    return ROBUST_SCALES[size] * math.sqrt(variance * wider)


def _largest(size: int, count: int) -> float:
    """Return a bound in sigmas that the largest of n good residuals rarely exceeds.

    The quantile of the chi distribution by the cube root of Wilson and Hilferty (1931).
    """
    z = NormalDist().inv_cdf(1 - FALSE_ALARM / count)
    part = 2 / (9 * size)
    return math.sqrt(size * (1 - part + z * math.sqrt(part)) ** 3)


@dataclass(frozen=True)
class ErrorsOfAttitudes(MeasurementErrors):
    """Residuals of all attitude priors in a result, by kind."""

    kinds: tuple[AttitudeErrors, ...]

    @property
    def entries(self) -> dict[str, Any]:
        """Entries of the JSON report."""
        return {KEYS[errors.noun]: errors.asdict() for errors in self.kinds}

    @property
    def sentences(self) -> list[str]:
        """Accuracy of the model in words, by kind."""
        return [errors.sentence for errors in self.kinds]

    @property
    def displays(self) -> tuple[Display, ...]:
        """Table of residuals by kind, and images whose measurement contradicts the others."""
        rows = tuple(
            (
                errors.noun,
                str(len(errors.images)),
                f"{errors.median:.3g}",
                f"{errors.rms_sigmas:.2f}",
                f"{errors.off:.2g}",
                str(len(errors.suspects)),
            )
            for errors in self.kinds
        )
        numbers = ("median [degrees]", "rms [sigmas]", "mean off by [degrees]", "disagree")
        wrong = (
            Display(
                title=f"{errors.noun.capitalize()} against most others",
                head=(f"{errors.noun} against most others", "degrees", "sigmas"),
                rows=tuple(
                    (shown(image.image), f"{image.degrees:.1f}", f"{image.sigmas:.1f}")
                    for image in errors.suspects
                ),
                most=MOST_IMAGES,
            )
            for errors in self.kinds
            if errors.suspects
        )
        return (Display(title="Attitudes", head=("", "images", *numbers), rows=rows), *wrong)


@dataclass(frozen=True)
class Attitudes(KnownPriors):
    """Attitude priors that were read for a problem.

    Attributes:
        priors: priors for ``bundle.solve(problem, priors=...)``, of images by id.
        notes: sentences on images without a measurement.
    """

    priors: tuple[AttitudePrior, ...]
    notes: tuple[str, ...] = ()

    def scaled(self, gravity: float, orientation: float) -> Attitudes:
        """Return the priors with sigmas times a factor: of gravity, and of all others."""
        if gravity == orientation == 1:
            return self
        priors = []
        for prior in self.priors:
            factor = gravity if isinstance(prior, GravityPrior) else orientation
            given: Any = prior
            sigma = np.asarray(given.sigma_degrees) * factor
            one = float(sigma) if sigma.ndim == 0 else tuple(sigma.tolist())
            priors.append(dataclasses.replace(given, sigma_degrees=one))
        return dataclasses.replace(self, priors=tuple(priors))

    def errors(
        self, problem: Problem, *, turned: bool = False, free: Problem | None = None
    ) -> tuple[AttitudeErrors, ...]:
        """Return the residuals in a model, by kind.

        Args:
            problem: the model.
            turned: True to turn the model to the priors first.
            free: the same model as it is without the priors; None: unknown.
        """
        known = ProblemAttitudes.make(problem, self.priors)
        if turned and (similarity := known.placement(problem)) is not None:
            problem = moved(problem, similarity)
        return tuple(AttitudeErrors.of(group, problem, free) for group in known.groups)

    def errors_of(self, result: Solved) -> ErrorsOfAttitudes:
        """Return the residuals in a result, with the spread of a model without these priors."""
        return ErrorsOfAttitudes(self.errors(result.problem, free=result.without_attitudes))

    def check_kept(self, problem: Problem, reason: str) -> None:
        """Refuse a model that its attitudes contradict and that cannot be turned.

        Raises:
            InputError: the axes of the model are wrong by more than their uncertainty.
        """
        for group in ProblemAttitudes.make(problem, self.priors).groups:
            turn = log(group.of_tied(problem).agreement(problem).rotation[None])[0]
            most = np.maximum(TILT * np.median(group.sigmas, axis=0), SMALLEST_TILT)
            if np.linalg.norm(turn / most) <= 1:
                continue
            is_gravity = group.kind is GravityPrior
            raise InputError(
                f"{'gravity' if is_gravity else 'orientations'}: expected a model with "
                f"{'z up' if is_gravity else 'axes east, north, up'} {reason}, found one that is "
                f"{math.degrees(float(np.linalg.norm(turn))):.3g} degrees off"
            )


def read_attitudes(
    problem: Problem,
    *,
    gravity: str | os.PathLike[str] | None = None,
    orientations: str | os.PathLike[str] | None = None,
    images: str | os.PathLike[str] | None = None,
    gravity_sigma: float = GRAVITY_SIGMA,
    orientation_sigma: str | tuple[float, float] = ORIENTATION_SIGMA,
    prior_loss: str = "trivial",
    prior_loss_scale: float | None = None,
) -> Attitudes:
    """Read directions of gravity, orientations and headings of a problem's images.

    Args:
        problem: problem of the images.
        gravity: file with directions of gravity.
        orientations: file with orientations or headings, or "xmp" for DJI's gimbal angles.
        images: folder of the images, for "xmp".
        gravity_sigma: standard deviation in degrees for directions without their own.
        orientation_sigma: standard deviations of heading and tilt in degrees, such as "5/1", for
            orientations without their own.
        prior_loss: robust loss of each residual.
        prior_loss_scale: sigmas beyond which the loss is robust; None: a length that 5 % of good
            residuals exceed.

    Raises:
        InputError: a file or an argument is wrong.
        OSError: a file cannot be read.
    """
    loss = choice("prior_loss", prior_loss, LOSSES)
    scale = prior_loss_scale
    if scale is not None:
        scale = number("prior_loss_scale", scale, above=0)
    finder = ImageFinder(problem)
    priors: list[AttitudePrior] = []
    notes: tuple[str, ...] = ()
    if gravity is not None:
        sigma = number("gravity_sigma", gravity_sigma, above=0)
        priors += read_gravity(gravity, finder, sigma)
    if orientations is not None:
        sigmas = parse_sigma("orientation_sigma", orientation_sigma, "degrees")
        if orientations == "xmp":
            found, notes = _from_xmp(problem, images, sigmas)
            priors += found
        else:
            priors += read_orientations(orientations, finder, sigmas)
    if loss != "trivial":
        change: dict[str, Any] = {"loss": loss, "loss_scale": scale}
        priors = [dataclasses.replace(prior, **change) for prior in priors]
    return Attitudes(tuple(priors), notes)


def attitudes_given(
    problem: Problem,
    *,
    gravity_sigma_scale: float = 1.0,
    orientation_sigma_scale: float = 1.0,
    **options: Any,
) -> Attitudes:
    """Return the attitudes that the options of a command name."""
    known = read_attitudes(problem, **options)
    return known.scaled(gravity_sigma_scale, orientation_sigma_scale)


def _from_xmp(
    problem: Problem, folder: str | os.PathLike[str] | None, sigmas: tuple[float, float]
) -> tuple[list[AttitudePrior], tuple[str, ...]]:
    """Return priors of the images with gimbal angles, and notes about the others."""
    from bundle.georeference.exif_gps import files_of_images, read_dji
    from bundle.georeference.gps_positions import counted_images

    if folder is None:
        raise InputError("images: expected the folder of the images, for orientations xmp")
    files, missing = files_of_images(folder, problem.image_names)
    priors: list[AttitudePrior] = []
    silent = []
    for row, name in enumerate(problem.image_names):
        if name not in files:
            continue
        record = read_dji(files[name])
        if record.has_angles:
            priors.append(record.prior(int(problem.image_ids[row]), sigmas))
        else:
            silent.append(name)
    if not priors:
        raise InputError(
            f"{shown(folder)}: expected DJI's gimbal angles in the XMP of the images, found 0 in "
            f"{plural(len(files), 'file')}"
        )
    return priors, (
        *counted_images(missing, f"not in {shown(folder)}"),
        *counted_images(silent, "without gimbal angles in the XMP"),
    )
