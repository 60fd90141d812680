"""The diagnosis in sentences, problems first.

Checks of the scale. Rigs whose sensors share one position do not determine the scale, like a
panorama head.

Images and points alone do not determine the scale. A solve without a fixed scale may shrink the
world a little at each step, geometrically. The cost does not change, but after many steps numbers
lose digits.

Unknowns of the reduced camera system, by cameras and images, and counts of its equations.

An observation gives two equations. A point seen by two images has three unknowns, an image six, a
camera one per refined parameter. Seven unknowns of a component belong to the gauge. If there are
fewer equations than other unknowns, the current positions of the images are not determined. Two
images that merely happen to have the same position are then not a panorama.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.diagnosis.diagnose_graph import fault, note
from bundle.analysis.diagnosis.diagnosis_result import Diagnosis, WeakMode
from bundle.analysis.diagnosis.track_table import FEW_SHARED, TrackTable, weak_joint
from bundle.base.records import dataclass
from bundle.base.words import named, noun, plural, sorted_ids
from bundle.interface.finding import Finding
from bundle.model.cameras import camera_models, param_kinds, project
from bundle.model.problem import Problem
from bundle.model.rigid_motions import quaternion_inverse, quaternion_rotate
from bundle.solving.result import Result

MOST_COMPONENTS = 5  # number of components that get a sentence of their own
SAID = ("points_seen_once",)  # warnings of a solve that the diagnosis reports in its own words
SHARP = 1000.0
"""Gap of eigenvalues below which the number of null directions depends on the threshold."""
DRIFT = 3.0  # scale change of the world by a solve that counts as drift


def findings(
    diagnosis: Diagnosis,
    problem: Problem,
    tracks: TrackTable,
    found: dict[str, Any],
    apart: list[WeakMode],
    drift: ScaleDrift | None,
) -> tuple[Finding, ...]:
    """Return the findings; `diagnosis` has all other fields.

    ``apart``: findings about components, loose or not.
    """
    all_of_them = [
        *_components(diagnosis, apart),
        *(
            fault(mode.kind, mode.sentence)
            for mode in diagnosis.weak_modes
            if mode.kind != "component"
        ),
        *_collapsed(diagnosis),
        *_points(diagnosis),
        *_images(diagnosis),
        *([] if (joint := weak_joint(problem, tracks)) is None else [joint]),
        *rigs_without_baseline(problem),
        *_factorisation(found),
        *_rank(diagnosis),
        *_drift(drift),
        *_conditioning(diagnosis),
        *(note(kind, words) for kind, words in found["warnings"] if kind not in SAID),
    ]
    return tuple(sorted(all_of_them, key=lambda finding: not finding.is_problem))


def _components(diagnosis: Diagnosis, apart: list[WeakMode]) -> Iterator[Finding]:
    if not diagnosis.components:
        yield fault("no_observations", "There are no observations: nothing is determined.")
    is_problem = diagnosis.nullity > diagnosis.expected_nullity
    sentences = [mode.sentence for mode in apart[:MOST_COMPONENTS]]
    rest = apart[MOST_COMPONENTS:]
    if rest:
        count = sum(len(mode.image_ids) for mode in rest)
        sentences.append(f"{plural(len(rest), 'more component')} of {plural(count, 'image')}.")
    for sentence in sentences:
        yield Finding(kind="component", is_problem=is_problem, sentence=sentence)


def _collapsed(diagnosis: Diagnosis) -> Iterator[Finding]:
    clusters = diagnosis.collapsed
    if not clusters:
        return
    points = {point for cluster in clusters for point in cluster.point_ids}
    images = {image for cluster in clusters for image in cluster.image_ids}
    count = sum(cluster.num_observations for cluster in clusters)
    yield fault(
        "collapsed_scale",
        f"Collapsed in scale: {plural(len(points), 'point')} sit on cameras "
        f"({plural(count, 'observation')} in {named('image', sorted(images))} with a depth below "
        "1e-4 of the median). Remove these points and images, or start them elsewhere.",
    )


def _points(diagnosis: Diagnosis) -> Iterator[Finding]:
    d = diagnosis
    checks = (
        (
            "points_without_parallax",
            d.points_without_parallax,
            True,
            "without parallax: on one line with all images that see them, so that no observation "
            "sees the depth",
        ),
        (
            "points_at_cameras",
            d.points_at_cameras,
            True,
            "at the centre of a camera that sees them",
        ),
        (
            "points_seen_once",
            d.points_seen_once,
            True,
            "seen by one image only: the depth is free",
        ),
        (
            "unobserved_points",
            d.unobserved_points,
            False,
            "without observations: not refined",
        ),
        (
            "points_seen_twice",
            d.points_seen_twice,
            False,
            "seen by two images only: errors along the epipolar line do not show",
        ),
        (
            "points_at_infinity",
            d.points_at_infinity,
            False,
            "almost at infinity: they determine rotations only, which is not an error",
        ),
    )
    for kind, ids, is_problem, words in checks:
        if len(ids):
            yield Finding(
                kind=kind,
                is_problem=is_problem,
                sentence=f"{plural(len(ids), 'point')} {words} ({named('point', ids.tolist())}).",
            )


def _images(diagnosis: Diagnosis) -> Iterator[Finding]:
    few = diagnosis.images_with_few_shared_points
    if len(few):
        yield fault(
            "images_with_few_shared_points",
            f"{plural(len(few), 'image')} {noun(len(few), 'shares', 'share')} fewer than "
            f"{FEW_SHARED} points with the rest: the relative pose is not determined "
            f"({named('image', few.tolist())}).",
        )
    few = diagnosis.images_with_few_observations
    if len(few):
        yield note(
            "images_with_few_observations",
            f"{plural(len(few), 'image')} {noun(len(few), 'has', 'have')} fewer than 10 "
            f"observations ({named('image', few.tolist())}).",
        )


def _factorisation(found: dict[str, Any]) -> Iterator[Finding]:
    if found["failure"]:
        yield fault("not_factorised", str(found["failure"]))
    if found["failed_unknown"] >= 0:
        yield note(
            "failing_column",
            "A Cholesky factorisation without damping stops at column "
            f"{found['failed_unknown'] + 1}: {found['failed_name']}.",
        )


def _rank(diagnosis: Diagnosis) -> Iterator[Finding]:
    gap = diagnosis.rank_gap
    if not gap < SHARP:
        return
    yield note(
        "unclear_rank",
        f"The number of null directions is not certain: the lowest eigenvalue that is not zero, "
        f"{diagnosis.eigenvalues[0]:.2g}, is only {gap:.3g} times the largest that counts as zero.",
    )


def _drift(drift: ScaleDrift | None) -> Iterator[Finding]:
    if drift is not None and not 1 / DRIFT < drift.factor < DRIFT:
        steps = plural(drift.num_steps, "step")
        each = f" ({drift.per_step:.3g} per step)" if drift.num_steps > 1 else ""
        yield note(
            "scale_drift",
            f"The solve scaled the world by {drift.factor:.3g} in {steps}{each}: without "
            "rigs and positions, only the gauge fixes the scale.",
        )


def _conditioning(diagnosis: Diagnosis) -> Iterator[Finding]:
    condition = diagnosis.condition_number
    if not np.isfinite(condition):
        return
    before = diagnosis.condition_number_unscaled
    unscaled = f" ({before:.2g} before scaling)" if np.isfinite(before) else ""
    yield note(
        "conditioning",
        f"The condition number of the reduced camera system is {condition:.2g}{unscaled}: a step "
        f"has {plural(diagnosis.digits_normal_equations, 'digit')} by the normal equations and "
        f"{diagnosis.digits_square_root} by a QR factorisation.",
    )


NO_BASELINE = 1e-4
"""Share of the points' distance, below which sensors count as being at the same position."""


