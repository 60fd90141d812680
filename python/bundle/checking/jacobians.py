"""Check of bundle's own Jacobians on a user's problem."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import field, replace

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arrays import check_function
from bundle.base.records import dataclass
from bundle.checking.classify import classify, float_precision
from bundle.checking.evidence import Evidence, Finding
from bundle.checking.gradient_report import GradientCheckerSummary, GradientReport, Offender
from bundle.checking.jacobian_deviation import CHECKER_PRECISION, Array, JacobianDeviation
from bundle.checking.residual_blocks import Block, Column
from bundle.checking.step_curve import CheckDetails, Line, make_details, walk
from bundle.checking.tally import MOST_KEPT, Tally, Worst, make_report, undecided_points
from bundle.errors import InputError
from bundle.interface.analysis_options import SAMPLES_PER_IMAGE, TOLERANCE
from bundle.interface.option_fields import number
from bundle.io.files import Source, as_problem
from bundle.model.cameras import camera_models, param_kinds, project
from bundle.model.problem import Problem
from bundle.model.residuals import resolve_cheirality
from bundle.model.rigid_motions import (
    quaternion_from_matrix,
    quaternion_from_vector,
    rotation_matrices,
)

CHUNK = 16384
CENTER = 1e-3  # relative rounding error of the derivatives above which a point is not checked
ROUNDING_UNITS = 16  # number of rounding errors that accumulate in a residual and its Jacobian
CLOSE_UNITS = 1024
"""Factor by which differences over a fraction of the depth amplify rounding errors."""
MOST_DRAWN = 500  # number of observations of a camera model of which a page shows the errors
TURN = 0.3
"""Rotation [rad] from the origin of its chart at which every other observation is checked."""

Progress = Callable[[int, int], None]


def check_problem(
    problem: Source,
    *,
    samples_per_image: int | None = SAMPLES_PER_IMAGE,
    seed: int = 0,
    tolerance: float = TOLERANCE,
    cheirality: str = "auto",
    num_threads: int = 0,
    details: bool = False,
    progress: Progress | None = None,
) -> GradientReport:
    """Check the Jacobians of a reconstruction; see :func:`bundle.check_jacobians`."""
    problem = as_problem(problem)
    if samples_per_image is not None:
        samples_per_image = number("samples_per_image", samples_per_image, minimum=1, whole=True)
    seed = number("seed", seed, minimum=0, maximum=math.inf, whole=True)
    tolerance = number("tolerance", tolerance, above=0)
    check_function("progress", progress)
    num_threads = number("num_threads", num_threads, minimum=0, whole=True)
    observations = _choose(problem, samples_per_image, seed)
    check = _Check(problem, resolve_cheirality(problem, cheirality), num_threads, tolerance)
    offsets = TURN * np.random.default_rng(seed).standard_normal((len(observations), 3))
    offsets[::2] = 0.0
    for begin in range(0, len(observations), CHUNK):
        chunk = slice(begin, begin + CHUNK)
        check.add(observations[chunk], offsets[chunk])
        if progress is not None:
            progress(min(begin + CHUNK, len(observations)), len(observations))
    report = check.report()
    if not details:
        return report
    return replace(report, details=check.details(observations, offsets))


_Answer = tuple[
    Array, Array, Array, Array, Array, NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]
]


class _Check:
    def __init__(
        self, problem: Problem, cheirality: str, num_threads: int, tolerance: float
    ) -> None:
        self.problem, self.tolerance = problem, tolerance
        self.cheirality, self.num_threads = cheirality, num_threads
        self.models: dict[str, ModelCheck] = {}
        self.num_checked = self.num_skipped = 0
        self.probes = np.zeros(5, np.int64)
        self.unstable: list[int] = []
        self.undecided: dict[str, list[int]] = {"camera_center": [], "rough": []}

    def add(self, observations: NDArray[np.int64], offsets: Array) -> None:
        """Check some observations."""
        answer = self._ask(self.problem, observations, offsets)
        ceres, rounding, counts, agrees, stable = answer[3:]
        close = CLOSE_UNITS * rounding > self.tolerance
        self.num_checked += int(counts.sum())
        self.num_skipped += int((~counts).sum())
        self.unstable += observations[~stable].tolist()
        wrong = np.zeros(len(observations), bool)
        cameras = self.problem.image_camera[self.problem.observation_image[observations]]
        for name in sorted({self.problem.camera_models[c] for c in np.unique(cameras)}):
            same = np.array([other == name for other in self.problem.camera_models])
            rows = np.flatnonzero(same[cameras] & counts)
            hopeless = rows[rounding[rows] > CENTER]
            rows = rows[rounding[rows] <= CENTER]
            if name not in self.models:
                rolls = self.problem.rolling_shutter is not None
                self.models[name] = ModelCheck.make(name, self.tolerance, rolls=rolls)
            model = self.models[name]
            analytic, reference, uncertainty = (
                matrix[rows][..., model.source] for matrix in answer[:3]
            )
            uncertainty = uncertainty + _rounding_errors(reference, rounding[rows])
            deviations = JacobianDeviation(analytic, reference, uncertainty, self.tolerance)
            known = (deviations.doubt <= self.tolerance).mean(axis=(1, 2)) > 0.5
            decided = (deviations.error > self.tolerance).any(axis=(1, 2)) | known
            for reason, group in (
                ("camera_center", np.append(hopeless, rows[~decided & close[rows]])),
                ("rough", rows[~decided & ~close[rows]]),
            ):
                self.undecided[reason] += np.sort(observations[group]).tolist()
            # Entries of a rough residual count as undecided; points too close to a camera do not.
            kept = np.flatnonzero(decided | ~close[rows])
            rows, deviations = rows[kept], deviations.take(kept)
            found = model.tally.add(deviations, observations[rows].astype(np.intp))
            model.look_at(observations[rows[found]], observations[rows[~found]])
            for row in rows[found]:
                model.offsets[int(observations[row])] = offsets[row]
            if not found.any() and self.tolerance <= TOLERANCE:
                names = tuple(column.name for column in model.tally.columns)
                finding = float_precision(deviations, names)
                if finding is not None and not model.findings:
                    model.findings.append(finding)
            wrong[rows] = found
        gave_up = ~np.isfinite(ceres).all(axis=(1, 2))
        self.probes += [
            counts.sum(),
            (counts & agrees).sum(),
            (counts & ~agrees & ~gave_up & ~wrong).sum(),
            (counts & gave_up).sum(),
            (counts & agrees & wrong).sum(),
        ]

    def report(self) -> GradientReport:
        """Classify the mistakes and return the report."""
        findings = [finding for model in self.models.values() for finding in self._classify(model)]
        if self.unstable:
            findings.append(
                Finding(
                    "unstable",
                    (),
                    f"{self._place(self.unstable[0])} and {len(self.unstable) - 1} more: the "
                    "residual differs between evaluations with and without Jacobians",
                )
            )
        worst = [
            self._offender(model, entry)
            for model in self.models.values()
            for entry in model.tally.worst
        ]
        return make_report(
            subject="the reprojection residual of "
            + (", ".join(sorted(self.models)) or "no camera model"),
            noun="observation",
            tallies=[model.tally for model in self.models.values()],
            findings=findings,
            worst=worst,
            num_checked=self.num_checked,
            num_skipped=self.num_skipped,
            gradient_checker=GradientCheckerSummary(*map(int, self.probes)),
            undecided=undecided_points("observation", self.undecided, self._place),
        )

    def details(self, observations: NDArray[np.int64], offsets: Array) -> tuple[CheckDetails, ...]:
        """Return, by camera model, the errors of all entries and the curves of selected ones.

        The residual along a column is computed here by :func:`bundle.project`, not by the core.
        """
        found = []
        for model in self.models.values():
            points = np.unique(model.wrong + model.right)[:MOST_DRAWN].astype(np.int64)
            if not len(points):
                continue
            turns = offsets[np.searchsorted(observations, points)]
            answer = self._ask(self.problem, points, turns)
            analytic, reference, uncertainty = (part[..., model.source] for part in answer[:3])
            uncertainty = uncertainty + _rounding_errors(reference, answer[4])
            lines = ReprojectionLines(self.problem, points, turns)
            found.append(
                make_details(
                    [column.name for column in model.tally.columns],
                    [column.group for column in model.tally.columns],
                    JacobianDeviation(analytic, reference, uncertainty, self.tolerance),
                    self.tolerance,
                    lines.line,
                    lambda k, points=points: self._place(int(points[k])),  # type: ignore[misc]
                )
            )
        return tuple(found)

    def _ask(self, problem: Problem, observations: NDArray[np.int64], offsets: Array) -> _Answer:
        return _core.check_reprojections(
            problem,
            observations,
            np.ascontiguousarray(offsets),
            self.cheirality,
            CHECKER_PRECISION,
            self.num_threads,
        )

    def _classify(self, model: ModelCheck) -> list[Finding]:
        kept = model.tally.kept
        if kept is None:
            return model.findings
        numbers = kept.points
        points = self._parameters(model, numbers)

        def reference_at(k: int, parameter: int) -> Array | None:
            column = parameter - 6
            if not 0 <= column < model.num_params:
                return None  # only camera parameters can have missing terms
            observation = np.array([numbers[k]], np.int64)
            image = self.problem.observation_image[observation[0]]
            params = self.problem.camera_params.copy()
            params[self.problem.image_camera[image], column] = 0.0
            try:
                changed = self.problem.replace(camera_params=params)
            except InputError:  # focal length of zero
                return None
            answer = self._ask(changed, observation, model.offsets[int(observation[0])][None])
            reference: Array = answer[1][0][:, model.source]
            return reference

        names = tuple(column.name for column in model.tally.columns)
        rounded = float_precision(kept.deviations, names)
        if rounded is not None:
            return [rounded]
        evidence = Evidence(
            kept.deviations,
            model.tally.columns,
            model.blocks,
            points,
            reference_at,
            model.tally.wrong_columns,
            self.tolerance,
        )
        return classify(evidence)

    def _parameters(self, model: ModelCheck, observations: NDArray[np.intp]) -> Array:
        problem = self.problem
        images = problem.observation_image[observations]
        count = model.num_params
        shutter = problem.rolling_shutter
        return np.hstack(
            [
                np.array([model.offsets[int(i)] for i in observations]),
                problem.cam_from_world[images, 4:],
                problem.camera_params[problem.image_camera[images], :count],
                *(() if shutter is None else (shutter.twist[images],)),
                problem.points[problem.observation_point[observations]],
            ]
        )

    def _offender(self, model: ModelCheck, entry: Worst) -> Offender:
        problem = self.problem
        image = int(problem.observation_image[entry.point])
        camera = int(problem.image_camera[image])
        point = int(problem.point_ids[problem.observation_point[entry.point]])
        column = model.tally.columns[entry.column].name
        camera_id = int(problem.camera_ids[camera])
        if entry.column < 6 or column.startswith("twist "):
            parameter = f"{self._image(image)} {column}"
        elif column.startswith("point "):
            parameter = f"point {point} {column.removeprefix('point ')}"
        else:
            parameter = f"camera {camera_id} {column.removeprefix(model.name + ' ')}"
        return Offender(
            self._place(entry.point),
            parameter,
            entry.residual,
            entry.analytic,
            entry.reference,
            entry.error,
            {
                "observation": entry.point,
                "image_id": int(problem.image_ids[image]),
                "image_name": problem.image_names[image],
                "camera_id": camera_id,
                "model": model.name,
                "point_id": point,
            },
        )

    def _place(self, observation: int) -> str:
        image = int(self.problem.observation_image[observation])
        point = int(self.problem.point_ids[self.problem.observation_point[observation]])
        return f"{self._image(image)}, point {point}"

    def _image(self, image: int) -> str:
        return f"image {self.problem.image_names[image] or self.problem.image_ids[image]}"


def _rounding_errors(jacobians: Array, rounding: Array) -> Array:
    """Return the rounding errors of the entries (K, 2, N) of Jacobians.

    Derivatives w.r.t. rotation, translation and point are sums that may cancel. Their error is
    therefore relative to the largest column of the same kind.

    ``jacobians``: (K, 2, N) Jacobians. ``rounding``: (K,) relative rounding error of the
    derivatives w.r.t. the point in the camera.
    """
    size = np.linalg.norm(jacobians, axis=1, keepdims=True)
    for kind in (slice(0, 3), slice(3, 6), slice(-3, None)):
        size[..., kind] = size[..., kind].max(axis=-1, keepdims=True)
    errors: Array = ROUNDING_UNITS * rounding[:, None, None] * size
    return errors


def _choose(problem: Problem, samples_per_image: int | None, seed: int) -> NDArray[np.int64]:
    """Return the observations to check, ascending."""
    count = problem.num_observations
    if samples_per_image is None:
        return np.arange(count, dtype=np.int64)
    shuffled = np.random.default_rng(seed).permutation(count)
    by_image = shuffled[np.argsort(problem.observation_image[shuffled], kind="stable")]
    images = np.split(by_image, np.flatnonzero(np.diff(problem.observation_image[by_image])) + 1)
    return np.sort(np.concatenate([image[:samples_per_image] for image in images]))


# Residuals of observations at steps along a column of their Jacobian, by `bundle.project`.
#
# The columns are those of the core's check: a rotation vector w near w0 with the rotation Exp(w)
# Exp(-w0) R, the translation, the camera's parameters, the twist if shutters roll, the point.


@dataclass(frozen=True, eq=False)
class ReprojectionLines:
    """Observations of a problem, each turned by a rotation vector."""

    problem: Problem
    observations: NDArray[np.int64]
    offsets: Array

    def line(self, k: int, column: int) -> Line:
        """Return the residuals of observation k along a column."""
        problem, observation = self.problem, int(self.observations[k])
        image = int(problem.observation_image[observation])
        camera = int(problem.image_camera[image])
        model = problem.camera_models[camera]
        num_params = len(camera_models()[model])
        pose = problem.cam_from_world[image]
        back = rotation_matrices(quaternion_from_vector(-self.offsets[k][None]))[0]
        rotation = back @ rotation_matrices(pose[None, :4])[0]
        start = np.concatenate([
            self.offsets[k],
            pose[4:],
            problem.camera_params[camera, :num_params],
            problem.points[problem.observation_point[observation]],
        ])  # fmt: skip
        measured = problem.observation_xy[observation]
        shutter = problem.rolling_shutter
        if shutter is not None:
            start = np.concatenate([start[:-3], shutter.twist[image], start[-3:]])
            alone = problem.select(images=[image], observations=[observation]).problem

        def rolling(moved: Array) -> Array | None:
            """Return the core's residual, whose row depends on the point."""
            turn = rotation_matrices(quaternion_from_vector(moved[None, :3]))[0] @ rotation
            params, points = alone.camera_params.copy(), alone.points.copy()
            params[alone.image_camera[0], :num_params] = moved[6 : 6 + num_params]
            points[alone.observation_point[0]] = moved[-3:]
            assert alone.rolling_shutter is not None
            there = alone.replace(
                cam_from_world=np.hstack([quaternion_from_matrix(turn[None])[0], moved[3:6]])[None],
                camera_params=params,
                points=points,
                rolling_shutter=alone.rolling_shutter.replace(twist=moved[None, -9:-3]),
            )
            found = _core.reprojection_residuals(there, 1, "algebraic")[0][0]
            return found if np.isfinite(found).all() else None

        def values(step: float) -> Array | None:
            moved = start.copy()
            moved[column] += step
            if shutter is not None:
                return rolling(moved)
            turn = rotation_matrices(quaternion_from_vector(moved[None, :3]))[0]
            seen = turn @ rotation @ moved[-3:] + moved[3:6]
            pixels, _ = project(model, moved[6:-3], seen[None])
            found: Array = pixels[0] - measured
            return found if np.isfinite(found).all() else None

        center = values(0.0)
        return walk(values, np.full(2, np.nan) if center is None else center, start[column])


