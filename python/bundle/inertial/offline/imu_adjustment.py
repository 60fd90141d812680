"""Bundle adjustment of a reconstruction of a video together with the samples of its IMU.

A monocular reconstruction has no scale and no vertical, and drifts along a video. The samples of an
IMU between its images determine scale and vertical, and hold the shape. Motions of the IMU are
factors of the solve (``motion_solve``). The model is first brought into metres with z up
(``inertial_start``), where gravity is known. Position and heading stay free, or follow measured
positions, whose z is up, too. A clear offset of the clocks (``clock_offset``) is added to the times
of images.

Preintegrated motions are of first order in the biases. A second solve starts with motions that are
integrated again at the biases of the first one, if these moved far.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError
from bundle.georeference.pose_alignment import align_centers
from bundle.georeference.position_prior import PositionPrior
from bundle.georeference.prior_alignment import ProblemPriors
from bundle.georeference.similarity import Similarity, moved
from bundle.inertial.offline.clock_offset import ClockOffset
from bundle.inertial.offline.image_intervals import RULES, ImageIntervals, likely_kinds
from bundle.inertial.offline.inertial_result import ImuSamples, InertialAdjustment
from bundle.inertial.offline.inertial_start import (
    InertialStart,
    preintegrated,
    solve_inertial_start,
)
from bundle.inertial.offline.motion_solve import GRAVITY, MotionState, solved_with_motions
from bundle.inertial.vio.window_frame import ImuInterval
from bundle.interface.option_fields import choice, number
from bundle.interface.options import SolveOptions
from bundle.interface.solve_record import Progress
from bundle.model.problem import Problem
from bundle.model.rotations import rotation_matrices
from bundle.model.sequence.imu_noise import ImuNoise
from bundle.solving.kept_errors import Edit
from bundle.solving.result import Result

__all__ = ["adjust_with_imu"]

Array = NDArray[np.float64]

NOISE_SCALE, AT_INTERVAL = 5.0, 0.25
"""Factor on the noise densities of data sheets, which do not include vibration, for images at this
interval in seconds."""
LEAST_IMAGES = 5
LEAST_POSITIONS = 2
MOST_SCALE_SIGMA = 0.5
"""Relative standard deviation of the first scale, beyond which the motion does not determine it."""
ROUNDS = 3


def adjust_with_imu(
    problem: Problem,
    samples: ImuSamples,
    image_times_ns: NDArray[np.int64],
    camera_from_imu: Any,
    noise: ImuNoise,
    options: SolveOptions | None = None,
    *,
    imu_noise_scale: float | None = None,
    imu_samples: str = "auto",
    positions: tuple[PositionPrior, ...] = (),
    progress: Progress | None = None,
) -> InertialAdjustment:
    """Adjust a reconstruction of a video with the samples of its IMU.

    Args:
        problem: reconstruction in any frame and unit, without rigs.
        samples: samples of the IMU, on its clock.
        image_times_ns: (n,) times of the problem's images, on the same clock.
        camera_from_imu: (7,) qx qy qz qw tx ty tz in metres, the same for all images.
        noise: noise densities and random walks of the IMU.
        options: options of the solve; ``backend`` must be "auto" or "ceres", and no image is fixed.
        imu_noise_scale: factor on the two noise densities; None: 5 for images at 4 Hz, otherwise
            in proportion to the root of the time between images, and at least 1.
        imu_samples: "instant": samples are rates and forces at their stamps; "interval": means over
            the interval that follows; "auto": as the rotations of the images tell, or else the
            kind with the lower cost.
        positions: measured positions of images in metres with z up; the result is in their frame.
        progress: as for :func:`bundle.solve`.

    Raises:
        InputError: an argument is wrong, the samples do not cover the images, or the motion does
            not determine the scale.
    """
    options = _checked(problem, options)
    imu_samples = choice("imu_samples", imu_samples, ("auto", *RULES))
    stamps = np.asarray(image_times_ns, np.int64)
    order = np.argsort(stamps, kind="stable")
    scale = _noise_scale(stamps[order], imu_noise_scale)
    case = _Case(
        problem=problem,
        order=order,
        camera_from_imu=np.asarray(camera_from_imu, np.float64),
        noise=noise.scaled(scale, walks=False),
        known=ProblemPriors.make(problem, positions),
        options=options,
        progress=progress,
    )
    best = min(
        (
            _adjusted(case, video, clock)
            for video, clock in _videos(case, samples, stamps[order], imu_samples)
        ),
        key=lambda found: found.cost,
    )
    back, state, last = np.argsort(order), best.state, best.results[-1]
    costs = np.asarray(last.factor_costs_after)
    finished = dataclasses.replace(
        last,
        problem=state.problem,
        initial_problem=problem,
        similarity=best.similarity,
        edits=(Edit("alignment", problem, moved(problem, best.similarity)),),
    )
    return InertialAdjustment(
        result=finished,
        similarity=best.similarity,
        scale=align_centers(problem.projection_centers, state.problem.projection_centers).scale,
        start=best.start,
        timestamps_ns=stamps,
        velocities=state.velocities[back],
        gyro_biases=state.biases[back, :3],
        accel_biases=state.biases[back, 3:],
        imu_cost=float(costs[: len(order) - 1].sum()),
        noise_scale=scale,
        num_solves=len(best.results),
        clock=best.clock,
        imu_samples=best.kind,
    )


class _Case(NamedTuple):
    """Arguments of an adjustment; ``order``: images in the order of time."""

    problem: Problem
    order: NDArray[np.intp]
    camera_from_imu: Array
    noise: ImuNoise
    known: ProblemPriors
    options: SolveOptions
    progress: Progress | None


class _Adjusted(NamedTuple):
    """Adjustment with one kind of samples."""

    kind: str
    clock: ClockOffset
    start: InertialStart
    similarity: Similarity
    state: MotionState
    results: list[Result]

    @property
    def cost(self) -> float:
        """Final cost; infinite for a result that is not usable."""
        summary = self.results[-1].summary
        return summary.final_cost if summary.is_solution_usable else math.inf


def _videos(
    case: _Case, samples: ImuSamples, stamps: NDArray[np.int64], kind: str
) -> list[tuple[ImageIntervals, ClockOffset]]:
    """Return the intervals for each likely kind of samples, and the offsets of the clocks."""
    rotations = _imu_rotations(case.problem, case.order, case.camera_from_imu)
    found = {}
    for one in RULES if kind == "auto" else (kind,):
        video = ImageIntervals(samples, stamps, one)
        found[one] = video, video.offset(rotations, case.noise)
    kinds = likely_kinds(found["instant"][1], found["interval"][1]) if kind == "auto" else (kind,)
    return [found[one] for one in kinds]


def _adjusted(case: _Case, video: ImageIntervals, clock: ClockOffset) -> _Adjusted:
    intervals = video.at(clock.seconds if clock.is_clear else 0.0)
    start, similarity = _start(case, intervals, video.rule)
    placed = moved(case.problem, similarity)
    if case.known.priors:
        similarity = _to_positions(placed, case.known).after(similarity)
        placed = moved(case.problem, similarity)
    state = MotionState(
        placed,
        start.velocities @ similarity.rotation.T,
        np.tile(np.append(start.gyro_bias, start.accel_bias), (len(case.order), 1)),
    )
    results: list[Result] = []
    for _ in range(ROUNDS):
        motions = preintegrated(intervals, case.noise, state.biases[:-1], video.rule)
        result, state = solved_with_motions(
            state, case.order, motions, case.camera_from_imu, case.noise, case.known.factors(),
            case.options, case.progress,
        )  # fmt: skip
        results.append(result)
        pairs = zip(motions, state.biases, strict=False)
        is_far = any(motion.needs_repropagation(bias[:3]) for motion, bias in pairs)
        if not is_far or result.summary.interrupted or not result.summary.is_solution_usable:
            break
    return _Adjusted(video.kind, clock, start, similarity, state, results)


def _checked(problem: Problem, options: SolveOptions | None) -> SolveOptions:
    options = SolveOptions() if options is None else options
    if problem.num_frames:
        raise InputError("imu: expected images without rigs, found a model with rigs")
    if problem.num_images < LEAST_IMAGES:
        raise InputError(
            f"imu: expected at least {LEAST_IMAGES} images, found {problem.num_images}"
        )
    if options.fixed_image_ids or "poses" not in options.refine:
        raise InputError("imu: expected poses that are refined, found fixed images or poses")
    if options.fixed_point_ids:
        raise InputError("imu: expected points that are refined, found fixed points")
    if options.backend not in ("auto", "ceres"):
        raise InputError(f"imu: expected the backend auto or ceres, found {options.backend}")
    solver = options.linear_solver_type
    return options.replace(
        backend="ceres",
        gauge="none",
        linear_solver_type="sparse_schur" if solver == "auto" else solver,
    )


def _noise_scale(stamps: NDArray[np.int64], given: float | None) -> float:
    """Return the factor on the noise densities.

    The errors of a tracked point are correlated from image to image: images at a higher rate hold
    more observations, but not more information. Without a smaller noise of the IMU, they would
    outweigh it.
    """
    if given is not None:
        return number("imu_noise_scale", given, above=0)
    interval = 1e-9 * float(np.median(np.diff(stamps)))
    return max(NOISE_SCALE * math.sqrt(interval / AT_INTERVAL), 1.0)


def _start(
    case: _Case, intervals: list[ImuInterval], rule: str
) -> tuple[InertialStart, Similarity]:
    """Return the start in the model's world, and the similarity to metres with z up."""
    problem, arm = case.problem, case.camera_from_imu
    rotations = rotation_matrices(problem.cam_from_world[case.order, :4])
    start = solve_inertial_start(
        _imu_rotations(problem, case.order, arm),
        problem.projection_centers[case.order],
        np.einsum("nji,j->ni", rotations, arm[4:]),
        intervals,
        case.noise,
        GRAVITY,
        rule,
    )
    if not (start.scale > 0 and start.scale_sigma < MOST_SCALE_SIGMA):
        raise InputError(
            "imu: expected a motion that determines the scale, found "
            f"{start.scale:.3g} +- {100 * start.scale_sigma:.2g} % m per unit: too little "
            "acceleration, or IMU, times and camera_from_imu do not belong to these images"
        )
    down = start.gravity / np.linalg.norm(start.gravity)
    level = _level(down)
    middle = problem.projection_centers.mean(axis=0)
    return start, Similarity(start.scale, level, -start.scale * level @ middle)


