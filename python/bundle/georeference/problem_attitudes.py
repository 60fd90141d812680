"""Attitude priors of a problem: their images, the rotation of the world that fits them, residuals.

A reconstruction has an arbitrary frame. Before a solve, the world is turned about the middle of the
cameras: by the orientations, then upright by gravity, then about the vertical by the headings. Each
step is the robust mean derived below and changes only what its measurements determine:

    orientation:  phi = Log(Z^T R Q^T),
    gravity:      phi = the shortest rotation of Q R^T m, the measured down in the world, to -z,
    heading:      phi = (heading of Q R^T a - measured heading) about z.

R is the rotation of cam_from_world and Q the rotation of the world.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.georeference.attitude_priors import (
    AttitudePrior,
    GravityPrior,
    HeadingPrior,
    OrientationPrior,
)
from bundle.georeference.measurements import FoundPriors
from bundle.georeference.similarity import Similarity
from bundle.georeference.text_lines import rows_of_images
from bundle.graphs.factors.factors import Factor
from bundle.model.problem import Problem
from bundle.model.rigid_motions import (
    quaternion_from_matrix,
    quaternion_from_vector,
    rotation_matrices,
    vector_from_quaternion,
)

Array = NDArray[np.float64]

KINDS = (OrientationPrior, GravityPrior, HeadingPrior)
"""Kinds of priors, in the order in which they turn the world."""

STEEPEST = 5.0  # least angle in degrees between the vertical and an axis with a heading


@dataclass(frozen=True, eq=False)
class AttitudesOfKind:
    """Priors of one kind, and their images."""

    kind: type[AttitudePrior]  # class of the priors
    priors: tuple[Any, ...]  # priors in the order given
    rows: NDArray[np.int64]  # (n,) index of each prior's image

    def turns(self, problem: Problem, turn: Array | None = None) -> Array:
        """Return (n, 3) the additional world rotation that fits each prior, in radians.

        ``turn``: (3, 3) rotation of its world; None: no rotation.
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
        """Return (n,) angles of the residuals in degrees, after a rotation of the world."""
        return np.asarray(np.degrees(np.linalg.norm(self.turns(problem, turn), axis=1)))

    def agreement(self, problem: Problem, base: Array | None = None) -> Agreement:
        """Return the rotation of the world on which the priors agree.

        ``base``: (3, 3) rotation of its world before that turn; None: no rotation.
        """
        before = np.eye(3) if base is None else base

        def turns(turn: Array) -> Array:
            return self.turns(problem, turn @ before)

        first = turns(np.eye(3))

        def own(index: int) -> Array:
            return exp(first[index])

        return agree(turns, own, self.sigmas, self.kind.num_residuals)

    def tied(self, problem: Problem) -> NDArray[np.bool_]:
        """Return (n,) True for images with observations, of their own or of their frame."""
        seen = np.bincount(problem.observation_image, minlength=problem.num_images) > 0
        if problem.num_frames:
            frames = np.zeros(problem.num_frames + 1, bool)  # the last entry: no frame
            frames[problem.image_frame[seen]] = True
            frames[-1] = False
            seen |= frames[problem.image_frame]
        return np.asarray(seen[self.rows])

    def of_tied(self, problem: Problem) -> AttitudesOfKind:
        """Return the priors of tied images; all if no image is tied.

        A solve rotates an image without observations to its own measurement, so it has no
        information on the world.
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
        """Refuse headings of axes that are almost vertical."""
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
class ProblemAttitudes(FoundPriors):
    """Attitude priors, and their images in a problem."""

    priors: tuple[AttitudePrior, ...]  # priors in the order given
    image_ids: tuple[int, ...]  # ids of their images
    groups: tuple[AttitudesOfKind, ...]  # priors by kind, in the order of KINDS

    moves = True

    @staticmethod
    def make(problem: Problem, priors: Iterable[AttitudePrior]) -> ProblemAttitudes:
        """Find the image of each prior."""
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

    def factors(self, problem: Problem) -> list[Factor]:  # noqa: ARG002
        """Return a factor for each prior, in order."""
        pairs = zip(self.priors, self.image_ids, strict=True)
        return [prior.factor(image_id) for prior, image_id in pairs]

    def placement(self, problem: Problem) -> Similarity | None:
        """Return the rotation of the world about the middle of the cameras; None without effect."""
        turn = np.eye(3)
        for group in self.groups:
            if group.kind is not HeadingPrior or self.group(OrientationPrior) is None:
                turn = group.of_tied(problem).agreement(problem, turn).rotation @ turn
        if np.linalg.norm(log(turn[None])[0]) < math.radians(1e-9):
            return None
        middle = problem.projection_centers.mean(axis=0)
        return Similarity(1.0, turn, middle - turn @ middle)

    @property
    def has_vertical(self) -> bool:  # type: ignore[override]
        """True for priors that determine the vertical of the world on their own."""
        return any(group.kind is not HeadingPrior for group in self.groups)

    def check(self, problem: Problem, groups: Sequence[FoundPriors] = ()) -> None:  # noqa: ARG002
        """Refuse priors that are invalid at the start of a solve."""
        for group in self.groups:
            group.check(problem)

    def group(self, kind: type[AttitudePrior]) -> AttitudesOfKind | None:
        """Return the priors of a kind; None without any."""
        return next((group for group in self.groups if group.kind is kind), None)


def _to_down(vectors: Array) -> Array:
    """Return the (n, 3) shortest rotations of unit vectors to (0, 0, -1)."""
    x, y, z = vectors.T
    sine = np.hypot(x, y)
    angle = np.arctan2(sine, -z)
    # The axis is v x (0, 0, -1) = (-y, x, 0); opposite vectors turn about x.
    known = sine > 0
    scale = np.where(known, angle / np.where(known, sine, 1.0), 0.0)
    turns = np.stack([-y * scale, x * scale, np.zeros(len(x))], axis=1)
    turns[~known, 0] = angle[~known]
    return turns


# Robust mean rotation of the world from a set of attitude measurements.
#
# Let Q be a turn of the world, and phi_i(Q) the further rotation that fits measurement i, along the
# axes of the rotated world: Log of the rotation for an orientation, the shortest rotation of the
# measured direction to down for gravity, and a turn about the vertical for a heading. With sigma_i
# its standard deviation, of each axis or of all, the lengths a_i = |phi_i / sigma_i| are compared:
#
# 1. The start is the measurement whose own turn has the least sum of a_i over all others. More than
#    half of the measurements may be wrong by any angle if the wrong ones do not agree.
# 2. Steps Q <- Exp(mean of phi_i) Q follow, with Tukey's weights (1 - (a_i / (4.685 s))^2)^2 /
#    sigma_i^2, where s is the larger of 1 and the median of a_i over its value for noise.
#
# The median of a_i for noise is that of the chi distribution: 0.6745, 1.1774 and 1.5382 for one,
# two and three numbers (Holland and Welsch 1977 for the constant 4.685).


MEDIAN = {1: 0.6744897501960817, 2: 1.1774100225154747, 3: 1.5381722544550522}
"""Median length of a standard normal vector, by its number of coordinates."""
TUKEY = 4.685
MOST_STARTS, MOST_JUDGES = 64, 2000
MOST_STEPS = 100
STEP = 1e-13  # rotation in radians below which the steps end


@dataclass(frozen=True)
class Agreement:
    """Rotation of the world on which the measurements agree."""

    rotation: Array  # (3, 3) rotation Q of the world
    lengths: Array  # (n,) remaining rotation of each measurement in standard deviations
    weights: Array  # (n,) Tukey's weights between 0 and 1; 0: the measurement disagrees


def agree(
    turns: Callable[[Array], Array], own: Callable[[int], Array], sigmas: Array, size: int
) -> Agreement:
    """Return the rotation that most measurements agree on.

    Args:
        turns: function that returns the (n, 3) turns phi_i that remain after a rotation Q (3, 3).
        own: function that returns the rotation Q (3, 3) with phi_i = 0 for measurement i.
        sigmas: (n, 1) or (n, 3) standard deviations in radians, of each axis of the turned world.
        size: number of coordinates of a rotation: 1, 2 or 3.
    """
    rotation = _best_start(turns, own, sigmas)
    for _ in range(MOST_STEPS):
        phi = turns(rotation)
        _, weights = _weigh(phi, sigmas, size)
        strength = weights[:, None] / sigmas**2
        step = (strength * phi).sum(axis=0) / strength.sum(axis=0)
        rotation = exp(step) @ rotation
        if np.linalg.norm(step) < STEP:
            break
    lengths, weights = _weigh(turns(rotation), sigmas, size)
    return Agreement(rotation, lengths, weights)


def exp(vector: Array) -> Array:
    """Return the rotation matrix of a rotation vector (3,)."""
    matrix: Array = rotation_matrices(quaternion_from_vector(vector[None]))[0]
    return matrix


def log(matrices: Array) -> Array:
    """Return the rotation vectors (n, 3) of rotation matrices (n, 3, 3)."""
    return vector_from_quaternion(quaternion_from_matrix(matrices))


def _best_start(
    turns: Callable[[Array], Array], own: Callable[[int], Array], sigmas: Array
) -> Array:
    count = int(sigmas.shape[0])
    tried = np.unique(np.linspace(0, count - 1, min(count, MOST_STARTS)).astype(int))
    judges = np.unique(np.linspace(0, count - 1, min(count, MOST_JUDGES)).astype(int))
    best, least = np.eye(3), np.inf
    for index in tried.tolist():
        rotation = own(index)
        lengths = np.linalg.norm((turns(rotation) / sigmas)[judges], axis=1)
        if (total := float(lengths.sum())) < least:
            best, least = rotation, total
    return best


def _weigh(phi: Array, sigmas: Array, size: int) -> tuple[Array, Array]:
    lengths = np.linalg.norm(phi / sigmas, axis=1)
    scale = max(1.0, float(np.median(lengths)) / MEDIAN[size])
    share = np.minimum(lengths / (TUKEY * scale), 1.0)
    return lengths, (1 - share**2) ** 2
