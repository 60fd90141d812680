"""Priors of a solve from measured positions on the earth and from ground control points."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.base.arrays import at
from bundle.base.display import Display, Displayed
from bundle.base.paths import as_path, is_path
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.errors import InputError, brief
from bundle.georeference.alignment_result import ControlPointError, ImageError
from bundle.georeference.control_point import (
    GCP_SIGMA,
    GroundControlPoint,
    parse_pixel_sigma,
    parse_sigma,
)
from bundle.georeference.exif_gps import read_exif_gps
from bundle.georeference.gcp_list import given_control_points, with_check_points
from bundle.georeference.georeferenced import Georeference, origin_text, rig_notes
from bundle.georeference.gps_positions import (
    GpsPositions,
    matched,
    read_database_gps,
    read_geo_file,
    read_opensfm_gps,
    too_few,
    unmatched_notes,
    with_fix,
)
from bundle.georeference.local_frame import LocalFrame, is_opensfm
from bundle.georeference.measurements import KnownPriors, Solved
from bundle.georeference.other_readings import check_readings
from bundle.georeference.point_check import SurveyChecks
from bundle.georeference.prior_alignment import ProblemPriors, robust_similarity
from bundle.georeference.similarity_fit import fit_similarity
from bundle.georeference.survey import Survey
from bundle.georeference.text_lines import ImageIndex
from bundle.georeference.vector_priors import PositionPrior
from bundle.interface.georeference_options import GCP_PIXEL_SIGMA, ROBUST_SCALE
from bundle.io.database_images import is_database
from bundle.model.problem import Problem

GPS_SIGMA = (2.0, 5.0)
"""Default sigma, horizontal and vertical, in metres: a receiver without corrections, open sky."""
FEWEST = 3


@dataclass(frozen=True, eq=False, repr=False)
class GpsPriors(KnownPriors, Displayed):
    """Priors of a problem's images in a local frame.

    Attributes:
        priors: priors for ``bundle.solve(problem, priors=...)``, of images by id.
        origin: origin of their frame east, north, up [m]; None for Cartesian positions.
        reference_system: reference system of the given positions; None if Cartesian.
        notes: sentences on ignored or inexact data.
    """

    priors: tuple[PositionPrior, ...]
    origin: LocalFrame | None
    reference_system: str | None
    notes: tuple[str, ...]

    def georeference(self, result: Solved) -> Georeference:
        """Return the georeference of a model that was solved with these priors.

        Raises:
            InputError: the result belongs to another problem, or to a solve without alignment.
        """
        if result.similarity is None:
            raise InputError("result: expected the result of a solve that aligned the problem")
        problem = result.problem
        known = ProblemPriors.make(problem, self.priors)
        offset = np.zeros(3)
        if any(prior.offset != "none" for prior in self.priors) and result.survey_checks:
            found = result.survey_checks.offset
            offset = np.zeros(3) if found is None else np.array(found.value)
        residuals, sigmas = known.residuals(problem, offset), known.sigmas(problem, offset)
        place = {row: index for index, row in enumerate(known.rows.tolist())}
        images = []
        for row, name in enumerate(problem.image_names):
            index = place.get(row)
            east, north, up = (np.full(3, np.nan) if index is None else residuals[index]).tolist()
            size = float("nan") if index is None else float(sigmas[index])
            images.append(ImageError(name, (east, north, up), index is not None, size))
        return Georeference(
            self.reference_system,
            self.origin,
            result.similarity,
            tuple(images),
            (*self.notes, *rig_notes(result)),
        )

    errors_of = georeference

    def _display(self) -> Display:
        at = "none: Cartesian" if self.origin is None else origin_text(self.origin)
        facts = (("origin", at), *(("note", note) for note in self.notes))
        return Display(title=f"GpsPriors of {plural(len(self.priors), 'image')}", facts=facts)


def gps_priors(
    problem: Problem,
    gps: str | os.PathLike[str] | GpsPositions,
    *,
    images: str | os.PathLike[str] | None = None,
    gps_sigma: Any = GPS_SIGMA,
    gps_offset: str = "none",
    antenna: ArrayLike = (0.0, 0.0, 0.0),
    prior_loss: str = "trivial",
    prior_loss_scale: float = ROBUST_SCALE,
    origin: LocalFrame | None = None,
    fewest: int = FEWEST,
) -> GpsPriors:
    """Make priors of a problem's images from positions on the earth.

    Images without a position get no prior, and positions of unknown images are ignored; notes count
    both. A position belongs to the image of the same name. If no such image exists, it belongs to
    the image with the same last part of the name (without folders), if this part is unique.

    Args:
        problem: problem of the images.
        gps: the path of OpenDroneMap's geo.txt, a table, OpenSfM's reconstruction.json or COLMAP's
            database; "exif"; or positions.
        images: folder of the images, for "exif".
        gps_sigma: standard deviation in metres, a number or (horizontal, vertical), for positions
            without their own.
        gps_offset: "up" or "all": estimate an offset of all positions, which control points in the
            same solve determine.
        antenna: (3,) position of the receiver in the camera frame, x right, y down, z forward,
            metres.
        prior_loss: robust loss of each position's residual.
        prior_loss_scale: sigmas beyond which the loss is robust.
        origin: origin of the frame; by default the middle of the used positions.
        fewest: required number of positions; 2 beside measured verticals.

    Raises:
        InputError: a file or an argument is wrong, the images have no names, fewer than ``fewest``
            images have a position, or the positions do not determine position, scale and attitude
            of the problem.
        OSError: a path cannot be read.
    """
    default = parse_sigma("gps_sigma", gps_sigma)
    # Refuse wrong settings first, independently of the positions.
    settings: dict[str, Any] = {"loss": prior_loss, "loss_scale": prior_loss_scale}
    settings["offset"] = gps_offset
    check_settings(antenna, settings)
    index = ImageIndex(problem, "gps: ")
    positions = given_gps(gps, images, problem)
    if positions is None:
        raise InputError('gps: expected "exif", a path or GpsPositions, found None')
    rows = matched(index, positions)
    chosen = sorted(rows)
    if len(chosen) < fewest:
        raise too_few(problem, positions, len(chosen), fewest)
    notes: tuple[str, ...] = ()
    if fewest > 1:  # otherwise they were checked together with control points
        survey = Survey(problem, (), positions, gps_sigma=default, antenna=antenna, fewest=fewest)
        notes = check_readings(survey)
        if survey.is_alone:
            with at("gps"):
                robust_similarity(survey.measured, survey.what)
    places = positions.geodetic[[rows[row] for row in chosen]]
    frame = origin
    if frame is None and positions.reference_system is not None:
        frame = LocalFrame.about(places)
    priors = []
    for row, enu in zip(chosen, places if frame is None else frame.to_enu(places), strict=True):
        horizontal, vertical = positions.accuracy[rows[row]].tolist()
        sigma = (
            default.horizontal if np.isnan(horizontal) else horizontal,
            default.vertical if np.isnan(vertical) else vertical,
        )
        image = int(problem.image_ids[row])
        priors.append(PositionPrior(image, enu, sigma, lever_arm=antenna, **settings))
    return GpsPriors(
        tuple(priors),
        frame,
        positions.reference_system,
        (*notes, *positions.notes, *unmatched_notes(problem, index, positions, chosen)),
    )


def check_settings(antenna: ArrayLike, settings: dict[str, Any]) -> None:
    """Raise an InputError with the argument's name for settings that no prior accepts."""
    try:
        PositionPrior(0, (0.0, 0.0, 0.0), 1.0, lever_arm=antenna, **settings)
    except InputError as error:
        names = {"lever_arm": "antenna", "loss": "prior_loss", "loss_scale": "prior_loss_scale"}
        names["offset"] = "gps_offset"
        _, _, message = str(error).partition(": ")
        name, colon, rest = message.partition(":")
        raise InputError(f"{names.get(name, name)}{colon}{rest}") from None


