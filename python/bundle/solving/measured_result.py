"""Measured result of a solve: its fields, and the statistics computed from them on demand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.interface.round_options import RoundRecords
from bundle.interface.solve_record import SolveRecord
from bundle.model.cameras import param_kinds
from bundle.model.problem import Problem
from bundle.model.residuals import (
    ImageError,
    ReprojectionError,
    quantiles,
    reprojection_error,
    worst_images,
    worst_of_errors,
)
from bundle.model.rigid_motions import rotation_matrices
from bundle.solving.kept_errors import (
    Deleted,
    Edit,
    KeptErrors,
    Measured,
    PixelErrors,
    measure,
    outlier_limit,
)

if TYPE_CHECKING:
    from bundle.georeference.alignment_result import ControlPointError
    from bundle.georeference.measurements import Prior
    from bundle.georeference.point_check import SurveyChecks
    from bundle.georeference.similarity import Similarity
    from bundle.graphs.factors.factors import Factor
    from bundle.model.residuals import HeldOut
    from bundle.solving.constraints.ends import RuleEnd
    from bundle.solving.constraints.restrictions import ActiveBound
    from bundle.solving.gauge_freedom import GaugeFreedom


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class MeasuredResult(RoundRecords, SolveRecord):  # the first table: iterations
    """Fields and statistics of :class:`bundle.Result`, which describes them."""

    problem: Problem
    initial_problem: Problem
    factor_costs_before: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    factor_costs_after: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    active_bounds: tuple[ActiveBound, ...] = ()
    constraints: tuple[RuleEnd, ...] = ()
    similarity: Similarity | None = None
    control_points: tuple[ControlPointError, ...] = ()
    part: PartRecord | None = None
    held_out: HeldOut | None = None
    edits: tuple[Edit, ...] = ()
    observation_rows: NDArray[np.intp] | None = None
    factors: tuple[Factor, ...] = ()
    priors: tuple[Prior, ...] = ()
    _survey: Callable[[], SurveyChecks | None] | None = field(default=None, repr=False)
    _free: Callable[[], Problem | None] | None = field(default=None, repr=False)

    @cached_property
    def survey_checks(self) -> SurveyChecks | None:
        """Tests of control points and of an offset of positions, computed at the first access.

        None without control points, or if the solve did not converge.
        """
        return None if self._survey is None else self._survey()

    @cached_property
    def without_attitudes(self) -> Problem | None:
        """The model of a solve without measured attitudes, computed at the first access.

        None without attitudes, or if the solve did not converge.
        """
        return None if self._free is None else self._free()

    def __getstate__(self) -> dict[str, Any]:
        # Factors may be functions that do not pickle; the outcome of the tests does.
        self.survey_checks, self.without_attitudes  # noqa: B018
        if self.factors or self.priors:
            self.gauge_freedom  # noqa: B018
        return vars(self) | {"_survey": None, "_free": None, "factors": (), "priors": ()}

    @property
    def source_problem(self) -> Problem:
        """The input before all edits."""
        return self.edits[0].before if self.edits else self.initial_problem

    @cached_property
    def reprojection_error_before(self) -> ReprojectionError:
        """Statistics in pixels at the input before all edits, computed at the first access."""
        return self._measure(self.source_problem)

    @cached_property
    def reprojection_error_after(self) -> ReprojectionError:
        """Statistics in pixels at the output, computed at the first access."""
        return self._measure(self.problem)

    @cached_property
    def kept(self) -> KeptErrors:
        """Errors before and after on the observations in the output, computed at first access."""
        self.measure()
        kept: KeptErrors = vars(self)["kept"]
        return kept

    @cached_property
    def edit_errors(self) -> tuple[tuple[str, ReprojectionError, ReprojectionError], ...]:
        """Names of the edits, and errors of all observations before and after each."""
        found: dict[int, ReprojectionError] = {
            id(self.source_problem): self.reprojection_error_before
        }
        for edit in self.edits:
            for problem in (edit.before, edit.after):
                if id(problem) not in found:
                    found[id(problem)] = self._measure(problem)
        return tuple((one.edit, found[id(one.before)], found[id(one.after)]) for one in self.edits)

    @cached_property
    def deleted(self) -> Deleted:
        """Numbers of deleted observations, points and images."""
        if self.observation_rows is not None:
            return Deleted.of_mask(self.initial_problem, self.observation_mask)
        return Deleted.of(self.initial_problem, self.problem)

    @cached_property
    def movement(self) -> Movement:
        """Movement of images and lenses from the input to the output."""
        return movement(self.source_problem, self.problem, self.similarity)

    @cached_property
    def rmse_global_shutters(self) -> float:
        """RMSE in pixels of the edited input, computed as if all shutters were global."""
        return self._measure(self.initial_problem.replace(rolling_shutter=None)).rmse

    @cached_property
    def worst_images(self) -> tuple[ImageError, ...]:
        """Images with the largest errors at the output, computed at the first access."""
        options = self.options
        return worst_images(self.problem, options.cheirality, num_threads=options.num_threads)

    @cached_property
    def gauge_freedom(self) -> GaugeFreedom:
        """Degrees of freedom that all but damping leaves free at the input."""
        from bundle.solving.gauge_freedom import gauge_freedom  # imports the readers of files

        return gauge_freedom(
            self.initial_problem, self.options, factors=self.factors, priors=self.priors,
            constraints=[end.rule for end in self.constraints],
        )  # fmt: skip

    @property
    def work(self) -> str:
        """Numbers of rounds and of steps in all of them, such as "2 rounds, 31 steps"."""
        return self._work(self.num_steps)

    def without_last_points(self, count: int) -> Self:
        """Return the result without the last `count` points, which were added to the input."""
        problem, left = self.problem, self.problem.num_points - count
        points, ids = problem.points[:left], problem.point_ids[:left]
        return replace(
            self._counted_without(count), problem=problem.replace(points=points, point_ids=ids)
        )

    def measure(self) -> None:
        """Measure all statistics now; later access takes no time.

        The errors of all observations are computed once before and once after, and not stored.
        """
        names = {"reprojection_error_before", "reprojection_error_after", "worst_images", "kept"}
        values = vars(self)  # storage of cached_property; the dataclass itself is frozen
        if names <= values.keys():
            return
        options, source = self.options, self.source_problem
        before, after = (
            PixelErrors.of(problem, options.cheirality, options.num_threads)
            for problem in (source, self.problem)
        )
        values["worst_images"] = worst_of_errors(self.problem, *after)
        limit = outlier_limit(source, options)
        self.measured(
            measure(before, after, self.observation_mask, limit, rows=self.observation_rows)
        )

    def measured(self, found: Measured | None) -> None:
        """Store statistics that the processes of a solve found together."""
        if found is not None:
            vars(self).update(
                reprojection_error_before=found.before,
                reprojection_error_after=found.after,
                kept=found.kept,
            )

    def _measure(self, problem: Problem) -> ReprojectionError:
        options = self.options
        return reprojection_error(problem, options.cheirality, num_threads=options.num_threads)


# Movement of camera positions and lenses from the input to the output of a solve.
#
# Positions are compared in the frame of the output: if the input was moved to its priors by a
# similarity, the similarity moves its positions, too. The size of the scene is twice the median
# distance of the points from their median, or of the camera positions from theirs if that is
# larger. A few far points do not change it.

MOST_POINTS = 100_000
"""Number of points, taken at equal steps, from which the size of a scene is computed."""


@dataclass(frozen=True, kw_only=True)
class Movement:
    """Changes of images and lenses. All medians are nan if nothing changed.

    Attributes:
        num_images: number of images whose pose changed.
        position: median distance by which the positions of these images moved, in length units of
            the output.
        largest_position: the largest distance.
        rotation: median angle by which these images turned, in degrees.
        scene_size: size of the scene in the same length unit.
        num_cameras: number of cameras whose parameters changed.
        focal: median relative change of the focal length |f / f0 - 1| over the images of these
            cameras; 0 if their focal lengths did not change.
    """

    num_images: int
    position: float
    largest_position: float
    rotation: float
    scene_size: float
    num_cameras: int
    focal: float


def movement(before: Problem, after: Problem, similarity: Similarity | None = None) -> Movement:
    """Return the changes between two problems with the same images in the same order.

    ``before``: the input, which may have other cameras. ``similarity``: motion of the input to its
    priors, or None.
    """
    centers, turns = before.projection_centers, rotation_matrices(before.cam_from_world[:, :4])
    moved = (before.cam_from_world != after.cam_from_world).any(axis=1)
    if similarity is not None:
        centers, turns = similarity.apply(centers), turns @ similarity.rotation.T
        moved[:] = True
    distances = np.linalg.norm(after.projection_centers[moved] - centers[moved], axis=1)
    # The Frobenius norm of the difference of two rotations is sqrt(8) sin(angle / 2).
    turned = rotation_matrices(after.cam_from_world[moved, :4]) - turns[moved]
    half = np.clip(np.linalg.norm(turned, axis=(1, 2)) / np.sqrt(8), 0, 1)
    num_cameras, focal = _lenses(before, after)
    return Movement(
        num_images=int(moved.sum()),
        largest_position=float(distances.max()) if len(distances) else float("nan"),
        position=_median(distances),
        rotation=_median(np.degrees(2 * np.arcsin(half))),
        scene_size=max(_size(after.points), _size(after.projection_centers)),
        num_cameras=num_cameras,
        focal=focal,
    )


def _lenses(before: Problem, after: Problem) -> tuple[int, float]:
    """Return the number of changed cameras, and the median change of their focal lengths."""
    first, last = before.image_camera, after.image_camera
    width = max(before.camera_params.shape[1], after.camera_params.shape[1])
    params = [_widened(one.camera_params, width) for one in (before, after)]
    models = [np.array(one.camera_models) for one in (before, after)]
    changed = (params[0][first] != params[1][last]).any(axis=1)
    changed |= models[0][first] != models[1][last]
    ratios = np.abs(_focals(after)[last] / _focals(before)[first] - 1)[changed]
    cameras = np.count_nonzero(np.bincount(last[changed]))
    return int(cameras), _median(ratios[np.isfinite(ratios)])


def _widened(params: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    return np.pad(params, ((0, 0), (0, width - params.shape[1])))


def _focals(problem: Problem) -> NDArray[np.float64]:
    """Return the mean focal length of each camera; nan for a model without any."""
    focals = np.full(problem.num_cameras, np.nan)
    models = np.array(problem.camera_models)
    for model in set(problem.camera_models):
        columns = [k for k, kind in enumerate(param_kinds(model)) if kind == "focal"]
        if columns:
            of_model = models == model
            focals[of_model] = np.abs(problem.camera_params[of_model][:, columns]).mean(axis=1)
    return focals


def _size(points: NDArray[np.float64]) -> float:
    if not len(points):
        return 0.0
    some = points[:: -(-len(points) // MOST_POINTS)]
    center = np.array([_median(coordinate.copy()) for coordinate in some.T])
    return 2 * _median(np.linalg.norm(some - center, axis=1))


def _median(values: NDArray[np.float64]) -> float:
    """Return the median; nan without values, which are reordered."""
    return quantiles(values, [0.5])[0] if len(values) else float("nan")


@dataclass(frozen=True, kw_only=True)
class RestRecord:
    """Marginalized remainder of a problem in a local adjustment, and its prior.

    Attributes:
        num_images: number of eliminated images, without the neighbours of the part.
        num_points: number of eliminated points.
        num_points_without_parallax: number of these points that have an unobserved direction, which
            was left out.
        prior_size: number of unknowns of the prior: poses of neighbours and parameters of cameras.
            0: no prior, because the remainder has no information on the part.
        prior_rank: rank of the prior's information matrix, including the fixed gauge.
        prior_bytes: size of this matrix in bytes.
        gauge_degrees: gauge freedom, which is fixed by keeping the neighbours in place on average.
        cost_before: cost of the prior at the start, above its minimum.
        cost_after: cost of the prior at the end, above its minimum.
    """

    num_images: int
    num_points: int
    num_points_without_parallax: int
    prior_size: int
    prior_rank: int
    prior_bytes: int
    gauge_degrees: int
    cost_before: float = 0.0
    cost_after: float = 0.0


@dataclass(frozen=True, kw_only=True)
class PartRecord:
    """Part of a problem that takes part in a local adjustment.

    Attributes:
        num_images: number of refined images.
        num_images_held: number of other images that see a point of the refined images. They are
            constant, or constrained by the marginal prior.
        num_points: number of points that a refined image sees; all are refined.
        num_observations: number of observations of these points.
        shared_camera_ids: cameras of both refined and other images. If their intrinsics are
            refined, projections into constant images change.
        num_sensors: number of sensors on rigs of which all images are refined; the solve may move
            these alone.
        rest: the marginalized remainder; None if it was constant.
    """

    num_images: int
    num_images_held: int
    num_points: int
    num_observations: int
    shared_camera_ids: tuple[int, ...]
    num_sensors: int = 0
    rest: RestRecord | None = None