@dataclass(frozen=True)
class ScaleDrift:
    """Scale of a world after a solve."""

    factor: float  # ratio of the spread of the camera centres after and before the solve
    num_steps: int  # accepted steps of the solve, at least 1

    @property
    def per_step(self) -> float:
        """Geometric mean of the factors of the steps."""
        return float(self.factor ** (1.0 / self.num_steps))


def scale_drift(result: Result) -> ScaleDrift | None:
    """Return the scale change by a solve.

    Return None if the result was aligned, or if all camera centres were the same at the start.
    """
    before, after = (
        float(np.linalg.norm(centers - centers.mean(axis=0)))
        for centers in (
            result.initial_problem.projection_centers,
            result.problem.projection_centers,
        )
    )
    if not before > 0 or result.similarity is not None:
        return None
    accepted = np.asarray(result.iterations["step_is_successful"], bool)
    return ScaleDrift(after / before, max(int(accepted[1:].sum()), 1))


def rigs_without_baseline(problem: Problem) -> Iterator[Finding]:
    """Yield a finding for each rig of several sensors at one position."""
    if not problem.num_sensors or not problem.num_observations:
        return
    poses = problem.sensor_from_rig
    back = quaternion_inverse(poses[:, :4] / np.linalg.norm(poses[:, :4], axis=1, keepdims=True))
    reach = np.linalg.norm(quaternion_rotate(back, poses[:, 4:]), axis=1)
    centers = problem.projection_centers[problem.observation_image]
    away = np.linalg.norm(problem.points[problem.observation_point] - centers, axis=1)
    distance = float(np.median(away))
    for rig in np.unique(problem.sensor_rig_ids).tolist():
        own = problem.sensor_rig_ids == rig
        if float(reach[own].max()) >= NO_BASELINE * distance:
            continue
        yield Finding(
            kind="rig_without_baseline",
            is_problem=True,
            sentence=f"Rig {rig}: its {int(own.sum()) + 1} sensors are at one place, so the scale "
            "of the world is arbitrary. Give the distances of the sensors (sensor_from_rig), "
            "positions or control points.",
        )