# Priors of a solve from ground control points, optionally with GPS positions of images.
#
# A search for gross errors in the given model, which predicts each point from the other points
# through a similarity (``leave_one_out``), would accuse exact points: a model that was not adjusted
# yet is bent by more than their sigmas. It only gives residuals for comparison. Suspects come from
# the adjusted model (``point_check``).

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class GcpPriors(KnownPriors, Displayed):
    """Priors of a problem's control points, and of its images, in a local frame.

    Attributes:
        priors: priors for ``bundle.solve(problem, priors=...)``: positions of images, then all
            control and check points.
        origin: origin of their frame east, north, up [m]; None for Cartesian coordinates.
        reference_system: reference system of the given coordinates; None if Cartesian.
        left_out: by name, residual (3,) of each point in the given problem, aligned by all other
            points, east, north, up [m]; nan if they do not determine the alignment.
        suspects: names of points for which this residual is too large for a model that is not bent.
        notes: sentences on ignored, inexact or suspicious data.
        gps: positions of the images; None without positions.
    """

    priors: tuple[PositionPrior | GroundControlPoint, ...]
    origin: LocalFrame | None
    reference_system: str | None
    left_out: dict[str, tuple[float, float, float]]
    suspects: tuple[str, ...]
    notes: tuple[str, ...]
    gps: GpsPriors | None = None

    @property
    def control_points(self) -> tuple[GroundControlPoint, ...]:
        """All control and check points."""
        return tuple(prior for prior in self.priors if isinstance(prior, GroundControlPoint))

    def georeference(self, result: Solved) -> Georeference:
        """Return the georeference of a model that was solved with these priors.

        Raises:
            InputError: the result belongs to another problem, or to a solve without alignment.
        """
        if result.similarity is None:
            raise InputError("result: expected the result of a solve that aligned the problem")
        names = [point.name for point in self.control_points]
        if [point.name for point in result.control_points] != names:
            raise InputError("result: expected the result of a solve with these control points")
        images = () if self.gps is None else self.gps.georeference(result).images
        checks = result.survey_checks
        return Georeference(
            self.reference_system,
            self.origin,
            result.similarity,
            images,
            (*self.notes, *rig_notes(result)),
            tuple(self._judged(point, checks) for point in result.control_points),
            None if checks is None else checks.offset,
        )

    errors_of = georeference

    def _judged(self, point: ControlPointError, checks: SurveyChecks | None) -> ControlPointError:
        """Return a point with its test in the adjusted model.

        ``checks``: tests after the solve; None if it did not converge.
        """
        check = None if checks is None else checks.points.get(point.name)
        if check is None:
            suspect = checks is None and point.name in self.suspects
            return replace(point, leave_one_out=self.left_out[point.name], suspect=suspect)
        return replace(
            point,
            leave_one_out=check.residual,
            suspect=check.is_suspect,
            redundancy=check.redundancy,
        )

    def _display(self) -> Display:
        points = self.control_points
        controls = sum(point.role == "control" for point in points)
        facts = [("control points", f"{controls} of {len(points)}")]
        if self.gps is not None:
            facts.append(("positions", f"of {plural(len(self.gps.priors), 'image')}"))
        facts += [("suspects", ", ".join(self.suspects) or "none")]
        facts += [("note", note) for note in self.notes]
        return Display(title="GcpPriors", facts=tuple(facts))


