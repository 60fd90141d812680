"""Alignment of a problem to priors of its images' positions.

A reconstruction has an arbitrary frame. A solve with priors that started there would have to
rotate, scale and move the entire model by thousands of sigmas. A trust region does this in small
steps, if it succeeds. Therefore the problem is first moved by the similarity that the positions
determine robustly. The minimum does not depend on this motion.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.errors import InputError, brief
from bundle.georeference.consensus import agreeing
from bundle.georeference.correspondences import Correspondences
from bundle.georeference.position_offset import PositionOffset
from bundle.georeference.position_prior import PositionPrior
from bundle.georeference.prior_images import rows_of_images
from bundle.georeference.similarity import Similarity, moved
from bundle.georeference.similarity_fit import fit_similarity
from bundle.graphs.factors.factors import PositionFactor
from bundle.graphs.factors.variables import as_list
from bundle.interface.georeference_options import ROBUST_SCALE
from bundle.model.problem import Problem
from bundle.model.rotations import rotation_matrices

Array = NDArray[np.float64]

NOT_COUNTING = 1e50
"""Standard deviation beyond which a coordinate counts as unknown."""


@dataclass(frozen=True)
class ProblemPriors:
    """Priors of image positions, and their images in a problem.

    Attributes:
        priors: priors in the order given.
        rows: (n,) index of each prior's image.
        image_ids: n ids of these images.
    """

    priors: tuple[PositionPrior, ...]
    rows: NDArray[np.int64]
    image_ids: tuple[int, ...]

    @staticmethod
    def make(problem: Problem, priors: Iterable[PositionPrior]) -> ProblemPriors:
        """Find the image of each prior.

        Raises:
            InputError: an entry is not a prior, an image is not in the problem, its name is not
                unique, or two priors have the same image.
        """
        given = _listed(priors)
        found_rows = rows_of_images(problem, given)
        return ProblemPriors(given, found_rows, tuple(problem.image_ids[found_rows].tolist()))

    def offset_beside(self, problem: Problem) -> PositionOffset | None:
        """Return the offset that priors have in common; None without such priors."""
        asked = {prior.offset for prior in self.priors} - {"none"}
        if not asked:
            return None
        return PositionOffset.beside(problem, "all" if "all" in asked else "up")

    def factors(self, offset: PositionOffset | None = None) -> list[PositionFactor]:
        """Return a factor for each prior, in order."""
        factors = []
        for prior, image_id in zip(self.priors, self.image_ids, strict=True):
            factor = prior.factor(image_id)
            if offset is not None and prior.offset != "none":
                factor = offset.of(factor, prior.offset)
            factors.append(factor)
        return factors

    def typical_offset(self, problem: Problem) -> Array:
        """Return the median (3,) of positions with an offset minus the model; 0 if unknown."""
        chosen = [prior.offset != "none" for prior in self.priors]
        away = -self.residuals(problem)[chosen]
        known = np.isfinite(away).any(axis=0)
        found = np.zeros(3)
        found[known] = np.nanmedian(away[:, known], axis=0)
        return found

    def residuals(self, problem: Problem, offset: Array | None = None) -> Array:
        """Return (n, 3) positions in the problem minus measured positions; nan if unknown.

        Args:
            problem: the problem.
            offset: (3,) offset of the positions from the problem; None: 0.
        """
        if not self.priors:
            return np.zeros((0, 3))
        antennas = problem.projection_centers[self.rows] + self._levers(problem)
        residuals: Array = antennas - self._positions()
        return residuals if offset is None else residuals + offset

    def sigmas(self, problem: Problem, offset: Array | None = None) -> Array:
        """Return (n,) lengths of the residuals in standard deviations."""
        pairs = zip(self.priors, self.residuals(problem, offset), strict=True)
        return np.array([np.linalg.norm(prior.whiten(row)) for prior, row in pairs])

    def align(self, problem: Problem) -> Similarity:
        """Return the similarity from the frame of the problem to the frame of the priors.

        See :func:`robust_similarity`.

        Raises:
            InputError: there are fewer than three positions, or they lie on one line.
        """
        if len(self.priors) < 3:
            raise InputError(
                "expected positions of at least 3 images to place the model, found "
                f"{len(self.priors)}"
            )
        return robust_similarity(self.correspondences(problem), "positions of images")

    def correspondences(self, problem: Problem) -> Correspondences:
        """Return positions of images in the problem and in the priors; up is nan if unknown."""
        if not self.priors:
            return Correspondences(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3)))
        target = self._positions()
        covariance = np.array([prior.full_covariance for prior in self.priors])
        unknown = np.isnan(target[:, 2]) | (covariance[:, 2, 2] >= NOT_COUNTING**2)
        target[unknown, 2] = np.nan
        source = problem.projection_centers[self.rows]
        return Correspondences(source, target, covariance, offset=self._levers(problem))

    def aligned(self, problem: Problem) -> tuple[Problem, Similarity]:
        """Return the problem in the frame of the priors, and the similarity of :meth:`align`."""
        similarity = self.align(problem)
        return moved(problem, similarity), similarity

    def _positions(self) -> Array:
        return np.array([prior.position for prior in self.priors], dtype=np.float64)

    def _levers(self, problem: Problem) -> Array:
        """Return the (n, 3) vectors from camera to antenna along the axes of the world."""
        rotations = rotation_matrices(problem.cam_from_world[self.rows, :4])
        levers = np.array([prior.lever_arm for prior in self.priors], dtype=np.float64)
        along: Array = np.einsum("nji,nj->ni", rotations, levers)
        return along


def robust_similarity(points: Correspondences, what: str) -> Similarity:
    """Return the similarity that most of the points agree on.

    Points that contradict the majority do not count. With fewer than three known heights, or
    heights that do not determine the tilt, all points are assumed to have one height.

    Args:
        points: at least three points.
        what: description of the points for messages.

    Raises:
        InputError: the points lie on one line.
    """
    target, covariance = points.target, points.target_covariance.copy()
    unknown = np.isnan(target[:, 2])
    known_heights = target[~unknown, 2]
    level = target.copy()
    level[unknown, 2] = np.median(known_heights) if len(known_heights) else 0.0
    scales = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    chosen = agreeing(points.source, level, scales)
    if unknown.any():
        try:
            return _fit(points.rows(chosen), what)
        except InputError:
            horizontal = covariance[:, 0, 0]
            covariance[unknown] = horizontal[unknown, None, None] * np.eye(3)
            points = dataclasses.replace(points, target=level, target_covariance=covariance)
    return _fit(points.rows(chosen), what)


def _fit(points: Correspondences, what: str) -> Similarity:
    return fit_similarity(points, loss="cauchy", loss_scale=ROBUST_SCALE, what=what).similarity


def _listed(priors: Any) -> tuple[PositionPrior, ...]:
    given = as_list("priors", "PositionPriors", priors)
    for position, prior in enumerate(given):
        if not isinstance(prior, PositionPrior):
            raise InputError(
                f"priors: expected PositionPriors, found {brief(prior)} at [{position}]"
            )
    return given