_IMAGE, _FRAME, _SENSOR, _CAMERA = range(4)

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class CameraPart:
    """Effect of a direction on a parameter of a camera."""

    camera: int  # index of the camera
    parameter: int  # index of the parameter in the model
    amount: float  # change of the parameter, in its unit
    pixels: float  # resulting motion in pixels at the rim of the camera's observations


class Unknowns:
    """Columns of the reduced camera system, and directions in them.

    ``problem``: problem with the cameras and images. ``found``: result of `_core.reduced_spectrum`.
    """

    def __init__(self, problem: Problem, found: dict[str, Any]) -> None:
        self.problem = problem
        self.kind, self.index, self.coordinate = np.asarray(found["unknowns"]).reshape(-1, 3).T
        self.scale: Floats = found["scale"]
        self.unseen: NDArray[np.bool_] = found["unseen"].astype(bool)
        self._rims: dict[int, Floats] = {}

    @property
    def of_camera(self) -> NDArray[np.bool_]:
        """Mask of the unknowns that are camera parameters."""
        return np.asarray(self.kind == _CAMERA)

    @property
    def of_pose(self) -> NDArray[np.bool_]:
        """Mask of the unknowns that are entries of a pose."""
        return np.asarray(self.kind <= _SENSOR)

    def entities(self) -> NDArray[np.int64]:
        """Return a number for each unknown, equal for all unknowns of one pose or camera."""
        _, numbers = np.unique(np.stack([self.kind, self.index]), axis=1, return_inverse=True)
        return np.asarray(numbers, np.int64).ravel()

    def images(self, chosen: NDArray[Any]) -> NDArray[np.int64]:
        """Return the images whose poses are among the chosen unknowns, ascending."""
        kind, index = self.kind[chosen], self.index[chosen]
        images = [np.unique(index[kind == _IMAGE])]
        if self.problem.num_frames:
            frames = np.isin(self.problem.image_frame, index[kind == _FRAME])
            sensors = np.isin(self.problem.image_sensor, index[kind == _SENSOR])
            images.append(np.flatnonzero(frames | sensors))
        return np.unique(np.concatenate(images)).astype(np.int64)

    def images_of_cameras(self, cameras: list[int]) -> NDArray[np.int64]:
        """Return the images that these cameras took."""
        return np.flatnonzero(np.isin(self.problem.image_camera, cameras))

    def camera_parts(self, direction: Floats) -> list[CameraPart]:
        """Return the effects of a direction in the scaled unknowns on the cameras."""
        parts = []
        for row in np.flatnonzero(self.of_camera & (direction != 0)):
            camera, parameter = int(self.index[row]), int(self.coordinate[row])
            amount = float(direction[row] * self.scale[row])
            pixels = abs(amount) * float(self._rim(camera)[parameter])
            parts.append(CameraPart(camera, parameter, amount, pixels))
        return parts

    def parameter_name(self, part: CameraPart) -> str:
        """Return COLMAP's name of the parameter."""
        return camera_models()[self.problem.camera_models[part.camera]][part.parameter]

    def parameter_kind(self, part: CameraPart) -> str:
        """Return "focal", "principal_point" or another kind."""
        return param_kinds(self.problem.camera_models[part.camera])[part.parameter]

    def focal(self, camera: int) -> float:
        """Return the mean focal length of a camera in pixels; 1 for models without one."""
        kinds = param_kinds(self.problem.camera_models[camera])
        rows = [j for j, kind in enumerate(kinds) if kind == "focal"]
        return float(self.problem.camera_params[camera, rows].mean()) if rows else 1.0

    def _rim(self, camera: int) -> Floats:
        """Return pixels per unit of each parameter, at the rim of the camera's observations."""
        if camera in self._rims:
            return self._rims[camera]
        problem, model = self.problem, self.problem.camera_models[camera]
        params = problem.camera_params[camera, : len(camera_models()[model])]
        own = problem.image_camera[problem.observation_image] == camera
        rays = np.ones((1, 3))
        if own.any():
            xy = problem.observation_xy[own]
            rays[0, :2] = np.quantile(np.abs(xy - np.median(xy, axis=0)), 0.95, axis=0)
            rays[0, :2] /= self.focal(camera)
        change = project(model, params, rays, jacobians=True).d_params[0]
        size: Floats = np.linalg.norm(np.nan_to_num(change), axis=0)
        self._rims[camera] = size
        return size


