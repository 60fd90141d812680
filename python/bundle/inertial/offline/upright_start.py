"""Placement of a reconstruction with an IMU: metres, z up, then heading and shift of its priors.

Scale and gravity are those of ``inertial_start``; the world turns the shortest way to z up.
Measured positions and control points then give heading and shift. Without these, priors of
attitudes give the heading: with Q their turn of the world and L the shortest turn of Q's vertical
back to z up, L Q is a turn about z. The minimum of the adjustment does not depend on this start.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError
from bundle.georeference.measurements import FoundPriors, find_priors
from bundle.georeference.pose_alignment import align_centers
from bundle.georeference.prior_alignment import survey_points
from bundle.georeference.similarity import Similarity
from bundle.georeference.similarity_fit import Correspondences
from bundle.inertial.offline.inertial_start import InertialStart, solve_inertial_start
from bundle.inertial.offline.motion_solve import GRAVITY, ImuBodies
from bundle.inertial.vio.window_frame import ImuInterval
from bundle.model.problem import Problem
from bundle.model.sequence.calibration import ImuNoise

if TYPE_CHECKING:
    from bundle.georeference.measurements import Prior

Array = NDArray[np.float64]

LEAST_POSITIONS = 2
MOST_SCALE_SIGMA = 0.5
"""Relative standard deviation of the first scale, beyond which the motion does not determine it."""
MOST_METRIC_SCALE = 2.0
"""Factor of a first scale, up or down, within which a rig may be in metres: the start is rough."""


def upright_start(
    problem: Problem,
    bodies: ImuBodies,
    intervals: list[ImuInterval],
    noise: ImuNoise,
    rule: str,
    *,
    is_metric: bool,
) -> tuple[InertialStart, Similarity]:
    """Return the start in the model's world, and the similarity to metres with z up.

    ``problem``: problem in any frame and unit. ``is_metric``: True for a constant baseline between
    sensors of a rig, which is in metres; the similarity then has scale 1.
    """
    start = solve_inertial_start(
        bodies.imu_rotations(problem),
        bodies.centers(problem),
        bodies.arms(problem),
        intervals,
        noise,
        GRAVITY,
        rule,
    )
    if not (start.scale > 0 and start.scale_sigma < MOST_SCALE_SIGMA):
        raise InputError(
            "imu: expected a motion that determines the scale, found "
            f"{start.scale:.3g} +- {100 * start.scale_sigma:.2g} % m per unit: too little "
            "acceleration, or IMU, times and camera_from_imu do not belong to these images"
        )
    if is_metric and not 1 / MOST_METRIC_SCALE < start.scale < MOST_METRIC_SCALE:
        raise InputError(
            f"imu: expected a rig with constant sensors to have metres as its unit, found "
            f"{start.scale:.3g} m per unit; scale the model, or refine sensor-from-rig"
        )
    scale = 1.0 if is_metric else start.scale
    level = _level(start.gravity / np.linalg.norm(start.gravity))
    middle = problem.projection_centers.mean(axis=0)
    return start, Similarity(scale, level, -scale * level @ middle)


def to_priors(problem: Problem, priors: Sequence[Prior]) -> Similarity | None:
    """Return the heading and shift that move a levelled problem in metres to its priors.

    None without priors.
    """
    if not priors:
        return None
    groups = find_priors(problem, priors)
    if points := survey_points(problem, groups):
        return _to_positions(points)
    turning = next((one for one in groups if one.moves), None)
    return None if turning is None else _to_headings(problem, turning)


def _to_positions(points: Correspondences) -> Similarity:
    has_height = ~np.isnan(points.target[:, 2])
    if has_height.sum() < LEAST_POSITIONS:
        raise InputError(
            f"imu: expected at least {LEAST_POSITIONS} positions with a height, found "
            f"{int(has_height.sum())}"
        )
    places = points.source + points.offset
    return align_centers(places[has_height], points.target[has_height], "yaw")


def _to_headings(problem: Problem, attitudes: FoundPriors) -> Similarity | None:
    found = attitudes.placement(problem)
    if found is None:
        return None
    turn = _level(-found.rotation[:, 2]) @ found.rotation
    middle = problem.projection_centers.mean(axis=0)
    return Similarity(1.0, turn, middle - turn @ middle)


def _level(down: Array) -> Array:
    """Return the shortest turn of a unit vector to (0, 0, -1)."""
    x, y, z = down
    if z > 1 - 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    axis = np.array([-y, x, 0.0])  # down x (0, 0, -1)
    cross = np.array([[0, 0, axis[1]], [0, 0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1 - z))