def gcp_priors(
    problem: Problem,
    gcps: str | os.PathLike[str] | Iterable[GroundControlPoint],
    *,
    gps: str | os.PathLike[str] | GpsPositions | None = None,
    images: str | os.PathLike[str] | None = None,
    gcp_sigma: Any = GCP_SIGMA,
    gcp_pixel_sigma: float = GCP_PIXEL_SIGMA,
    check_points: Iterable[str] = (),
    gps_sigma: Any = GPS_SIGMA,
    gps_offset: str = "none",
    antenna: ArrayLike = (0.0, 0.0, 0.0),
    prior_loss: str = "trivial",
    prior_loss_scale: float = ROBUST_SCALE,
    fewest: int = FEWEST,
) -> GcpPriors:
    """Make priors of ground control points, and of images' positions, in one local frame.

    The frame is east, north, up in metres, with its origin in the middle of the control points.
    Only points in at least two images of the problem are used; notes list the others.

    Args:
        problem: problem whose images observe the control points.
        gcps: control points, or the path of OpenDroneMap's gcp_list.txt.
        gps: as in :func:`gps_priors`; None: control points alone.
        images: folder of the images, for ``gps="exif"``.
        gcp_sigma: metres, a number or (horizontal, vertical), for points without their own.
        gcp_pixel_sigma: pixels, for measurements without their own.
        check_points: names of additional check points, which must not influence the solve.
        gps_sigma: metres, a number or (horizontal, vertical), for positions without their own.
        gps_offset: "none", "up" or "all": offset of the positions to estimate, in height or along
            all axes.
        antenna: (3,) position of the receiver in the camera frame, metres.
        prior_loss: robust loss of each control point's and each position's residual.
        prior_loss_scale: sigmas beyond which the loss is robust.
        fewest: required number of control points and positions; 2 beside measured verticals.

    Raises:
        InputError: a file or an argument is wrong, or there are fewer points than ``fewest``, or
            three are required and lie on one line.
        OSError: a path cannot be read.

    Example:
        >>> known = bundle.georeference.gcp_priors(problem, "gcp_list.txt", check_points=["gcp07"])
        >>> result = bundle.solve(problem, priors=known.priors)
        >>> known.georeference(result).rms_of("check")
    """
    sigma = parse_sigma("gcp_sigma", gcp_sigma)
    pixel_sigma = parse_pixel_sigma("gcp_pixel_sigma", gcp_pixel_sigma)
    settings: dict[str, Any] = {"loss": prior_loss, "loss_scale": prior_loss_scale}
    check_settings(antenna, settings)
    given, notes = given_control_points(gcps, problem)
    points = with_check_points(given, check_points)
    positions = given_gps(gps, images, problem)
    survey = Survey(
        problem,
        points,
        positions,
        gcp_sigma=sigma,
        pixel_sigma=pixel_sigma,
        gps_sigma=parse_sigma("gps_sigma", gps_sigma),
        antenna=antenna,
        fewest=fewest,
    )
    notes += check_readings(survey)
    if survey.is_alone:
        fit_similarity(survey.measured.rows(survey.decisive), what=survey.what)
    left_out, suspect = survey.leave_one_out()
    frame = survey.frame
    local = tuple(
        replace(
            point,
            position=tuple(place.tolist()),
            reference_system=None,
            sigma=point.sigma or sigma,
            measurements=tuple(
                entry if entry.sigma is not None else entry._replace(sigma=pixel_sigma)
                for entry in point.measurements
            ),
            **settings,
        )
        for point, place in zip(points, frame.control_points, strict=True)
    )
    known = None
    if positions is not None:
        known = gps_priors(
            problem,
            positions,
            gps_sigma=gps_sigma,
            gps_offset=gps_offset,
            antenna=antenna,
            prior_loss=prior_loss,
            prior_loss_scale=prior_loss_scale,
            origin=frame.origin,
            fewest=1,
        )
    return GcpPriors(
        (*(() if known is None else known.priors), *local),
        frame.origin,
        frame.reference_system,
        {point.name: tuple(row) for point, row in zip(points, left_out.tolist(), strict=True)},
        tuple(point.name for point, is_one in zip(points, suspect, strict=True) if is_one),
        tuple(dict.fromkeys((*notes, *survey.notes()))),
        known,
    )


