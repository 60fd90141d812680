"""Drop-in for ``pycolmap.bundle_adjustment``, and COLMAP's gauge of two cameras."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.optional_packages import require_pycolmap
from bundle.base.own_process import log
from bundle.base.records import dataclass
from bundle.interface.options import SolveOptions
from bundle.interface.solve_record import Progress
from bundle.interface.summary import Summary
from bundle.model.cameras import camera_models
from bundle.model.problem import Problem
from bundle.model.problem_keys import are_in
from bundle.model.rigid_motions import inverse_poses, multiply_poses, rotation_matrices
from bundle.solving.constraints.ends import HELD_POSITION, HELD_ROTATION, Applied
from bundle.solving.executors import finished, solve_prepared
from bundle.solving.prepare import prepare
from bundle.solving.request import SolveRequest

if TYPE_CHECKING:
    from bundle.interface.colmap_options import ColmapAdjustment
    from bundle.model.pycolmap.adjustment_objects import (
        AdjustedFields,
        AdjustmentConfig,
        BundleAdjustmentConfig,
        BundleAdjustmentOptions,
        BundleAdjustmentSummary,
        Reconstruction,
    )


def bundle_adjustment(
    reconstruction: Reconstruction,
    options: BundleAdjustmentOptions | None = None,
    config: BundleAdjustmentConfig | None = None,
    *,
    cancellation_token: Any = None,
    progress: Progress | None = None,
) -> BundleAdjustmentSummary:
    """Refine a pycolmap.Reconstruction in place, as ``pycolmap.bundle_adjustment`` does.

    In a script only one name changes::

        import bundle, pycolmap
        options = pycolmap.BundleAdjustmentOptions()
        options.refine_principal_point = True
        summary = bundle.bundle_adjustment(reconstruction, options)

    The minimum is that of pycolmap: the same observations, constant variables, loss and options.
    Without ``config``, observations behind their camera are deleted first, all registered images
    are refined in the gauge of two cameras, and the errors of the points are updated, as in
    pycolmap. With ``config``, the function does what
    ``pycolmap.create_default_bundle_adjuster(options, config, reconstruction).solve()`` does.

    Five differences remain. The gauge of two cameras fixes only the degrees of freedom that are
    free: with a metric rig, constant points or constant images, the cost is lower than pycolmap's,
    which fixes 7 in any case. The gauge of three points fixes other points than pycolmap's, and
    therefore reaches another cost. If COLMAP's tolerance is 0, a solve ends at a relative change of
    the cost of 1e-13, which is rounding. With a linear solver of Ceres (normal equations, QR), the
    gradient of rotations counts in full, which pycolmap bounds by 2: more steps. An invalid
    solution is discarded: the reconstruction keeps its values, and ``termination_type`` is FAILURE.

    Args:
        reconstruction: the reconstruction to change.
        options: pycolmap's options; None: pycolmap's defaults.
        config: images and points to refine, and constant variables; None: all.
        cancellation_token: a ``pycolmap.CancellationToken``. Once it is cancelled, the solve stops
            after its current iteration.
        progress: function called after each iteration, as in :func:`bundle.solve`.

    Returns:
        pycolmap's CeresBundleAdjustmentSummary. Without observations,
        a BundleAdjustmentSummary, as in pycolmap.

    Raises:
        InputError: an option that bundle cannot honour, an id that does not exist, a track that
            does not match the keypoints, or a point that was deleted during the solve; the message
            names it. The reconstruction keeps its values.
    """
    require_pycolmap("bundle_adjustment")
    from bundle.model.pycolmap import adjustment_objects

    asked = adjustment_objects.options_of(options)
    if asked.asks_for_gpu:
        log("warning", "options.ceres.use_gpu: bundle has no GPU solver; it uses the CPU")
    selected = adjustment_objects.config_of(reconstruction, config)
    if config is None:
        adjustment_objects.delete_observations_behind(reconstruction)
    read = adjustment_objects.adjusted_fields(reconstruction, selected, asked.min_track_length)
    part = adjusted_part(read, asked, selected)
    if part.problem.num_observations == 0:
        return adjustment_objects.BundleAdjustmentSummary()
    limits = _Limits(progress, cancellation_token, asked.max_seconds)
    refined, summary = _refined(part, limits)
    adjustment_objects.set_values(
        reconstruction,
        refined,
        images=part.named & ~part.constant_images,
        points=~part.constant_points,
    )
    if config is None:
        reconstruction.update_point_3d_errors()
    result = adjustment_objects.summary_of(
        vars(summary) | limits.outcome(summary),
        part.counts(),
    )
    if asked.print_summary:
        print(f"Bundle adjustment report\n{result.brief_report()}", file=sys.stderr)
    return result


def _refined(part: AdjustedPart, limits: _Limits) -> tuple[Problem, Summary]:
    gauge = TwoCameras(part)
    # Not by solve, which imports all readers of files.
    request = SolveRequest(
        problem=part.problem,
        options=part.options,
        constraints=part.constant_parts(gauge.held),
    )
    prepared = prepare(request)
    result = finished(prepared, solve_prepared(prepared, limits if limits.needed else None))
    return gauge.rescaled(result.problem), result.summary


@dataclass
class _Limits:
    """Progress function that stops a solve when it is cancelled or takes too long."""

    progress: Progress | None
    token: Any
    max_seconds: float

    def __post_init__(self) -> None:
        self._started, self._is_late = time.monotonic(), False

    @property
    def needed(self) -> bool:
        """True if a solve has to call this function."""
        return self.progress is not None or self.token is not None or self.max_seconds < 1e9

    def __call__(self, iteration: dict[str, Any]) -> None:
        if self.progress is not None:
            self.progress(iteration)
        self._is_late = time.monotonic() - self._started >= self.max_seconds
        if self._is_late or (self.token is not None and self.token.is_cancelled):
            raise KeyboardInterrupt

    def outcome(self, summary: Summary) -> dict[str, str]:
        """Return the fields of Ceres' summary for a solve that was stopped."""
        if not summary.interrupted:
            return {}
        if self._is_late:
            return {
                "termination_type": "NO_CONVERGENCE",
                "message": f"Maximum solver time reached: {self.max_seconds} seconds.",
            }
        return {"termination_type": "USER_SUCCESS"}