POSE = tuple(f"{part} {axis}" for part in ("rotation", "translation") for axis in "xyz")
TWIST = tuple(f"twist {part}{axis}" for part in "wv" for axis in "xyz")
POINT = ("point x", "point y", "point z")


@dataclass(eq=False)
class ModelCheck:
    """Check of the observations of one camera model."""

    name: str  # COLMAP's name of the model
    source: NDArray[np.intp]  # columns of the core's Jacobian that belong to this model
    tally: Tally  # statistics of its Jacobians
    offsets: dict[int, Array] = field(default_factory=dict)  # rotation vector by observation
    num_params: int = 0  # number of the model's parameters
    findings: list[Finding] = field(default_factory=list)  # mistakes found so far
    wrong: list[int] = field(default_factory=list)  # observations with a mistake, at most MOST_KEPT
    right: list[int] = field(default_factory=list)  # the same without a mistake

    @staticmethod
    def make(name: str, tolerance: float, *, rolls: bool = False) -> ModelCheck:
        """Return an empty check with columns of a camera model, and of twists if shutters roll."""
        params = camera_models()[name]
        columns = [Column(text, text.partition(" ")[0]) for text in POSE]
        columns += [
            Column(f"{name} {param}", kind.replace("_", " "))
            for param, kind in zip(params, param_kinds(name), strict=True)
        ]
        after = [Column(text, "twist") for text in TWIST if rolls]
        after += [Column(text, "point") for text in POINT]
        source = np.arange(len(columns) + len(after))
        source[len(columns) :] = np.arange(-len(after), 0)  # after columns of other models
        check = ModelCheck(name, source, Tally(columns + after, tolerance))
        check.num_params = len(params)
        return check

    def look_at(self, wrong: NDArray[np.int64], right: NDArray[np.int64]) -> None:
        """Keep some observations for a page."""
        for kept, new in ((self.wrong, wrong), (self.right, right)):
            kept += new[: max(MOST_KEPT - len(kept), 0)].tolist()

    @property
    def blocks(self) -> list[Block]:
        """Blocks of columns for the signatures."""
        size = len(self.tally.columns)
        return [
            Block("rotation", 0, 3, "vector"),
            Block("rotation", 0, 3, "tangent"),
            Block("translation", 3, 6),
            Block("pose", 0, 6),
            Block(f"{self.name} parameters", 6, 6 + self.num_params),
            *([Block("twist", size - 9, size - 3)] if size > 9 + self.num_params else []),
            Block("point", size - 3, size),
        ]
