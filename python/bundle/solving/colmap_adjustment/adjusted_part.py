"""Sub-problem that a ``pycolmap.BundleAdjustmentConfig`` selects, and its constant variables.

The rules are COLMAP's (bundle_adjustment_ceres.cc):

- Observations of the named images take part, and all observations of the named points. Points with
  shorter tracks than ``min_track_length`` take no part.
- An image that takes part only because of a named point is constant. If it belongs to a rig, its
  pose does not follow its frame. A camera of such images only has constant intrinsics.
- A point is constant if it is named so, or if some of its observations take no part.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.interface.colmap_options import ColmapAdjustment
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.solving.constraints.applied import HELD_POSITION, HELD_ROTATION, Applied

if TYPE_CHECKING:
    from bundle.model.pycolmap.adjustment_objects import AdjustmentConfig

_Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class AdjustedPart:
    """Sub-problem of an adjustment.

    Attributes:
        problem: the sub-problem.
        options: options of its solve.
        named: (num_images,) mask of the images that the configuration names.
        frames: (num_images,) frame id of each image in the reconstruction.
        constant_images: (num_images,) mask of the images with a constant frame.
        constant_points: (num_points,) mask.
        constant_rotations: True if frames only move without turning.
    """

    problem: Problem
    options: SolveOptions
    named: _Mask
    frames: NDArray[np.int64]
    constant_images: _Mask
    constant_points: _Mask
    constant_rotations: bool

    def constant_parts(self, held: _Mask) -> Applied:
        """Return the constant parts of poses; ``held``: mask of further constant images."""
        parts = {}
        if self.constant_rotations:
            parts = dict.fromkeys(self.problem.image_ids.tolist(), HELD_ROTATION)
        whole = self.problem.image_ids[self.constant_images | held].tolist()
        parts |= dict.fromkeys(whole, HELD_ROTATION | HELD_POSITION)
        return Applied(rules=(), held_poses=parts)


def adjusted_part(
    whole: Problem,
    frames: NDArray[np.int64],
    asked: ColmapAdjustment,
    config: AdjustmentConfig,
) -> AdjustedPart:
    """Select the sub-problem of an adjustment.

    Args:
        whole: the problem with all registered images.
        frames: (num_images,) frame id of each image.
        asked: options of the adjustment.
        config: images and points of the adjustment, and its constant variables.
    """
    named = np.isin(whole.image_ids, list(config.images))
    tracks = np.bincount(whole.observation_point, minlength=whole.num_points)
    listed = np.isin(whole.point_ids, [*config.variable_points, *config.constant_points])
    of_named = named[whole.observation_image]
    observations = (of_named | listed[whole.observation_point]) & (
        tracks[whole.observation_point] >= asked.min_track_length
    )
    images = _marked(whole.observation_image[observations], whole.num_images)
    points = _marked(whole.observation_point[observations], whole.num_points)
    cameras = _marked(whole.image_camera[images], whole.num_cameras)
    selection = _without_frames_of(whole, ~named).select(
        images=images, cameras=cameras, points=points, observations=observations
    )
    part = selection.problem
    seen = np.bincount(part.observation_point, minlength=part.num_points)
    constant_points = (tracks[points] > seen) | np.isin(
        part.point_ids, list(config.constant_points)
    )
    constant_images = ~named[images] | np.isin(frames[images], list(config.constant_frames))
    of_others = ~_marked(part.image_camera[named[images]], part.num_cameras)
    constant_cameras = of_others | np.isin(part.camera_ids, list(config.constant_cameras))
    sensors = zip(part.sensor_rig_ids.tolist(), part.sensor_camera_ids.tolist(), strict=True)
    options = asked.options.replace(
        gauge=config.gauge,
        fixed_camera_ids=part.camera_ids[constant_cameras].tolist(),
        fixed_point_ids=part.point_ids[constant_points].tolist(),
        fixed_sensors=[pair for pair in sensors if pair[1] in config.constant_sensors],
    )
    if 2 * part.num_observations < asked.min_residuals_for_threads:
        options = options.replace(num_threads=1)
    return AdjustedPart(
        problem=part,
        options=options,
        named=named[images],
        frames=frames[images],
        constant_images=constant_images,
        constant_points=constant_points,
        constant_rotations=asked.constant_rotations,
    )


def _without_frames_of(problem: Problem, images: _Mask) -> Problem:
    """Return a copy in which some images have their own poses, with the same values."""
    if not problem.num_frames or not images.any():
        return problem
    alone = np.where(images, -1, problem.image_frame)
    if (alone < 0).all():
        return problem.without_rigs()
    return problem.replace(
        image_frame=alone.astype(np.int32),
        image_sensor=np.where(images, -1, problem.image_sensor).astype(np.int32),
        cam_from_world=problem.cam_from_world,
    )


def _marked(rows: NDArray[np.integer], count: int) -> _Mask:
    marks = np.zeros(count, bool)
    marks[rows] = True
    return marks
