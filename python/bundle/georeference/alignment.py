"""A reconstruction put where control points, GPS or another model say that it is.

Nothing is adjusted: one similarity moves all poses and points together, so all reprojection errors
stay as they are. Control points are triangulated with the cameras as they stand and weighed with
the covariances of the survey and of the triangulation; measured positions of images with theirs.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.arguments import as_array
from bundle.errors import InputError, brief
from bundle.georeference.alignment_result import Alignment, ControlPointError, ImageError
from bundle.georeference.control_point import (
    GroundControlPoint,
    Sigma,
    parse_pixel_sigma,
    parse_sigma,
)
from bundle.georeference.correspondences import Correspondences
from bundle.georeference.given_positions import (
    Frame,
    given_control_points,
    given_gps,
    with_check_points,
)
from bundle.georeference.gps_positions import GpsPositions
from bundle.georeference.gps_priors import GPS_SIGMA
from bundle.georeference.image_index import ImageIndex
from bundle.georeference.leave_one_out import leave_one_out
from bundle.georeference.position_prior import ROBUST_SCALE
from bundle.georeference.similar_problem import moved
from bundle.georeference.similarity_fit import fit_similarity
from bundle.georeference.triangulated_targets import Triangulated, triangulate
from bundle.io import Source, as_problem
from bundle.option_fields import choice, number
from bundle.options import LOSSES
from bundle.problem import Problem
from bundle.rotations import rotation_matrices
from bundle.words import plural

__all__ = ["GCP_PIXEL_SIGMA", "GCP_SIGMA", "align"]

Array = NDArray[np.float64]

GCP_SIGMA = Sigma(0.02, 0.02)
"""Equal: where sigmas are far too small, a smaller horizontal one would tilt the model to fit."""
GCP_PIXEL_SIGMA = 0.5
FEWEST = 3
LARGEST_SIGMA0 = 3.0
"""Beyond, the sigmas are too small or something is wrong: a note says so."""
NO_WEIGHT = 1e-6
"""rho' below which a robust loss has taken a measurement away."""


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
    """Put a reconstruction where control points, GPS or another model say that it is.

    The new frame is east, north, up in metres about an origin in the middle of the control points,
    or of the positions where there are none; that of the other model with ``to``.

    Args:
        problem: a Problem, the path of one, or a pycolmap.Reconstruction; left untouched.
        gcps: control points, or the path of ODM's gcp_list.txt. Those that two images of the model
            see count.
        gps: positions of images: the path of ODM's geo.txt, "exif", or what
            ``bundle.georeference`` read. Alone or beside control points.
        to: another model of the same scene: the positions of images of the same name decide, with
            equal weights.
        images: the folder of the images, for "exif".
        gcp_sigma: metres, a number or (horizontal, vertical), of targets without their own.
        gcp_pixel_sigma: pixels, of measurements without their own.
        check_points: names of targets that must not influence the result, besides those that are
            marked so.
        gps_sigma: metres, a number or (horizontal, vertical), of positions without their own.
        antenna: x, y, z of the antenna in the frame of the camera (right, down, forward), metres.
        prior_loss: robust loss of the residuals in sigmas, a name out of SolveOptions.
        prior_loss_scale: where it bends, in sigmas; by default 2.795, which 5 % of good points
            exceed.

    Raises:
        InputError: a file or an argument is wrong, or the points do not determine the place, the
            size and the attitude of the model.
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
    loss = choice("prior_loss", prior_loss, LOSSES)
    loss_scale = number("prior_loss_scale", prior_loss_scale, above=0)
    lever = as_array("antenna", antenna)
    if lever.shape != (3,) or not np.isfinite(lever).all():
        raise InputError(f"antenna: expected x, y, z in metres, found {brief(antenna)}")
    if to is not None:
        if gcps is not None or gps is not None:
            raise InputError("to: expected no control points or GPS beside another model")
        return _aligned_to(given, as_problem(to, "to"))
    if gcps is None and gps is None:
        raise InputError("align: expected control points (gcps), positions (gps) or a model (to)")

    index = ImageIndex(given)
    points = with_check_points(given_control_points(gcps), check_points)
    positions = given_gps(gps, images, given)
    frame = Frame(points, positions)
    targets = triangulate(given, points, index, pixel_sigma=pixel_sigma)
    used = np.array([not target.reason for target in targets], dtype=bool)
    roles = np.array([point.role == "control" for point in points], dtype=bool)
    surveyed = _surveyed(targets, frame.control_points, sigma)
    cameras, rows = _cameras(given, index, positions, frame, gps_default, lever)
    _check_count(targets, used & roles, positions, len(cameras))

    measured = Correspondences.joined(surveyed.rows(used), cameras)
    decisive = np.concatenate([roles[used], np.ones(len(cameras), dtype=bool)])
    tested = np.arange(len(measured)) < used.sum()
    what = _named(bool((used & roles).any()), bool(len(cameras)))
    fit = fit_similarity(measured.rows(decisive), loss=loss, loss_scale=loss_scale, what=what)
    residual, _ = fit.predict(surveyed)
    others = leave_one_out(measured, decisive, tested)
    unknown = np.full(3, np.nan)
    place = np.cumsum(used) - 1
    errors = tuple(
        _control_point_error(
            target,
            residual[row],
            others.residual[place[row]] if used[row] else unknown,
            np.where(np.isnan(surveyed.target[row]), np.nan, _sigmas(surveyed, row)),
            bool(used[row] and others.suspect[place[row]]),
        )
        for row, target in enumerate(targets)
    )
    weight = fit.weight[decisive[: used.sum()].sum() :]
    return Alignment(
        moved(given, fit.similarity),
        fit.similarity,
        frame.reference_system,
        frame.origin,
        errors,
        tuple(
            ImageError(positions.names[row], _triple(error), bool(share > NO_WEIGHT))
            for row, error, share in zip(rows, fit.predict(cameras)[0], weight, strict=True)
        )
        if positions is not None
        else (),
        (),
        (*frame.notes, *_notes(targets, positions, len(cameras)), *_sigma_notes(fit.sigma0)),
        fit.sigma0,
    )


def _named(controls: bool, cameras: bool) -> str:
    if controls and cameras:
        return "control points and positions of images"
    return "control points" if controls else "positions of images"


def _surveyed(targets: tuple[Triangulated, ...], target: Array, sigma: Sigma) -> Correspondences:
    """Return the targets, used or not."""
    sigmas = np.array([entry.point.sigma or sigma for entry in targets]).reshape(-1, 2)
    return Correspondences(
        np.array([entry.position for entry in targets]).reshape(-1, 3),
        target,
        sigmas[:, [0, 0, 1], None] ** 2 * np.eye(3),
        np.array([entry.covariance for entry in targets]).reshape(-1, 3, 3),
    )


def _cameras(
    problem: Problem,
    index: ImageIndex,
    positions: GpsPositions | None,
    frame: Frame,
    sigma: Sigma,
    antenna: Array,
) -> tuple[Correspondences, list[int]]:
    """Return the positions of images of the model, and which of those given they are."""
    names = positions.names if positions is not None else ()
    found = [
        (row, image) for row, name in enumerate(names) if (image := index.find(name)) is not None
    ]
    rows = [row for row, _ in found]
    images = np.array([image for _, image in found], dtype=np.int64)
    sigmas = np.tile(np.array(sigma), (len(rows), 1))
    if positions is not None and rows:
        own = positions.accuracy[rows]
        sigmas = np.where(own > 0, own, sigmas)
    turns = rotation_matrices(problem.cam_from_world[images, :4].reshape(-1, 4))
    return (
        Correspondences(
            problem.projection_centers[images].reshape(-1, 3),
            frame.positions[rows].reshape(-1, 3),
            sigmas[:, [0, 0, 1], None] ** 2 * np.eye(3),
            offset=np.einsum("nji,j->ni", turns, antenna),
        ),
        rows,
    )


def _check_count(
    targets: tuple[Triangulated, ...],
    control: NDArray[np.bool_],
    positions: GpsPositions | None,
    num_cameras: int,
) -> None:
    if positions is not None:
        if num_cameras == 0:
            raise InputError(
                f"gps: expected positions of images of the model, found none among "
                f"{len(positions)} of {positions.source}"
            )
        if control.sum() + num_cameras >= FEWEST:
            return
        raise InputError(
            f"expected at least {FEWEST} control points and positions of images, "
            f"found {control.sum()} and {num_cameras}"
        )
    if control.sum() >= FEWEST:
        return
    reasons = [
        f"{entry.point.name}: {entry.reason}"
        for entry in targets
        if entry.reason and entry.point.role == "control"
    ]
    more = f" ({len(reasons)} cannot be used; {reasons[0]})" if reasons else ""
    raise InputError(
        f"gcps: expected at least {FEWEST} control points that 2 images of the model see, "
        f"found {control.sum()}{more}"
    )


def _control_point_error(
    target: Triangulated, residual: Array, left_out: Array, sigma: Array, suspect: bool
) -> ControlPointError:
    squares = (target.residual**2).sum(axis=1)
    return ControlPointError(
        name=target.point.name,
        role="unused" if target.reason else target.point.role,
        num_images=len(target.images),
        residual=_triple(residual),
        leave_one_out=_triple(left_out),
        sigma=_triple(sigma),
        pixels=float(np.sqrt(squares.mean())) if len(squares) else float("nan"),
        images=tuple(
            (entry.image, float(x), float(y))
            for entry, (x, y) in zip(target.measurements, target.residual, strict=True)
        ),
        suspect=suspect,
        reason=target.reason,
    )


def _sigmas(points: Correspondences, row: int) -> Array:
    sigmas: Array = np.sqrt(np.diag(points.target_covariance[row]))
    return sigmas


def _notes(
    targets: tuple[Triangulated, ...], positions: GpsPositions | None, num_cameras: int
) -> tuple[str, ...]:
    notes = [
        f"{entry.point.name} is not used: {entry.reason}." for entry in targets if entry.reason
    ]
    measured = sum(len(entry.point.measurements) for entry in targets)
    seen = sum(len(entry.images) for entry in targets)
    if seen < measured:
        notes.append(
            f"{plural(measured - seen, 'measurement')} of {measured} are in images that the model "
            "does not have."
        )
    if positions is not None and num_cameras < len(positions):
        notes.append(
            f"{plural(len(positions) - num_cameras, 'position')} of {len(positions)} are of images "
            "that the model does not have."
        )
    return tuple(notes)


def _sigma_notes(sigma0: float) -> tuple[str, ...]:
    if not sigma0 > LARGEST_SIGMA0:
        return ()
    return (
        f"Residuals are {sigma0:.3g} times as large as their sigmas allow: the sigmas are too "
        "small, or points have gross errors.",
    )


def _aligned_to(problem: Problem, other: Problem) -> Alignment:
    index = ImageIndex(other)
    ImageIndex(problem)
    pairs = [
        (row, found)
        for row, name in enumerate(problem.image_names)
        if (found := index.find(name)) is not None
    ]
    if len(pairs) < FEWEST:
        raise InputError(
            f"to: expected at least {FEWEST} images of the same name in both models, "
            f"found {len(pairs)}"
        )
    here, there = np.array(pairs).T
    target = other.projection_centers[there]
    # Weights are equal, so their size is free; that of the scene is above all residuals.
    variance = float(((target - target.mean(axis=0)) ** 2).sum(axis=1).mean()) or 1.0
    shared = Correspondences(
        problem.projection_centers[here], target, np.tile(variance * np.eye(3), (len(pairs), 1, 1))
    )
    fit = fit_similarity(shared, what="shared images")
    residual, _ = fit.predict(shared)
    images = tuple(
        ImageError(problem.image_names[row], _triple(error), used=True)
        for row, error in zip(here, residual, strict=True)
    )
    return Alignment(moved(problem, fit.similarity), fit.similarity, None, None, (), (), images, ())


def _triple(values: Array) -> tuple[float, float, float]:
    east, north, up = values.tolist()
    return east, north, up
