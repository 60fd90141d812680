"""Ground control points among the points of a solve.

A control point is a point X of the problem with two kinds of residual: the residuals of its pixels,
divided by their sigma, and its distance from the survey,

    1/2 rho(r^T r),  r = L^-1 (X - X0),  Sigma = L L^T = diag(h^2, h^2, v^2),

where an unknown height has a very large variance: its contribution is zero in double precision. The
point starts at the intersection of the rays of its images. Check points do not take part in the
solve; they are triangulated afterwards with the refined cameras. Control points are triangulated
afterwards as well, because the survey keeps their adjusted positions close to the surveyed ones.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import check_distinct
from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.georeference.alignment_result import ControlPointError
from bundle.georeference.control_point import GCP_SIGMA, GroundControlPoint
from bundle.georeference.measurements import FoundPriors
from bundle.georeference.similarity import Similarity
from bundle.georeference.similarity_fit import Correspondences
from bundle.georeference.survey import control_point_error, surveyed
from bundle.georeference.text_lines import ImageIndex
from bundle.georeference.triangulated_targets import Triangulated, triangulate
from bundle.georeference.vector_priors import UNKNOWN
from bundle.graphs.factors.factors import PriorFactor
from bundle.interface.georeference_options import GCP_PIXEL_SIGMA
from bundle.model.problem import Problem

Array = NDArray[np.float64]

LARGEST_ID = 2**63 - 1


@dataclass(frozen=True)
class TargetPriors(FoundPriors):
    """Control points of a solve, in the frame of its priors."""

    points: tuple[GroundControlPoint, ...]  # all given points, including check points
    used: tuple[Triangulated, ...]  # triangulated points among them that take part in the solve
    point_ids: tuple[int, ...]  # ids of these points in the solve
    had_sigmas: bool  # True if the observations of the problem had sigmas

    adds_points = True

    @staticmethod
    def make(problem: Problem, points: Iterable[GroundControlPoint]) -> TargetPriors:
        """Triangulate the control points in a problem."""
        given = tuple(points)
        check_distinct("priors: expected each control point once", (point.name for point in given))
        for point in given:
            if point.reference_system is not None:
                raise InputError(
                    f"priors: control point {point.name}: expected coordinates in metres, such as "
                    "those of bundle.georeference.gcp_priors, found coordinates in "
                    f"{point.reference_system}"
                )
        control = [point for point in given if point.role == "control"]
        index = ImageIndex(problem, "priors: ")
        found = triangulate(problem, control, index, pixel_sigma=GCP_PIXEL_SIGMA)
        used = tuple(target for target in found if not target.reason)
        if control and not used:
            raise InputError(
                "priors: expected control points in at least 2 images of the problem, found 0 "
                f"({found[0].point.name}: {found[0].reason})"
            )
        had_sigmas = problem.observation_sigma is not None
        return TargetPriors(given, used, _free_ids(problem, len(used)), had_sigmas)

    def correspondences(self) -> Correspondences:
        """Return the used points in the problem of :meth:`make`, and their surveyed positions."""
        target = np.array([entry.point.position for entry in self.used]).reshape(-1, 3)
        return surveyed(self.used, target, GCP_SIGMA)

    def factors(self, problem: Problem) -> list[PriorFactor]:  # noqa: ARG002
        """Return a factor for each used point, in order."""
        return [
            PriorFactor(
                ("point", point_id),
                np.nan_to_num(np.array(entry.point.position)),
                np.diag(1 / survey_sigmas(entry.point) ** 2),
                loss=entry.point.loss,
                loss_scale=entry.point.loss_scale,
            )
            for point_id, entry in zip(self.point_ids, self.used, strict=True)
        ]

    def added_to(self, problem: Problem, moved: Similarity | None) -> Problem:
        """Return the problem with the used points as its last points and observations.

        ``problem``: problem of :meth:`make`, or the same problem moved.
        """
        if not self.used:
            return problem
        positions = np.array([entry.position for entry in self.used])
        if moved is not None:
            positions = moved.apply(positions)
        counts = [len(entry.images) for entry in self.used]
        pixels = [entry for target in self.used for entry in target.measurements]
        sigma = problem.observation_sigma
        if sigma is None:
            sigma = np.ones(problem.num_observations)
        return problem.replace(
            points=np.concatenate([problem.points, positions]),
            point_ids=np.concatenate([problem.point_ids, self.point_ids]),
            observation_image=np.concatenate(
                [problem.observation_image, *(entry.images for entry in self.used)]
            ),
            observation_point=np.concatenate(
                [
                    problem.observation_point,
                    np.repeat(problem.num_points + np.arange(len(counts)), counts),
                ]
            ),
            observation_xy=np.concatenate(
                [problem.observation_xy, [(entry.x, entry.y) for entry in pixels]]
            ),
            observation_keypoint=np.concatenate(
                [problem.observation_keypoint, np.full(len(pixels), -1)]
            ),
            observation_sigma=np.concatenate(
                [sigma, [entry.sigma or GCP_PIXEL_SIGMA for entry in pixels]]
            ),
        )

    def taken_from(self, problem: Problem) -> Problem:
        """Remove the control points from a problem of :meth:`added_to` after a solve or filter."""
        if not self.used:
            return problem
        points = problem.num_points - len(self.used)
        left = problem.num_observations - sum(len(entry.images) for entry in self.used)
        sigma = problem.observation_sigma
        return problem.replace(
            points=problem.points[:points],
            point_ids=problem.point_ids[:points],
            observation_image=problem.observation_image[:left],
            observation_point=problem.observation_point[:left],
            observation_xy=problem.observation_xy[:left],
            observation_keypoint=problem.observation_keypoint[:left],
            observation_sigma=sigma[:left] if self.had_sigmas and sigma is not None else None,
        )

    def point_errors(self, problem: Problem) -> tuple[ControlPointError, ...]:
        """Return the residuals of all points in a problem in the frame of the priors."""
        targets = triangulate(
            problem, self.points, ImageIndex(problem), pixel_sigma=GCP_PIXEL_SIGMA
        )
        survey = np.array([point.position for point in self.points]).reshape(-1, 3)
        covariance = surveyed(targets, survey, GCP_SIGMA).target_covariance
        return tuple(
            control_point_error(target, place, target.position - place, matrix)
            for target, place, matrix in zip(targets, survey, covariance, strict=True)
        )


def _free_ids(problem: Problem, count: int) -> tuple[int, ...]:
    """Return unused ids: those after the largest id, or the first gaps if no larger ids exist."""
    last = int(problem.point_ids.max(initial=0))
    if last < LARGEST_ID - count:
        return tuple(range(last + 1, last + 1 + count))
    among = np.arange(problem.num_points + count)
    return tuple(np.setdiff1d(among, problem.point_ids)[:count].tolist())


def survey_sigmas(point: GroundControlPoint) -> Array:
    """Return the standard deviations (3,) of a point; an unknown height has a very large one."""
    horizontal, vertical = point.sigma or GCP_SIGMA
    if np.isnan(point.position[2]):
        vertical = UNKNOWN
    return np.array([horizontal, horizontal, vertical])
