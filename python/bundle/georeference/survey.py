"""Control points and positions to which a similarity is fitted, with leave-one-out residuals."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.base.records import dataclass
from bundle.base.tails import f_tail
from bundle.base.words import plural
from bundle.errors import InputError
from bundle.georeference.alignment_result import ControlPointError, as_triple
from bundle.georeference.control_point import GCP_SIGMA, GroundControlPoint, Sigma
from bundle.georeference.gps_positions import GpsPositions, case_notes, matched, too_few
from bundle.georeference.local_frame import LocalFrame
from bundle.georeference.reference_system import ReferenceSystem
from bundle.georeference.similarity_fit import Correspondences, SimilarityFit, fit_similarity
from bundle.georeference.text_lines import ImageIndex
from bundle.georeference.triangulated_targets import Triangulated, triangulate
from bundle.interface.georeference_options import GCP_PIXEL_SIGMA
from bundle.model.problem import Problem
from bundle.model.rigid_motions import rotation_matrices

Array = NDArray[np.float64]
Readings = tuple[tuple[GroundControlPoint, ...], GpsPositions | None]
"""Coordinates of control points, and of images or None."""

FEWEST = 3  # smallest number of points for a similarity

MOST_OUTSIDE = 5  # largest number of measurements outside their images to list


class Frame:
    """Frame of a georeferenced model.

    Attributes:
        reference_system: reference system of the coordinates, or None if they are Cartesian.
        origin: origin of east, north, up: in the middle of the control points (check points have no
            influence), or of the positions without control points.
        control_points: (n, 3) positions of the targets; up is nan if unknown.
        positions: (m, 3) positions of images.
        notes: sentences on inexact data.

    Raises:
        InputError: some coordinates have a reference system and others do not.
    """

    def __init__(
        self,
        points: tuple[GroundControlPoint, ...],
        positions: GpsPositions | None,
        origin: LocalFrame | None = None,
    ) -> None:
        self.notes: tuple[str, ...] = positions.notes if positions is not None else ()
        self.origin: LocalFrame | None = None
        self.reference_system: str | None = None
        self.control_points = np.array([point.position for point in points]).reshape(-1, 3)
        self.positions = np.zeros((0, 3))
        systems = list(dict.fromkeys(point.reference_system for point in points))
        if positions is not None:
            systems += [positions.reference_system] if not points else []
        local = positions is not None and positions.reference_system is None
        if None in systems or local:
            if any(system is not None for system in systems) or (positions is not None) > local:
                raise InputError(
                    "gcps: expected a reference system for each control point, because other "
                    "points or GPS positions have one, found None"
                    if not local
                    else "gps: expected control points in the same Cartesian frame as the "
                    f"positions, found {', '.join(str(one) for one in systems)}"
                )
            if positions is not None:
                self.positions = positions.geodetic
            return
        geodetic = np.empty_like(self.control_points)
        for name in systems if points else ():
            system = ReferenceSystem(str(name))
            of_it = [row for row, point in enumerate(points) if point.reference_system == name]
            geodetic[of_it] = system.to_geodetic(self.control_points[of_it])
            notes = (*system.notes, *system.area_notes(geodetic[of_it]))
            self.notes += tuple(note for note in notes if note not in self.notes)
        decisive = geodetic[[point.role == "control" for point in points]] if points else geodetic
        if not len(decisive):
            decisive = positions.geodetic if positions is not None else geodetic
        self.origin = origin or LocalFrame.about(decisive)
        self.reference_system = ", ".join(map(str, systems))
        self.control_points = self.origin.to_enu(geodetic)
        if positions is not None:
            self.positions = self.origin.to_enu(positions.geodetic)


class Survey:
    """Measurements in the field, and their points in the model.

    Args:
        problem: the model.
        points: control and check points.
        positions: positions of images, or None.
        gcp_sigma: standard deviation of targets without their own, metres.
        pixel_sigma: standard deviation of measurements without their own, pixels.
        gps_sigma: standard deviation of positions without their own, metres.
        antenna: (3,) in the camera frame, metres.
        fewest: required number of control points and positions.

    Attributes:
        frame: frame of points and positions.
        targets: points triangulated in the model.
        used: (n,) mask of triangulated targets.
        control: (n,) mask of control points among these.
        surveyed: all targets, used or not.
        is_alone: True if nothing else places the model, such as measured verticals.
        cameras: positions of images of the model.
        rows: rows of these images in the given positions.
        measured: used targets, then cameras.
        decisive: mask of the entries of ``measured`` that may have an influence: all but check
            points.
    """

    def __init__(
        self,
        problem: Problem,
        points: tuple[GroundControlPoint, ...],
        positions: GpsPositions | None,
        *,
        gcp_sigma: Sigma = GCP_SIGMA,
        pixel_sigma: float = GCP_PIXEL_SIGMA,
        gps_sigma: Sigma,
        antenna: ArrayLike,
        fewest: int = FEWEST,
    ) -> None:
        self.problem, self.points, self.positions = problem, points, positions
        self.is_alone = fewest >= FEWEST
        self.index = index = ImageIndex(problem)
        found = {} if positions is None else matched(index, positions)
        if positions is not None and not found:
            raise too_few(problem, positions, 0, 1 if points else FEWEST)
        self.frame = frame = Frame(points, positions)
        self.targets = triangulate(problem, points, index, pixel_sigma=pixel_sigma)
        self.used = np.array([not target.reason for target in self.targets], dtype=bool)
        roles = np.array([point.role == "control" for point in points], dtype=bool)
        self.control: NDArray[np.bool_] = self.used & roles
        self.surveyed = surveyed(self.targets, frame.control_points, gcp_sigma)
        self.cameras, self.rows = _cameras(problem, found, positions, frame, gps_sigma, antenna)
        _check_count(self.targets, self.control, positions, len(self.cameras), fewest)
        self.measured = Correspondences.joined(self.surveyed.rows(self.used), self.cameras)
        some = np.ones(len(self.cameras), dtype=bool)
        self.decisive: NDArray[np.bool_] = np.concatenate([roles[self.used], some])

    def decisive_places(
        self, points: tuple[GroundControlPoint, ...], positions: GpsPositions | None
    ) -> Correspondences | None:
        """Return the decisive places for other coordinates; None if these are invalid."""
        try:
            frame = Frame(points, positions)
        except InputError:
            return None
        places = np.concatenate([frame.control_points[self.used], frame.positions[self.rows]])
        return replace(self.measured, target=places).rows(self.decisive)

    @property
    def tested(self) -> NDArray[np.bool_]:
        """Mask of the targets in ``measured``."""
        return np.asarray(np.arange(len(self.measured)) < self.used.sum())

    @property
    def what(self) -> str:
        """Description of the measurements for messages."""
        if self.control.any() and len(self.cameras):
            return "control points and positions of images"
        return "control points" if self.control.any() else "positions of images"

    def leave_one_out(self) -> tuple[Array, NDArray[np.bool_]]:
        """Return the leave-one-out residuals of targets; see :func:`leave_one_out`.

        Returns:
            (n, 3) residual of each target in a model that is aligned without this target, nan for
            unused targets; and (n,) mask of suspects.
        """
        others = leave_one_out(self.measured, self.decisive, self.tested)
        left_out = self._of_targets(others.residual, np.nan)
        return left_out, self._of_targets(others.suspect, False)

    def _of_targets(self, values: NDArray[Any], otherwise: Any) -> NDArray[Any]:
        """Return a value for each target, given the values of ``measured``."""
        shape = (len(self.targets), *values.shape[1:])
        found = np.full(shape, otherwise, dtype=values.dtype)
        found[self.used] = values[: self.used.sum()]
        return found

    def notes(self) -> tuple[str, ...]:
        """Return sentences on inexact, unused or suspicious data."""
        found = [*self.frame.notes, *notes_on_targets(self.problem, self.targets)]
        positions, num_cameras = self.positions, len(self.cameras)
        missing: list[str] = []
        if positions is not None and num_cameras < len(positions):
            found.append(
                f"{plural(len(positions) - num_cameras, 'position')} of {len(positions)} are of "
                "images that are not in the model."
            )
            missing += positions.names
        missing += (m.image for target in self.targets for m in target.point.measurements)
        lost = [name for name in missing if self.index.find(name) is None]
        return (*found, *case_notes(self.index, lost))


def surveyed(targets: tuple[Triangulated, ...], target: Array, sigma: Sigma) -> Correspondences:
    """Return targets in the model and their surveyed positions.

    Args:
        target: (n, 3) surveyed positions; up is nan if unknown.
    """
    sigmas = np.array([entry.point.sigma or sigma for entry in targets]).reshape(-1, 2)
    return Correspondences(
        np.array([entry.position for entry in targets]).reshape(-1, 3),
        target,
        sigmas[:, [0, 0, 1], None] ** 2 * np.eye(3),
        np.array([entry.covariance for entry in targets]).reshape(-1, 3, 3),
    )


def control_point_error(
    target: Triangulated,
    position: Array,
    residual: Array,
    covariance: Array,
    left_out: Array | None = None,
    suspect: bool = False,
) -> ControlPointError:
    """Return the result record of a target.

    Args:
        position: (3,) position of the survey, east, north, up.
        residual: (3,) model minus survey.
        covariance: (3, 3) covariance of the survey.
        left_out: (3,) residual of a model without the target, if known.
        suspect: True if a gross error is likely.
    """
    squares = (target.residual**2).sum(axis=1)
    unknown = np.full(3, np.nan)
    height = target.point.position[2]
    sigma = np.where([False, False, np.isnan(height)], np.nan, np.sqrt(np.diag(covariance)))
    return ControlPointError(
        name=target.point.name,
        role="unused" if target.reason else target.point.role,
        num_images=len(target.images),
        residual=as_triple(residual),
        leave_one_out=as_triple(unknown if left_out is None else left_out),
        sigma=as_triple(sigma),
        pixels=float(np.sqrt(squares.mean())) if len(squares) else float("nan"),
        images=tuple(
            (entry.image, float(x), float(y))
            for entry, (x, y) in zip(target.measurements, target.residual, strict=True)
        ),
        suspect=suspect,
        reason=target.reason,
        position=as_triple(position),
    )


def notes_on_targets(problem: Problem, targets: tuple[Triangulated, ...]) -> tuple[str, ...]:
    """Return sentences on unused targets, and on measurements outside their images."""
    notes = [
        f"{entry.point.name} is not used: {entry.reason}." for entry in targets if entry.reason
    ]
    measured = sum(len(entry.point.measurements) for entry in targets)
    seen = sum(len(entry.images) for entry in targets)
    if seen < measured:
        notes.append(
            f"{plural(measured - seen, 'measurement')} of {measured} are in images that are "
            "not in the model."
        )
    return (*notes, *_outside(problem, targets))


def _outside(problem: Problem, targets: tuple[Triangulated, ...]) -> list[str]:
    notes = []
    for entry in targets:
        for image, measurement in zip(entry.images.tolist(), entry.measurements, strict=True):
            width, height = problem.camera_sizes[problem.image_camera[image]].tolist()
            x, y = measurement.x, measurement.y
            if width * height and not (0 <= x <= width and 0 <= y <= height):
                notes.append(
                    f"{entry.point.name} is measured outside of {measurement.image} "
                    f"({width} x {height} px), at {x:g} {y:g}."
                )
    if len(notes) > MOST_OUTSIDE:
        more = plural(len(notes) - MOST_OUTSIDE, "more measurement")
        notes[MOST_OUTSIDE:] = [f"and {more} outside of their images."]
    return notes


def _cameras(
    problem: Problem,
    found: dict[int, int],
    positions: GpsPositions | None,
    frame: Frame,
    sigma: Sigma,
    antenna: ArrayLike,
) -> tuple[Correspondences, list[int]]:
    """Return the measured positions of images of the model, and their rows in the input."""
    images, rows = np.array(list(found), dtype=np.int64), list(found.values())
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
            offset=np.einsum("nji,j->ni", turns, np.asarray(antenna, np.float64)),
        ),
        rows,
    )


def _check_count(
    targets: tuple[Triangulated, ...],
    control: NDArray[np.bool_],
    positions: GpsPositions | None,
    num_cameras: int,
    fewest: int,
) -> None:
    if control.sum() + num_cameras >= fewest:
        return
    if positions is not None:
        raise InputError(
            f"expected at least {fewest} control points and positions of images, "
            f"found {control.sum()} and {num_cameras}"
        )
    reasons = [
        f"{entry.point.name}: {entry.reason}"
        for entry in targets
        if entry.reason and entry.point.role == "control"
    ]
    more = f" ({len(reasons)} cannot be used; {reasons[0]})" if reasons else ""
    raise InputError(
        f"gcps: expected at least {fewest} control points, each in 2 images of the "
        f"model, found {control.sum()}{more}"
    )


# Leave-one-out residuals of surveyed points, and detection of gross errors.
#
# The similarity fitted without point i predicts this point. d_i is the prediction minus the survey.
# Its covariance C_i is the sum of the covariances of the survey, of the point in the model and of
# the similarity. d_i is independent of the fit. Let sigma0 be a common factor on all sigmas,
# estimated from the residuals of the other points with nu degrees of freedom. For normal errors,
#
#     east and north:  F = d^T C^-1 d / (2 sigma0^2)   has the F distribution with 2 and nu,
#     up:              t = d / (sigma0 sqrt(C))        has Student's with nu degrees of freedom
#
# (deletion residuals: Belsley, Kuh and Welsch 1980; data snooping in geodesy: Baarda 1968). sigma0
# is estimated separately for east and north and for up, because the ratio of two stated sigmas is
# seldom correct. It is at least 1, so that errors within the stated sigmas do not make a point a
# suspect. If the estimate is below 1, nu is infinite.
#
# A point is a suspect if the probability of one of its statistics, multiplied by the number of
# statistics (Bonferroni), is below ``LEVEL``: one in twenty blocks without gross errors gets a
# suspect. The most improbable point is removed, and the others are tested again without it, until
# no suspect remains. Otherwise a gross error would hide a smaller error, and would make
# neighbouring points look bad.


LEVEL = 0.05  # probability that a block without gross errors gets a suspect


@dataclass(frozen=True)
class LeaveOneOut:
    """Predictions of points from the other points."""

    # (n, 3) prediction from the others minus survey, east, north, up [m]; nan if the others do not
    # determine the model, and for unknown heights
    residual: Array
    sigma: Array  # (n, 3) standard deviation of each residual, from the stated sigmas
    suspect: NDArray[np.bool_]  # (n,) True if a gross error is likely


def leave_one_out(
    points: Correspondences,
    control: NDArray[np.bool_],
    tested: NDArray[np.bool_],
    level: float = LEVEL,
) -> LeaveOneOut:
    """Predict each tested point from the control points without it.

    Args:
        control: (n,) mask of points that determine the similarity.
        tested: (n,) mask of points to predict.
        level: probability that a block without gross errors gets a suspect.
    """
    count = len(points)
    residual, sigma = np.full((count, 3), np.nan), np.full((count, 3), np.nan)
    suspect = np.zeros(count, dtype=bool)
    first = True
    while True:
        chances, statistics = np.ones(count), 0
        for index in np.flatnonzero(tested & ~suspect):
            tests = _predicted(points, control & ~suspect, int(index))
            if tests is None:
                continue
            if first:
                residual[index], sigma[index] = tests.residual, tests.sigma
            chances[index] = min(tests.chances)
            statistics += len(tests.chances)
        first = False
        worst = int(np.argmin(chances))
        if statistics == 0 or chances[worst] * statistics >= level:
            return LeaveOneOut(residual, sigma, suspect)
        suspect[worst] = True


@dataclass(frozen=True)
class _Tests:
    residual: Array
    sigma: Array
    chances: list[float]


def _predicted(points: Correspondences, control: NDArray[np.bool_], index: int) -> _Tests | None:
    others = control.copy()
    others[index] = False
    if others.sum() < FEWEST:
        return None
    try:
        fit = fit_similarity(points.rows(others))
    except InputError:  # the others alone are collinear
        return None
    residuals, covariances = fit.predict(points.rows(np.array([index])))
    residual, covariance = residuals[0], covariances[0]
    sigma = np.where(np.isnan(residual), np.nan, np.sqrt(np.diag(covariance)))
    squared = float(residual[:2] @ np.linalg.solve(covariance[:2, :2], residual[:2]))
    sigma0, freedom = _sigma0(fit, slice(0, 2))
    chances = [f_tail(squared / (2 * sigma0**2), 2, freedom)]
    if not math.isnan(residual[2]):
        sigma0, freedom = _sigma0(fit, slice(2, 3))
        # The square of Student's t is F with one degree of freedom.
        chances.append(f_tail((residual[2] / (sigma0 * sigma[2])) ** 2, 1, freedom))
    return _Tests(residual, sigma, chances)


def _sigma0(fit: SimilarityFit, rows: slice) -> tuple[float, float]:
    """Return the factor on the sigmas of some rows, at least 1, and its degrees of freedom."""
    freedom = float(fit.redundancy[:, rows].sum())
    squared = float((fit.whitened[:, rows] ** 2).sum())
    if squared <= freedom or freedom < 1e-6:
        return 1.0, math.inf
    return math.sqrt(squared / freedom), freedom
