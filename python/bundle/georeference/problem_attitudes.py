"""Attitude priors of a problem: their images, the turn of the world that they ask for, residuals.

A reconstruction has an arbitrary frame. Before a solve, the world is turned about the middle of the
cameras: by the orientations, then upright by gravity, then about the vertical by the headings. Each
step is the robust mean of ``attitude_mean`` and changes only what its measurements determine:

    orientation:  phi = Log(Z^T R Q^T),
    gravity:      phi = the shortest turn of Q R^T m, the measured down in the world, to -z,
    heading:      phi = (heading of Q R^T a - measured heading) about z.

R is the rotation of cam_from_world and Q the turn of the world.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.georeference.attitude_mean import Agreement, agree, exp, log
from bundle.georeference.attitude_priors import (
    AttitudePrior,
    GravityPrior,
    HeadingPrior,
    OrientationPrior,
)
from bundle.georeference.prior_images import rows_of_images
from bundle.georeference.similarity import Similarity
from bundle.graphs.factors.factors import Factor
from bundle.model.problem import Problem
from bundle.model.rotations import rotation_matrices

Array = NDArray[np.float64]

KINDS = (OrientationPrior, GravityPrior, HeadingPrior)
"""Kinds of priors, in the order in which they turn the world."""

STEEPEST = 5.0
"""Least angle in degrees between the vertical and an axis with a heading."""


@dataclass(frozen=True, eq=False)
class AttitudesOfKind:
    """Priors of one kind, and their images.

    Attributes:
        kind: class of the priors.
        priors: priors in the order given.
        rows: (n,) index of each prior's image.
    """

    kind: type[AttitudePrior]
    priors: tuple[Any, ...]
    rows: NDArray[np.int64]

    def turns(self, problem: Problem, turn: Array | None = None) -> Array:
        """Return (n, 3) further turns of the world that the priors ask for, in radians.

        Args:
            problem: problem with the poses.
            turn: (3, 3) turn of its world; None: no turn.
        """
        rotations = rotation_matrices(problem.cam_from_world[self.rows, :4])
        if turn is not None:
            rotations = rotations @ turn.T
        if self.kind is OrientationPrior:
            return log(np.swapaxes(self._measured, 1, 2) @ rotations)
        vectors = np.einsum("nji,nj->ni", rotations, self._measured)
        if self.kind is GravityPrior:
            return _to_down(vectors)
        found = np.degrees(np.arctan2(vectors[:, 0], vectors[:, 1]))
        wanted = np.array([prior.heading_degrees for prior in self.priors])
        turns = np.zeros((len(found), 3))
        turns[:, 2] = np.radians((found - wanted + 180) % 360 - 180)
        return turns

    def whitened(self, problem: Problem) -> Array:
        """Return (n,) lengths of the residuals in standard deviations."""
        return np.asarray(np.linalg.norm(self.turns(problem) / self.sigmas, axis=1))

    def angles(self, problem: Problem, turn: Array | None = None) -> Array:
        """Return (n,) angles of the residuals in degrees, after a turn of the world."""
        return np.asarray(np.degrees(np.linalg.norm(self.turns(problem, turn), axis=1)))

    def agreement(self, problem: Problem, base: Array | None = None) -> Agreement:
        """Return the turn of the world on which the priors agree.

        Args:
            problem: problem with the poses.
            base: (3, 3) turn of its world before that turn; None: no turn.
        """
        before = np.eye(3) if base is None else base

        def turns(turn: Array) -> Array:
            return self.turns(problem, turn @ before)

        first = turns(np.eye(3))

        def own(index: int) -> Array:
            return exp(first[index])

        return agree(turns, own, self.sigmas, self.kind.num_residuals)

    def tied(self, problem: Problem) -> NDArray[np.bool_]:
        """Return (n,) True for images that observations tie to the model, also on their rig."""
        seen = np.bincount(problem.observation_image, minlength=problem.num_images) > 0
        if problem.num_frames:
            frames = np.zeros(problem.num_frames + 1, bool)  # the last entry: no frame
            frames[problem.image_frame[seen]] = True
            frames[-1] = False
            seen |= frames[problem.image_frame]
        return np.asarray(seen[self.rows])

    def of_tied(self, problem: Problem) -> AttitudesOfKind:
        """Return the priors of tied images; all if no image is tied.

        A solve turns an image without observations to its own measurement, which says nothing
        about the world.
        """
        places = np.flatnonzero(self.tied(problem))
        if len(places) in (0, len(self.rows)):
            return self
        chosen = tuple(self.priors[place] for place in places.tolist())
        return AttitudesOfKind(self.kind, chosen, self.rows[places])

    @cached_property
    def sigmas(self) -> Array:
        """Standard deviations in radians: (n, 3) along the world's axes, or (n, 1) of all axes."""
        degrees = np.array([prior.sigma_degrees for prior in self.priors], np.float64)
        if self.kind is OrientationPrior:
            degrees = degrees[:, [1, 1, 0]]  # from heading and tilt
        return np.radians(degrees.reshape(len(self.priors), -1))

    @cached_property
    def _measured(self) -> Array:
        """Rotations (n, 3, 3), or directions and axes (n, 3) in the frames of the cameras."""
        if self.kind is OrientationPrior:
            return rotation_matrices(np.array([prior.rotation for prior in self.priors]))
        name = "direction" if self.kind is GravityPrior else "axis"
        return np.array([getattr(prior, name) for prior in self.priors], np.float64)

    def check(self, problem: Problem) -> None:
        """Refuse headings of axes that are almost vertical.

        Raises:
            InputError: an axis has no clear heading; the message names its image.
        """
        if self.kind is not HeadingPrior:
            return
        rotations = rotation_matrices(problem.cam_from_world[self.rows, :4])
        up = np.einsum("nj,nj->n", rotations[:, :, 2], self._measured)
        steep = np.degrees(np.arccos(np.clip(np.abs(up), 0, 1))) < STEEPEST
        if steep.any():
            prior = self.priors[int(np.flatnonzero(steep)[0])]
            raise InputError(
                f"priors: {prior.name}: expected an axis at least {STEEPEST:g} degrees from the "
                "vertical, found one with no clear heading; use axis (0, -1, 0) for a camera that "
                "looks down"
            )


