"""COLMAP's gauge of two cameras.

COLMAP makes the first frame constant, and of a second frame one coordinate of rig_from_world's
translation: the largest of the motion from the second to the first frame. A solve with gauge
"two_cameras" then keeps the scale by another coordinate. Both gauges reach the same minimum, up to
the scale about the centre c of the first frame. With X' = c + s (X - c), a second frame has

    t' = -R c' = a + s b,    a = -R c,   b = t - a,

because its centre -R^T t moves likewise. COLMAP's coordinate d of the second frame is constant if
a_d + s b_d = t_d at the start, which determines s. Translations of sensors on rigs grow by s, too.

COLMAP fixes these 7 numbers in any case. Constant points, other constant images or a fixed baseline
of a rig determine a part of the world. The solve then fixes only the rest, and its cost is lower.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.model.rigid_motions import inverse_poses, multiply_poses
from bundle.model.rotations import rotation_matrices
from bundle.solving.colmap_adjustment.adjusted_part import AdjustedPart

_SHORTEST = 1e-9
"""COLMAP's shortest baseline."""


class TwoCameras:
    """Frames of COLMAP's gauge of two cameras in a sub-problem.

    Attributes:
        held: (num_images,) mask of the images of the first frame; all False if constant variables
            determine a part of the world, or without this gauge.
    """

    def __init__(self, part: AdjustedPart) -> None:
        self._part = part
        problem, options = part.problem, part.options
        self.held = np.zeros(problem.num_images, bool)
        self._second: tuple[int, int] | None = None
        if options.gauge != "two_cameras" or "poses" not in options.refine:
            return
        # Images are sorted by id, as in COLMAP.
        rows = np.flatnonzero(part.named & ~self._moves_on_rig())
        constant = rows[part.constant_images[rows]]
        first = constant if len(constant) else rows
        if not len(first):
            return
        others = rows[part.frames[rows] != part.frames[first[0]]]
        second = self._second_of(first[0], others)
        if second is None:
            return
        held = part.named & (part.frames == part.frames[first[0]])
        points_stay = part.constant_points.any() or "points" not in options.refine
        if points_stay or (part.constant_images & ~held).any():
            return
        self.held = held
        if not self._has_fixed_baseline():
            self._first, self._second = int(first[0]), second

    def rescaled(self, refined: Problem) -> Problem:
        """Return a refined problem with the scale that COLMAP's gauge keeps."""
        if self._second is None:
            return refined
        row, d = self._second
        start = _frame_poses(self._part.problem)
        poses = _frame_poses(refined)
        centre = inverse_poses(poses[self._first : self._first + 1])[0, 4:]
        rotation = rotation_matrices(poses[row : row + 1, :4])[0]
        a = -rotation @ centre
        along = poses[row, 4 + d] - a[d]
        scale = (start[row, 4 + d] - a[d]) / along if along else 0.0
        if not (scale > 0 and np.isfinite(scale)):
            return refined
        changes = {"cam_from_world": _scaled(refined.cam_from_world, centre, scale)}
        if refined.num_frames:
            arms = refined.sensor_from_rig.copy()
            arms[:, 4:] *= scale
            changes |= {
                "rig_from_world": _scaled(refined.rig_from_world, centre, scale),
                "sensor_from_rig": arms,
            }
        return refined.replace(points=centre + scale * (refined.points - centre), **changes)

    def _moves_on_rig(self) -> NDArray[np.bool_]:
        """Return a mask of images whose sensor moves on its rig."""
        problem, options = self._part.problem, self._part.options
        if not problem.num_sensors or not options.refine_sensor_from_rig:
            return np.zeros(problem.num_images, bool)
        fixed = _fixed_sensors(problem, options)
        sensor = problem.image_sensor
        return (sensor >= 0) & ~fixed[sensor]

    def _has_fixed_baseline(self) -> bool:
        """Return True if a sensor off its rig's centre is constant: the scale is known."""
        problem, options = self._part.problem, self._part.options
        if not problem.num_sensors:
            return False
        arms = np.abs(problem.sensor_from_rig[:, 4:]).max(axis=1, initial=0) > 0
        if options.refine_sensor_from_rig:
            arms &= _fixed_sensors(problem, options)
        return bool(arms.any())

    def _second_of(self, first: int, others: NDArray[np.intp]) -> tuple[int, int] | None:
        """Return the second image and the coordinate that COLMAP keeps; None: no image is apart."""
        if not len(others):
            return None
        poses = _frame_poses(self._part.problem)
        apart = multiply_poses(poses[[first] * len(others)], inverse_poses(poses[others]))[:, 4:]
        far = np.flatnonzero(np.abs(apart).max(axis=1) > _SHORTEST)
        if not len(far):
            return None
        return int(others[far[0]]), int(np.abs(apart[far[0]]).argmax())


def _frame_poses(problem: Problem) -> NDArray[np.float64]:
    """Return rig_from_world of each image's frame."""
    if not problem.num_frames:
        return problem.cam_from_world
    framed = problem.image_frame >= 0
    return np.where(
        framed[:, None], problem.rig_from_world[problem.image_frame], problem.cam_from_world
    )


def _fixed_sensors(problem: Problem, options: SolveOptions) -> NDArray[np.bool_]:
    pairs = zip(problem.sensor_rig_ids.tolist(), problem.sensor_camera_ids.tolist(), strict=True)
    fixed = set(options.fixed_sensors)
    # COLMAP also fixes the sensors of a rig without observations of its reference sensor.
    seen = np.zeros(problem.num_images, bool)
    seen[problem.observation_image] = True
    reference = seen & (problem.image_frame >= 0) & (problem.image_sensor < 0)
    rigs = set(problem.frame_rig_ids[problem.image_frame[reference]].tolist())
    return np.array([pair in fixed or pair[0] not in rigs for pair in pairs], bool)


def _scaled(
    poses: NDArray[np.float64], centre: NDArray[np.float64], scale: float
) -> NDArray[np.float64]:
    """Return poses whose centres are scaled about a point."""
    a = -rotation_matrices(poses[:, :4]) @ centre
    return np.hstack([poses[:, :4], a + scale * (poses[:, 4:] - a)])