_GAUGE = 7


@dataclass(frozen=True)
class _Count:
    equations: int
    unknowns: int
    points: int


class EquationCounts:
    """Counts that tell which components have fewer equations than unknowns.

    Components with frames of rigs, or with a camera of another component, are left out.
    """

    def __init__(self, unknowns: Unknowns, tracks: TrackTable) -> None:
        self._unknowns, self._pieces = unknowns, tracks.pieces
        self._short: dict[int, _Count] = {}
        problem = unknowns.problem
        if problem.num_frames or not problem.num_images:
            return
        size = int(tracks.pieces.max(initial=-1)) + 1
        counted = tracks.lengths[tracks.points] > 1
        images = tracks.images[counted]
        equations = 2 * np.bincount(tracks.pieces[images], minlength=size)
        firsts = np.flatnonzero(np.diff(tracks.points[counted], prepend=-1))
        points = np.bincount(tracks.pieces[images[firsts]], minlength=size)
        poses = tracks.pieces[unknowns.index[unknowns.of_pose]]
        free = 3 * points + np.bincount(poses[poses >= 0], minlength=size)
        for camera in np.unique(unknowns.index[unknowns.of_camera]).tolist():
            used = np.unique(tracks.pieces[unknowns.images_of_cameras([camera])])
            own = used[used >= 0]
            if len(own) == 1:
                free[own[0]] += int((unknowns.of_camera & (unknowns.index == camera)).sum())
        for piece in np.flatnonzero(equations < free - _GAUGE).tolist():
            self._short[piece] = _Count(
                int(equations[piece]), int(free[piece]) - _GAUGE, int(points[piece])
            )

    def mode(self, images: np.ndarray, dimension: int) -> WeakMode | None:
        """Return the mode of a deficiency of these images if their component has too few equations.

        Otherwise return None.
        """
        pieces = np.unique(self._pieces[images])
        if len(pieces) != 1 or int(pieces[0]) not in self._short:
            return None
        count = self._short[int(pieces[0])]
        ids = sorted_ids(
            self._unknowns.problem.image_ids, np.flatnonzero(self._pieces == pieces[0])
        )
        return WeakMode(
            kind="underdetermined",
            sentence=f"Underdetermined: {named('image', ids)} with "
            f"{plural(count.points, 'common point')} give {count.equations} equations for "
            f"{count.unknowns} unknowns beyond the gauge. Match more points, or fix the intrinsics "
            "(--refine poses,points).",
            image_ids=ids,
            dimension=dimension,
        )