@dataclass(frozen=True, eq=False)
class ProblemAttitudes:
    """Attitude priors, and their images in a problem.

    Attributes:
        priors: priors in the order given.
        image_ids: ids of their images.
        groups: priors by kind, in the order of KINDS.
    """

    priors: tuple[AttitudePrior, ...]
    image_ids: tuple[int, ...]
    groups: tuple[AttitudesOfKind, ...]

    @staticmethod
    def make(problem: Problem, priors: Iterable[AttitudePrior]) -> ProblemAttitudes:
        """Find the image of each prior.

        Raises:
            InputError: an image is not in the problem, its name is not unique, or two priors of
                one kind have the same image.
        """
        given = tuple(priors)
        groups, image_ids = [], dict[int, int]()
        for kind in KINDS:
            places = [place for place, prior in enumerate(given) if isinstance(prior, kind)]
            if not places:
                continue
            chosen = tuple(given[place] for place in places)
            rows = rows_of_images(problem, chosen)
            groups.append(AttitudesOfKind(kind, chosen, rows))
            image_ids.update(zip(places, problem.image_ids[rows].tolist(), strict=True))
        ids = tuple(image_ids[place] for place in range(len(given)))
        return ProblemAttitudes(given, ids, tuple(groups))

    def factors(self) -> list[Factor]:
        """Return a factor for each prior, in order."""
        pairs = zip(self.priors, self.image_ids, strict=True)
        return [prior.factor(image_id) for prior, image_id in pairs]

    def placement(self, problem: Problem) -> Similarity | None:
        """Return the turn of the world about the middle of the cameras; None without effect."""
        turn = np.eye(3)
        for group in self.groups:
            if group.kind is not HeadingPrior or self.group(OrientationPrior) is None:
                turn = group.of_tied(problem).agreement(problem, turn).rotation @ turn
        if np.linalg.norm(log(turn[None])[0]) < math.radians(1e-9):
            return None
        middle = problem.projection_centers.mean(axis=0)
        return Similarity(1.0, turn, middle - turn @ middle)

    @property
    def has_vertical(self) -> bool:
        """True for priors that determine the vertical of the world on their own."""
        return any(group.kind is not HeadingPrior for group in self.groups)

    def check(self, problem: Problem) -> None:
        """Refuse priors without a meaning at the start of a solve.

        Raises:
            InputError: see :meth:`AttitudesOfKind.check`.
        """
        for group in self.groups:
            group.check(problem)

    def group(self, kind: type[AttitudePrior]) -> AttitudesOfKind | None:
        """Return the priors of a kind; None without any."""
        return next((group for group in self.groups if group.kind is kind), None)


def _to_down(vectors: Array) -> Array:
    """Return the (n, 3) shortest turns of unit vectors to (0, 0, -1)."""
    x, y, z = vectors.T
    sine = np.hypot(x, y)
    angle = np.arctan2(sine, -z)
    # The axis is v x (0, 0, -1) = (-y, x, 0); opposite vectors turn about x.
    known = sine > 0
    scale = np.where(known, angle / np.where(known, sine, 1.0), 0.0)
    turns = np.stack([-y * scale, x * scale, np.zeros(len(x))], axis=1)
    turns[~known, 0] = angle[~known]
    return turns
