"""Bundle adjustment of a reconstruction of a video together with the samples of its IMU.

A monocular reconstruction has no scale and no vertical, and drifts along a video. The samples of an
IMU between its images determine scale and vertical, and prevent the drift. Motions of the IMU are
factors of the solve (``motion_solve``). The model is first brought into metres with z up
(``upright_start``), where gravity is known. Position and heading stay free, or follow priors in a
world with z up. A clear offset of the clocks (``clock_offset``) is added to the times of images.

The images alone are adjusted and filtered first: their rotations determine axes, units and clocks
of the IMU, and their cost is the reference (``imu_agreement``, ``imu_findings``). Gross errors of
axes and units are refused. A result that the IMU contradicts is not usable.

Preintegrated motions are of first order in the biases. A second solve starts with motions that are
integrated again at the biases of the first one, if these moved far. If filter rounds follow, they
use the samples with the lower cost before any filter: costs are not comparable after one.

With regard to the gauge, the motions act as relative poses in metres and one vertical: a path of
consecutive relative poses joins all pieces of a world and gives their scale, but not position,
heading and tilt; gravity determines the tilt.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError
from bundle.georeference.pose_alignment import align_centers
from bundle.georeference.similarity import Similarity, moved
from bundle.graphs.factors.factors import Factor, RelativePoseFactor
from bundle.graphs.factors.image_factors import DOWN, DirectionFactor
from bundle.inertial.offline.image_intervals import CLEAR, RULES, ImageIntervals, likely_kinds
from bundle.inertial.offline.imu_agreement import (
    BOUNDED,
    Agreement,
    ClockOffset,
    cauchy_cost,
    noise_ratios,
    noise_scale_of,
    quietest_ratio,
)
from bundle.inertial.offline.imu_findings import LONG_ARM, Evidence, imu_findings, sample_faults
from bundle.inertial.offline.inertial_result import ImuSamples, InertialAdjustment
from bundle.inertial.offline.inertial_start import (
    InertialStart,
    preintegrated,
    to_priors,
    upright_start,
)
from bundle.inertial.offline.motion_solve import (
    GRAVITY,
    ImuBodies,
    MotionState,
    solved_with_motions,
)
from bundle.inertial.offline.rotation_map import (
    ANGLE,
    SCALE,
    RotationMap,
    accel_axes,
    axes_sentence,
)
from bundle.inertial.offline.score_tests import (
    Change,
    LeastCost,
    Score,
    few_steps,
    largest_score,
    unit,
    walk_slopes,
)
from bundle.inertial.preintegration.preintegration import Preintegration
from bundle.inertial.vio.window_frame import ImuInterval
from bundle.interface.option_fields import choice
from bundle.interface.options import SolveOptions
from bundle.interface.solve_record import Progress
from bundle.model.problem import Problem
from bundle.model.rigid_motions import inverse_poses, multiply_poses, rotation_matrices
from bundle.model.sequence.calibration import ImuNoise
from bundle.model.sequence.sequence_findings import bad_stretches, is_bridged
from bundle.solving.gauge_freedom import gauge_freedom
from bundle.solving.kept_errors import Edit
from bundle.solving.request import SolveRequest
from bundle.solving.result import Result
from bundle.solving.rounds.plan import RunPlan
from bundle.solving.rounds.solve_rounds import run

if TYPE_CHECKING:
    from bundle.georeference.measurements import Prior

Array = NDArray[np.float64]

LEAST_IMAGES = 5
MOST_STEPS = 200  # least limit of iterations for the images alone, which take milliseconds each
LARGEST_TURN = math.pi / 2  # beyond it, consecutive images have hardly any point in common
MOST_SOLVES = 3  # most solves in a row, each with motions that are integrated again


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
    priors: tuple[Prior, ...] = (),
    plan: RunPlan | None = None,
    progress: Progress | None = None,
    place: Callable[[int], str] | None = None,
) -> InertialAdjustment:
    """Adjust a reconstruction of a video with the samples of its IMU.

    Args:
        problem: reconstruction in any frame and unit; with rigs, one rig has all images. A rig with
            constant sensors is in metres.
        image_times_ns: (n,) times of the problem's images, on the same clock.
        camera_from_imu: (7,) qx qy qz qw tx ty tz in metres, the same for all images; on a rig,
            that of the reference sensor.
        options: options of the solve; ``backend`` must be "auto" or "ceres", ``gauge`` "auto" or
            "none", and no image is fixed.
        imu_noise_scale: factor on the two noise densities; None: 5 for images at 4 Hz, otherwise
            in proportion to the root of the time between images, and at least 1.
        imu_samples: "instant": samples are rates and forces at their stamps; "interval": means over
            the interval that follows; "auto": as the rotations of the images tell, or else the
            kind with the lower cost.
        priors: measured positions of images and control points in metres with z up, and attitudes;
            the result is in their frame.
        plan: rounds of adjusting and filtering, without checkpoints and held-out observations;
            None: no filter.
        progress: as for :func:`bundle.solve`.
        place: function that converts a row of the samples to text; None: "IMU sample 7".

    Raises:
        InputError: an argument is wrong, the samples do not cover the images, axes or units are
            not those of camera_from_imu, or the motion does not determine the scale.
    """
    if plan is not None and (plan.file is not None or plan.held_out.hold_out):
        raise InputError("plan: expected neither checkpoints nor held-out observations")
    bodies = ImuBodies.of(problem, image_times_ns, camera_from_imu)
    given = options or SolveOptions()
    options, plan = _checked(bodies, given), plan or RunPlan()
    alone = SolveRequest(
        problem=problem,
        options=given.replace(max_num_iterations=max(given.max_num_iterations, MOST_STEPS)),
        priors=priors,
    )
    images = _images_alone(alone, plan, progress)
    imu_samples = choice("imu_samples", imu_samples, ("auto", *RULES))
    scale = noise_scale_of(bodies.stamps, imu_noise_scale)
    case = _Case(
        problem=problem, bodies=bodies, noise=noise.scaled(scale, walks=False), priors=alone.priors,
        options=options, progress=progress, images=images, samples=samples,
        place=place or (lambda row: f"IMU sample {row}"),
    )  # fmt: skip
    best = min(
        (_adjusted(case, video, clock) for video, clock in _videos(case, imu_samples)),
        key=lambda found: found.cost + CLEAR * found.clock.lowers_cost,
    )
    if plan.filters:
        best = _filtered(case, best, plan)
    kept = best.state.problem
    if kept.num_observations < problem.num_observations:
        case = case._replace(images=_images_alone(alone.at(kept), RunPlan(), progress))
    known = _evidence(case, best, scale)
    findings = imu_findings(known)
    back, state, last = np.argsort(bodies.rows), best.state, best.results[-1]
    costs = np.asarray(last.factor_costs_after)
    summary = last.summary
    if any(finding.is_problem for finding in findings) and not summary.interrupted:
        summary = dataclasses.replace(summary, is_solution_usable=False)
    finished = dataclasses.replace(
        last, summary=summary, problem=state.problem, initial_problem=problem,
        similarity=best.similarity,
        edits=(Edit("alignment", problem, moved(problem, best.similarity)),),
    )  # fmt: skip
    return InertialAdjustment(
        result=finished, similarity=best.similarity,
        scale=align_centers(problem.projection_centers, state.problem.projection_centers).scale,
        start=best.start, timestamps_ns=bodies.stamps[back], velocities=state.velocities[back],
        gyro_biases=state.biases[back, :3], accel_biases=state.biases[back, 3:],
        imu_cost=float(costs[: len(bodies) - 1].sum()), noise_scale=scale,
        num_solves=len(best.results), clock=best.clock, imu_samples=best.video.kind,
        gauge_freedom=_gauge_freedom(case, state.problem), agreement=known.agreement,
        findings=findings,
    )  # fmt: skip


class _Case(NamedTuple):
    """Arguments of an adjustment."""

    problem: Problem
    bodies: ImuBodies
    noise: ImuNoise
    priors: tuple[Prior, ...]
    options: SolveOptions
    progress: Progress | None
    images: Result
    samples: ImuSamples
    place: Callable[[int], str]

    @property
    def between(self) -> Array:
        """(n - 1, 3, 3) rotations of the IMU between images, by the images alone."""
        rotations = self.bodies.imu_rotations(self.images.problem)
        return np.asarray(np.swapaxes(rotations[:-1], 1, 2) @ rotations[1:])

    @property
    def is_metric(self) -> bool:
        """True for constant baselines between sensors of a rig."""
        options, arms = self.options, self.problem.sensor_from_rig[:, 4:]
        held = not options.refine_sensor_from_rig or bool(options.fixed_sensors)
        return bool(held and arms.any())


class _Adjusted(NamedTuple):
    """Adjustment with one kind of samples."""

    video: ImageIntervals
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

    @property
    def has_ended(self) -> bool:
        """True if the last result is not usable, or was interrupted."""
        summary = self.results[-1].summary
        return summary.interrupted or not summary.is_solution_usable

    def solved(
        self, case: _Case, motions: list[Preintegration], plan: RunPlan | None = None
    ) -> _Adjusted:
        """Return the adjustment after a run with motions; by default a single solve."""
        result, state = solved_with_motions(
            self.state, case.bodies, motions, case.noise, case.priors, case.options,
            plan or RunPlan(), case.progress,
        )  # fmt: skip
        return self._replace(state=state, results=[*self.results, result])

    def motions(self, case: _Case, change: Change | None = None) -> list[Preintegration]:
        """Return the motions between bodies, integrated at the biases."""
        intervals = self.video.at(self.clock.seconds if self.clock.is_clear else 0.0)
        if change is not None:
            intervals = [change.of_samples(k, one) for k, one in enumerate(intervals)]
        return preintegrated(intervals, case.noise, self.state.biases[:-1], self.video.rule)

    def settled(self, case: _Case) -> _Adjusted:
        """Solve until the motions fit the biases; return the last adjustment."""
        found = self
        for _ in range(MOST_SOLVES):
            motions = found.motions(case)
            found = found.solved(case, motions)
            if found.has_ended or not found.moved_far(motions):
                break
        return found

    def moved_far(self, motions: list[Preintegration]) -> bool:
        """Return True if a gyroscope bias is too far from that of its preintegrated motion."""
        pairs = zip(motions, self.state.biases, strict=False)
        return any(motion.needs_repropagation(bias[:3]) for motion, bias in pairs)


def _videos(case: _Case, kind: str) -> list[tuple[ImageIntervals, ClockOffset]]:
    """Return the intervals for each likely kind of samples, and likely offsets of the clocks."""
    found = {}
    for one in RULES if kind == "auto" else (kind,):
        video = ImageIntervals(case.samples, case.bodies.stamps, one)
        found[one] = video, video.offset(case.between, case.noise)
    kinds = likely_kinds(found["instant"][1], found["interval"][1]) if kind == "auto" else (kind,)
    likely = [found[one] for one in kinds]
    if all(clock.is_doubtful for _, clock in likely):
        video, clock = likely[0]
        likely.append((video, clock._replace(lowers_cost=True)))
    return likely


def _adjusted(case: _Case, video: ImageIntervals, clock: ClockOffset) -> _Adjusted:
    intervals = video.at(clock.seconds if clock.is_clear else 0.0)
    _, wrong = _rotation_map(case, video, clock).cause(case.bodies.body_from_imu)
    if wrong:
        raise InputError(f"imu: {wrong}")
    try:
        start, similarity = upright_start(
            case.problem, case.bodies, intervals, case.noise, video.rule, is_metric=case.is_metric
        )
    except InputError:
        bad, stamps = bad_stretches(*case.samples[1:]), case.samples.timestamps_ns
        long = [stretch for stretch in bad if not is_bridged(stretch, stamps)]
        arm = float(np.linalg.norm(case.bodies.body_from_imu[4:]))
        wrong = f"expected measurements, found {sample_faults(long, stamps, case.place)[0]}"
        if not long:
            wrong = video.far_offset(case.between) or _accel_axes(case, intervals, video.rule)
        if not wrong and arm > LONG_ARM:
            wrong = f"expected camera_from_imu in metres, found an arm of {arm:.3g}: millimetres?"
        if wrong:
            raise InputError(f"imu: {wrong}") from None
        raise
    placed = moved(case.problem, similarity)
    further = to_priors(placed, case.priors)
    if further is not None:
        similarity = further.after(similarity)
        placed = moved(case.problem, similarity)
    state = MotionState(
        placed,
        start.velocities @ similarity.rotation.T,
        np.tile(np.append(start.gyro_bias, start.accel_bias), (len(case.bodies), 1)),
    )
    return _Adjusted(video, clock, start, similarity, state, []).settled(case)


def _images_alone(request: SolveRequest, plan: RunPlan, progress: Progress | None) -> Result:
    """Return the adjustment without the IMU, at its minimum, with which costs are compared."""
    found = run(request, plan, progress)
    if found.summary.interrupted:
        raise KeyboardInterrupt
    return found


def _rotation_map(case: _Case, video: ImageIntervals, clock: ClockOffset) -> RotationMap:
    """Return the map; rates are divided by 100 if they turn by more than LARGEST_TURN."""
    intervals = video.at(clock.seconds if clock.is_clear else 0.0)
    turns = [np.linalg.norm(one.gyro, axis=1).mean() * one.dt.sum() for one in intervals]
    unit = 0.01 if np.quantile(turns, 0.9) > LARGEST_TURN else 1.0
    scaled = [dataclasses.replace(one, gyro=unit * one.gyro) for one in intervals]
    motions = preintegrated(scaled, case.noise, np.zeros(6), video.rule)
    return RotationMap.between(case.between, motions, unit)


def _accel_axes(case: _Case, intervals: list[ImuInterval], rule: str) -> str:
    problem, bodies = case.images.problem, case.bodies
    found = accel_axes(
        bodies.imu_rotations(problem), bodies.centers(problem), bodies.arms(problem),
        intervals, case.noise, GRAVITY, rule,
    )  # fmt: skip
    if found is None:
        return ""
    axes, start = found
    return (
        f"{axes_sentence('accelerometer', axes)}; with the given axes, the scale is "
        f"{start.scale:.3g} +- {100 * start.scale_sigma:.2g} % m per unit"
    )


def _held(
    case: _Case, found: _Adjusted, agreement: Agreement, rotations: RotationMap
) -> Score | None:
    shortly = case._replace(options=few_steps(case.options), progress=None)
    has_scale = case.is_metric or case.priors

    def solved(change: Change, **options: Any) -> tuple[Result, LeastCost]:
        start = found.state if has_scale else found.state.scaled(1 / change.forces)
        there = shortly._replace(
            bodies=change.of_bodies(case.bodies), options=shortly.options.replace(**options)
        )
        end = found._replace(state=start).solved(there, found.motions(case, change))
        return end.results[-1], LeastCost.of(end.results[-1], end.state, case.bodies)

    motions, noise, likely = found.motions(case), case.noise, []
    if rotations.angle > ANGLE / 2:
        likely.append(Score("camera_from_imu", unit(rotations.turn)))
    if abs(rotations.scale - 1) > SCALE / 2:
        likely.append(Score("gyro_scale"))
    return largest_score(
        lambda change: solved(change)[1],
        lambda change: solved(change, max_num_iterations=0)[1].motions,
        likely,
        walk_slopes(found.state.biases, np.array([one.duration for one in motions]), noise),
        agreement,
    )


def _evidence(case: _Case, found: _Adjusted, noise_scale: float) -> Evidence:
    last, alone = found.results[-1], case.images
    problem = alone.problem
    unknowns = 6 * problem.num_images + 3 * problem.num_points
    freedom = max(2 * problem.num_observations - unknowns, 1)
    costs = np.asarray(last.factor_costs_after)
    cost, least = last.summary.final_cost, alone.summary.final_cost
    variance = 2 * least / freedom
    if alone.summary.termination_type != "CONVERGENCE" or case.options.loss in BOUNDED:
        cost, least = (cauchy_cost(one.problem, case.options.loss_scale) for one in (last, alone))
        cost += float(costs.sum())
    agreement = Agreement.of(costs, len(case.bodies) - 1, cost, (least, variance), noise_scale)
    video, clock = found.video, found.clock
    density = case.noise.scaled(1 / noise_scale, walks=False)
    rotations = _rotation_map(case, video, clock)
    far = "imu_clocks", video.far_offset(case.between) if agreement.is_contradicted else ""
    if agreement.is_contradicted and not (far[1] or rotations.is_turned or rotations.is_scaled):
        intervals = video.at(clock.seconds if clock.is_clear else 0.0)
        far = "accel_axes", _accel_axes(case, intervals, video.rule)
    return Evidence(
        agreement=agreement, is_converged=last.summary.termination_type == "CONVERGENCE",
        is_quadratic=case.options.loss == "trivial", rotations=rotations, far=far,
        held=lambda: None if found.has_ended else _held(case, found, agreement, rotations),
        clocks=video.clock_errors(case.between, case.noise, clock), offset=clock,
        noise=noise_ratios(*case.samples, density), quietest=quietest_ratio(*case.samples, density),
        noise_scale=noise_scale, camera_from_imu=case.bodies.body_from_imu,
        bad=bad_stretches(*case.samples[1:]), stamps=case.samples.timestamps_ns, place=case.place,
        begins=case.bodies.stamps[:-1],
    )  # fmt: skip


def _filtered(case: _Case, found: _Adjusted, plan: RunPlan) -> _Adjusted:
    """Return the adjustment after filter rounds; solve again if the biases have moved far."""
    if found.has_ended:
        return found
    motions = found.motions(case)
    found = found.solved(case, motions, plan)
    last = found.results[-1]
    if found.has_ended or not found.moved_far(motions):
        return found
    found = found.settled(case)
    return found._replace(results=[*found.results[:-1], found.results[-1].following(last)])


def _gauge_freedom(case: _Case, problem: Problem) -> int:
    """Return the degrees of freedom of the world that motions and priors do not determine."""
    first = np.unique(problem.observation_image)
    if case.bodies.kind == "frame":
        frames = problem.image_frame[first]
        first = first[np.unique(frames, return_index=True)[1]]
    poses = problem.cam_from_world[first]
    between = multiply_poses(poses[1:], inverse_poses(poses[:-1]))
    keys = [("image", image) for image in problem.image_ids[first].tolist()]
    down = -rotation_matrices(poses[:1, :4])[0][:, 2]
    factors: list[Factor] = [DirectionFactor(keys[0], down, 1.0, axis=DOWN)]
    factors += [
        RelativePoseFactor(keys[k], keys[k + 1], motion, 1.0) for k, motion in enumerate(between)
    ]
    return gauge_freedom(problem, case.options, factors=factors, priors=case.priors).degrees


def _checked(bodies: ImuBodies, options: SolveOptions) -> SolveOptions:
    if len(bodies) < LEAST_IMAGES:
        raise InputError(
            f"imu: expected at least {LEAST_IMAGES} {bodies.kind}s, found {len(bodies)}"
        )
    if options.fixed_image_ids or "poses" not in options.refine:
        raise InputError("imu: expected poses that are refined, found fixed images or poses")
    if options.fixed_point_ids:
        raise InputError("imu: expected points that are refined, found fixed points")
    if options.backend not in ("auto", "ceres"):
        raise InputError(f"imu: expected the backend auto or ceres, found {options.backend}")
    if options.gauge not in ("auto", "none"):
        raise InputError(
            f"imu: expected the gauge auto or none, found {options.gauge}: it would fix the tilt "
            "and the scale, which the IMU determines"
        )
    solver = options.linear_solver_type
    return options.replace(
        backend="ceres",
        gauge="none",
        linear_solver_type="sparse_schur" if solver == "auto" else solver,
    )