def _imu_rotations(problem: Problem, order: NDArray[np.intp], camera_from_imu: Array) -> Array:
    """Return the (n, 3, 3) rotations world_from_imu in the order of time."""
    rotations = rotation_matrices(problem.cam_from_world[order, :4])
    turned: Array = np.swapaxes(rotations, 1, 2) @ rotation_matrices(camera_from_imu[None, :4])[0]
    return turned


def _to_positions(problem: Problem, known: ProblemPriors) -> Similarity:
    """Return the heading and shift that move a levelled problem in metres to its positions.

    Raises:
        InputError: there are no two positions with a height, or they are at one place.
    """
    points = known.correspondences(problem)
    has_height = ~np.isnan(points.target[:, 2])
    if has_height.sum() < LEAST_POSITIONS:
        raise InputError(
            f"imu: expected at least {LEAST_POSITIONS} positions with a height, found "
            f"{int(has_height.sum())}"
        )
    antennas = points.source + points.offset
    return align_centers(antennas[has_height], points.target[has_height], "yaw")


def _level(down: Array) -> Array:
    """Return the shortest turn of a unit vector to (0, 0, -1)."""
    x, y, z = down
    if z > 1 - 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    axis = np.array([-y, x, 0.0])  # down x (0, 0, -1)
    cross = np.array([[0, 0, axis[1]], [0, 0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1 - z))