# Sub-problem that a ``pycolmap.BundleAdjustmentConfig`` selects, and COLMAP's two-camera gauge.
#
# The rules are COLMAP's (bundle_adjustment_ceres.cc):
#
# - Observations of the named images take part, and all observations of the named points. Points
#   with shorter tracks than ``min_track_length`` take no part.
# - An image that takes part only because of a named point is constant. If it belongs to a rig, its
#   pose does not follow its frame. A camera of such images only has constant intrinsics.
# - A point is constant if it is named so, or if some of its observations take no part.

_Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class AdjustedPart:
    """Sub-problem of an adjustment."""

    problem: Problem  # the sub-problem
    options: SolveOptions  # options of its solve
    named: _Mask  # (num_images,) mask of the images that the configuration names
    frames: NDArray[np.int64]  # (num_images,) frame id of each image in the reconstruction
    constant_images: _Mask  # (num_images,) mask of the images with a constant frame
    constant_points: _Mask  # (num_points,) mask
    constant_rotations: bool  # True if frames only move without turning

    def constant_parts(self, held: _Mask) -> Applied:
        """Return the constant parts of poses; ``held``: mask of further constant images."""
        parts = {}
        if self.constant_rotations:
            parts = dict.fromkeys(self.problem.image_ids.tolist(), HELD_ROTATION)
        whole = self.problem.image_ids[self.constant_images | held].tolist()
        parts |= dict.fromkeys(whole, HELD_ROTATION | HELD_POSITION)
        return Applied(rules=(), held_poses=parts)

    def counts(self) -> dict[str, int]:
        """Return the numbers of blocks, residuals and parameters that COLMAP passes to Ceres.

        They include constant points and cameras. A pose on a rig consists of the blocks
        sensor_from_rig and rig_from_world. A constant sensor_from_rig is not a block; a constant
        rig_from_world is then not a block, either.
        """
        problem, options = self.problem, self.options
        moves = ~self.constant_images & ("poses" in options.refine)
        sensor = np.full(problem.num_images, -1)
        if options.refine_sensor_from_rig and problem.num_frames:
            framed = problem.image_sensor >= 0
            free = np.where(_listed_sensors(problem, options), -1, np.arange(problem.num_sensors))
            sensor[framed] = free[problem.image_sensor[framed]]
        frames = self.frames[self.named & (moves | (sensor >= 0))]
        sensors = sensor[self.named & (sensor >= 0)]
        poses = len(set(frames.tolist())) + len(set(sensors.tolist()))
        params = sum(len(camera_models()[name]) for name in problem.camera_models)
        return {
            "num_residual_blocks": problem.num_observations,
            "num_residuals": 2 * problem.num_observations,
            "num_parameter_blocks": problem.num_cameras + problem.num_points + poses,
            "num_parameters": params + 3 * problem.num_points + 7 * poses,
        }


