"""Measured result of a solve: its fields, and the statistics computed from them on demand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.interface.solve_record import SolveRecord
from bundle.model.problem import Problem
from bundle.model.reprojection import ReprojectionError, reprojection_error
from bundle.model.worst_images import ImageError, worst_images, worst_of_errors
from bundle.solving.gauge_freedom import GaugeFreedom, gauge_freedom
from bundle.solving.kept_errors import (
    Deleted,
    Edit,
    KeptErrors,
    Measured,
    PixelErrors,
    measure,
    outlier_limit,
)
from bundle.solving.movement import Movement, movement

if TYPE_CHECKING:
    from bundle.georeference.alignment_result import ControlPointError
    from bundle.georeference.point_check import SurveyChecks
    from bundle.georeference.similarity import Similarity
    from bundle.graphs.factors.factors import Factor
    from bundle.model.clipped_errors import HeldOut
    from bundle.solving.constraints.camera_bounds import ActiveBound
    from bundle.solving.constraints.constraint_record import RuleEnd
    from bundle.solving.placed_problem import Prior
    from bundle.solving.round_record import PartRecord, Round


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class MeasuredResult(SolveRecord):
    """Fields and statistics of :class:`bundle.Result`, which describes them."""

    problem: Problem
    initial_problem: Problem
    factor_costs_before: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    factor_costs_after: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    active_bounds: tuple[ActiveBound, ...] = ()
    constraints: tuple[RuleEnd, ...] = ()
    similarity: Similarity | None = None
    control_points: tuple[ControlPointError, ...] = ()
    rounds: tuple[Round, ...] = ()
    part: PartRecord | None = None
    held_out: HeldOut | None = None
    edits: tuple[Edit, ...] = ()
    observation_mask: NDArray[np.bool_] | None = None
    factors: tuple[Factor, ...] = ()
    priors: tuple[Prior, ...] = ()
    _survey: Callable[[], SurveyChecks] | None = field(default=None, repr=False)
    _free: Callable[[], Problem | None] | None = field(default=None, repr=False)

    @cached_property
    def survey_checks(self) -> SurveyChecks | None:
        """Tests of control points and of an offset of positions, computed at the first access.

        None without control points, and of a solve that did not converge.
        """
        return None if self._survey is None else self._survey()

    @cached_property
    def without_attitudes(self) -> Problem | None:
        """The model as all but measured attitudes determine it, computed at the first access.

        None without attitudes, and of a solve that did not converge.
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
        return Deleted.of(self.initial_problem, self.problem)

    @cached_property
    def movement(self) -> Movement:
        """Movement of images and lenses from the input to the output."""
        return movement(self.source_problem, self.problem, self.similarity)

    @cached_property
    def rmse_global_shutters(self) -> float:
        """RMSE in pixels at the input, after all edits, if all shutters were global."""
        return self._measure(self.initial_problem.replace(rolling_shutter=None)).rmse

    @cached_property
    def worst_images(self) -> tuple[ImageError, ...]:
        """Images with the largest errors at the output, computed at the first access."""
        options = self.options
        return worst_images(self.problem, options.cheirality, num_threads=options.num_threads)

    @cached_property
    def gauge_freedom(self) -> GaugeFreedom:
        """Degrees of freedom that observations, factors and priors leave free at the input."""
        return gauge_freedom(
            self.initial_problem, self.options, factors=self.factors, priors=self.priors
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
        self.measured(measure(before, after, self.observation_mask, outlier_limit(source, options)))

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