# Positions and control points from files, images and the options of a command.

EXIF = "exif"


def given_gps(
    gps: str | os.PathLike[str] | GpsPositions | None,
    images: str | os.PathLike[str] | None,
    problem: Problem,
) -> GpsPositions | None:
    """Return positions from an object, a file or the images' EXIF tags; None for None."""
    if gps == EXIF:
        if images is None:
            raise InputError('images: expected the folder of the images for "exif", found None')
        return read_exif_gps(images, problem.image_names)
    if images is not None:
        raise InputError(f'images: expected gps="exif" together with it, found {brief(gps)}')
    if gps is None or isinstance(gps, GpsPositions):
        return None if gps is None else with_fix(gps)
    if is_path(gps):
        path = as_path(gps, "gps")
        if is_database(path):
            return with_fix(read_database_gps(path))
        return with_fix(read_opensfm_gps(path)) if is_opensfm(path) else read_geo_file(path)
    raise InputError(f'gps: expected "exif", a path or GpsPositions, found {brief(gps)}')


def survey_given(problem: Problem, **options: Any) -> GcpPriors | GpsPriors:
    """Return the priors of positions and control points from the options of a command."""
    if "gps_offset" in options and "gcp" not in options:
        raise InputError("gps_offset: expected --gcp, too: control points determine the offset")
    verticals = [options.pop(name, None) for name in ("gravity", "orientations")]
    settings = survey_settings(problem, options)
    if any(verticals):
        settings["fewest"] = 2  # a vertical determines the rotation about a line
    if settings.get("gps") != "exif":  # the folder is for the report page
        settings.pop("images", None)
    make: Callable[..., GcpPriors | GpsPriors] = gcp_priors if "gcps" in settings else gps_priors
    return make(problem, **settings)


def survey_settings(problem: Problem, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return options as arguments of ``gps_priors``, ``gcp_priors`` and ``align``.

    Positions with scaled standard deviations are read here.
    """
    settings = dict(options)
    if (scale := settings.pop("gps_sigma_scale", None)) is not None:
        images = settings.pop("images", None) if settings["gps"] == "exif" else None
        default = parse_sigma("gps_sigma", settings.get("gps_sigma", GPS_SIGMA))
        factor = parse_sigma("gps_sigma_scale", scale, unit="a factor")
        if (positions := given_gps(settings["gps"], images, problem)) is not None:
            settings["gps"] = positions.with_sigmas(default, factor)
    if "gcp" in settings:
        settings["gcps"] = settings.pop("gcp")
    return settings