def adjusted_part(
    read: AdjustedFields, asked: ColmapAdjustment, config: AdjustmentConfig
) -> AdjustedPart:
    """Return the sub-problem of an adjustment with its constant variables."""
    part = Problem(**read.fields)
    named = are_in(part.image_ids, config.images)
    part = _without_frames_of(part, ~named)
    seen = np.bincount(part.observation_point, minlength=part.num_points)
    constant_points = (read.tracks > seen) | are_in(part.point_ids, config.constant_points)
    constant_images = ~named | are_in(read.frames, config.constant_frames)
    constant_cameras = are_in(part.camera_ids, config.constant_cameras)
    constant_cameras |= np.bincount(part.image_camera[named], minlength=part.num_cameras) == 0
    sensors = zip(part.sensor_rig_ids.tolist(), part.sensor_camera_ids.tolist(), strict=True)
    use_one_thread = 2 * part.num_observations < asked.min_residuals_for_threads
    options = asked.options.replace(
        gauge=config.gauge,
        num_threads=1 if use_one_thread else asked.options.num_threads,
        fixed_camera_ids=part.camera_ids[constant_cameras],
        fixed_point_ids=part.point_ids[constant_points],
        fixed_sensors=[pair for pair in sensors if pair[1] in config.constant_sensors],
    )
    return AdjustedPart(
        problem=part,
        options=options,
        named=named,
        frames=read.frames,
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


# COLMAP's gauge of two cameras.
#
# COLMAP makes the first frame constant, and of a second frame one coordinate of rig_from_world's
# translation: the largest of the motion from the second to the first frame. A solve with gauge
# "two_cameras" then keeps the scale by another coordinate. Both gauges reach the same minimum, up
# to the scale about the centre c of the first frame. With X' = c + s (X - c), a second frame has
#
#     t' = -R c' = a + s b,    a = -R c,   b = t - a,
#
# because its centre -R^T t moves likewise. COLMAP's coordinate d of the second frame is constant if
# a_d + s b_d = t_d at the start, which determines s. Translations of sensors on rigs grow by s,
# too.
#
# COLMAP fixes these 7 numbers in any case. Constant points, other constant images or a fixed
# baseline of a rig determine a part of the world. The solve then fixes only the rest, and its cost
# is lower.

_SHORTEST = 1e-9  # COLMAP's shortest baseline


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
        """Return COLMAP's second image and fixed coordinate; None: all centres coincide."""
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


def _listed_sensors(problem: Problem, options: SolveOptions) -> NDArray[np.bool_]:
    """Return a mask of the sensors in ``options.fixed_sensors``."""
    pairs = zip(problem.sensor_rig_ids.tolist(), problem.sensor_camera_ids.tolist(), strict=True)
    fixed = set(options.fixed_sensors)
    return np.array([pair in fixed for pair in pairs], bool)


def _fixed_sensors(problem: Problem, options: SolveOptions) -> NDArray[np.bool_]:
    # COLMAP also fixes the sensors of a rig without observations of its reference sensor.
    seen = np.zeros(problem.num_images, bool)
    seen[problem.observation_image] = True
    reference = seen & (problem.image_frame >= 0) & (problem.image_sensor < 0)
    rigs = problem.frame_rig_ids[problem.image_frame[reference]]
    return _listed_sensors(problem, options) | ~np.isin(problem.sensor_rig_ids, rigs)


def _scaled(
    poses: NDArray[np.float64], centre: NDArray[np.float64], scale: float
) -> NDArray[np.float64]:
    """Return poses whose centres are scaled about a point."""
    a = -rotation_matrices(poses[:, :4]) @ centre
    return np.hstack([poses[:, :4], a + scale * (poses[:, 4:] - a)])
