"""Alignment of a reconstruction to control points, GPS or another model.

The model is not adjusted: one similarity moves all poses and points together, so that all
reprojection errors stay the same. Control points are triangulated with the cameras of the model.
Their weights contain the covariances of the survey and of the triangulation. The weights of
measured positions of images contain the covariances of these positions only.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

import numpy as np

from bundle.errors import InputError
from bundle.georeference.alignment_result import Alignment, ImageError, as_triple
from bundle.georeference.control_point import (
    GCP_SIGMA,
    GroundControlPoint,
    parse_pixel_sigma,
    parse_sigma,
)
from bundle.georeference.gcp_list import given_control_points, with_check_points
from bundle.georeference.gps_positions import GpsPositions
from bundle.georeference.local_frame import with_origin
from bundle.georeference.other_readings import check_readings
from bundle.georeference.similarity import moved
from bundle.georeference.similarity_fit import Correspondences, fit_similarity
from bundle.georeference.survey import Survey, control_point_error
from bundle.georeference.survey_priors import GPS_SIGMA, check_settings, given_gps
from bundle.georeference.text_lines import ImageIndex
from bundle.interface.georeference_options import GCP_PIXEL_SIGMA, ROBUST_SCALE
from bundle.io.files import Source, as_problem
from bundle.model.problem import Problem

FEWEST = 3
LARGEST_SIGMA0 = 3.0
"""Threshold of sigma0 for a note that the sigmas are too small or the data contains an error."""
NO_WEIGHT = 1e-6  # weight rho' below which a measurement counts as removed by the robust loss


def align(
    problem: Source,
    *,
    gcps: str | os.PathLike[str] | Iterable[GroundControlPoint] | None = None,
    gps: str | os.PathLike[str] | GpsPositions | None = None,
    to: Source | None = None,
    images: str | os.PathLike[str] | None = None,
    gcp_sigma: Any = GCP_SIGMA,
    gcp_pixel_sigma: float = GCP_PIXEL_SIGMA,
    check_points: Iterable[str] = (),
    gps_sigma: Any = GPS_SIGMA,
    antenna: Any = (0.0, 0.0, 0.0),
    prior_loss: str = "trivial",
    prior_loss_scale: float = ROBUST_SCALE,
) -> Alignment:
    """Align a reconstruction to control points, GPS or another model.

    The new frame is east, north, up in metres. Its origin is in the middle of the control points,
    or of the positions without control points. With ``to`` it is the frame of the other model.

    Args:
        problem: a Problem, the path of one, or a pycolmap.Reconstruction; not modified.
        gcps: control points, or their path (docs/align.md). Only points in at least two images
            of the model are used.
        gps: positions of images: the path of ODM's geo.txt, "exif", or a result of
            ``bundle.georeference`` readers. They may be used with or without control points.
        to: another model of the same scene; positions of images with the same name determine the
            alignment, with equal weights.
        images: folder of the images, for "exif".
        gcp_sigma: metres, a number or (horizontal, vertical), for targets without their own.
        gcp_pixel_sigma: pixels, for measurements without their own.
        check_points: names of additional check points, which must not influence the result.
        gps_sigma: metres, a number or (horizontal, vertical), for positions without their own.
        antenna: x, y, z of the antenna in the camera frame (right, down, forward), metres.
        prior_loss: robust loss of the residuals in sigmas, a loss of SolveOptions.
        prior_loss_scale: scale of the loss: length of a residual in sigmas beyond which the loss
            is robust. The default is 2.795, which 5 % of good points exceed.

    Raises:
        InputError: a file or an argument is wrong, or the points do not determine position, scale
            and attitude of the model.
        OSError: a path cannot be read.

    Example:
        >>> aligned = bundle.align("sparse/0", gcps="gcp_list.txt", check_points=["gcp07"])
        >>> aligned.rms("check"), aligned.suspects
        >>> bundle.save(aligned.problem, "sparse/georeferenced")
    """
    given = as_problem(problem)
    sigma = parse_sigma("gcp_sigma", gcp_sigma)
    gps_default = parse_sigma("gps_sigma", gps_sigma)
    pixel_sigma = parse_pixel_sigma("gcp_pixel_sigma", gcp_pixel_sigma)
    check_settings(antenna, {"loss": prior_loss, "loss_scale": prior_loss_scale})
    if to is not None:
        if gcps is not None or gps is not None:
            raise InputError("to: expected no control points or GPS together with another model")
        return _aligned_to(given, as_problem(to, "to"))
    if gcps is None and gps is None:
        raise InputError("align: expected control points (gcps), positions (gps) or a model (to)")

    points, notes = given_control_points(gcps, given)
    points = with_check_points(points, check_points)
    positions = given_gps(gps, images, given)
    survey = Survey(
        given,
        points,
        positions,
        gcp_sigma=sigma,
        pixel_sigma=pixel_sigma,
        gps_sigma=gps_default,
        antenna=antenna,
    )
    decisive, frame = survey.decisive, survey.frame
    notes += check_readings(survey)
    fit = fit_similarity(
        survey.measured.rows(decisive),
        loss=prior_loss,
        loss_scale=prior_loss_scale,
        what=survey.what,
    )
    residual, _ = fit.predict(survey.surveyed)
    left_out, suspect = survey.leave_one_out()
    errors = tuple(
        control_point_error(
            target,
            survey.surveyed.target[row],
            residual[row],
            survey.surveyed.target_covariance[row],
            left_out[row],
            bool(suspect[row]),
        )
        for row, target in enumerate(survey.targets)
    )
    weight = fit.weight[decisive[: survey.used.sum()].sum() :]
    names = positions.names if positions is not None else ()
    cameras = fit.predict(survey.cameras)[0]
    return Alignment(
        with_origin(moved(given, fit.similarity), frame.origin),
        fit.similarity,
        frame.reference_system,
        frame.origin,
        errors,
        tuple(
            ImageError(names[row], as_triple(error), bool(share > NO_WEIGHT))
            for row, error, share in zip(survey.rows, cameras, weight, strict=True)
        ),
        (),
        (*notes, *survey.notes(), *[_SIGMAS.format(fit.sigma0)] * (fit.sigma0 > LARGEST_SIGMA0)),
        fit.sigma0,
    )


_SIGMAS = (
    "Residuals are {:.3g} times as large as expected from their sigmas: the sigmas are too small, "
    "or points have gross errors."
)


def _aligned_to(problem: Problem, other: Problem) -> Alignment:
    index, own = ImageIndex(other, "to: "), ImageIndex(problem, "problem: ")
    pairs = [
        (own.find(name), found)
        for name in problem.image_names
        if (found := index.find(name)) is not None
    ]
    if len(pairs) < FEWEST:
        raise InputError(
            f"to: expected at least {FEWEST} images of the same name in both models, "
            f"found {len(pairs)}"
        )
    here, there = np.array(pairs).T
    if len(set(there.tolist())) < len(pairs):
        raise InputError(
            "to: expected unique image names in both models, found several images with one name"
        )
    target = other.projection_centers[there]
    # Weights are equal, so that their size is arbitrary. The variance of the scene is a safe
    # choice, because it exceeds all residuals.
    variance = float(((target - target.mean(axis=0)) ** 2).sum(axis=1).mean()) or 1.0
    shared = Correspondences(
        problem.projection_centers[here], target, np.tile(variance * np.eye(3), (len(pairs), 1, 1))
    )
    fit = fit_similarity(shared, what="shared images")
    residual, _ = fit.predict(shared)
    images = tuple(
        ImageError(problem.image_names[row], as_triple(error), used=True)
        for row, error in zip(here, residual, strict=True)
    )
    return Alignment(moved(problem, fit.similarity), fit.similarity, None, None, (), (), images, ())
