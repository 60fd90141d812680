"""Preparation of a solve: from the request to the arguments of the core, and back to the result.

First, the problem is moved to its priors. Then the rules are resolved, and the subset to refine is
selected. Factors and bounds are laid out last, for the values of the start, when they are first
needed. A run of rounds makes a new layout for each round. It rejects the checkpoint of another run
before the first layout.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Set
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.interface.options import SolveOptions
from bundle.interface.ordering_alarm import BestOrder, with_ordering_alarm
from bundle.interface.solve_record import Progress, record_fields, with_warnings
from bundle.model.estimates import with_estimates
from bundle.model.problem import Problem
from bundle.model.rolling_shutter import refuse
from bundle.model.unobserved import are_images_unrelated
from bundle.solving.kept_errors import Edit
from bundle.solving.layout import Layout, lay_out
from bundle.solving.parameter_changes import known_readouts, weak_baseline
from bundle.solving.request import Bounds, PartRequest, PlacedProblem, SolveRequest, place_at_priors
from bundle.solving.result import Result

if TYPE_CHECKING:
    from bundle.graphs.factors.factors import Factor
    from bundle.solving.constraints.ends import Applied, RuleEnd
    from bundle.solving.request import Rules
    from bundle.solving.rounds.local_part import LocalPart
    from bundle.solving.rounds.plan import State
    from bundle.solving.rounds.rest_prior import RestPrior


@dataclass(frozen=True, eq=False, kw_only=True)
class Prepared:
    """A request that is ready to run."""

    request: SolveRequest  # the request as the caller made it
    # the problem in the frame of its priors, with their factors and control points
    placed: PlacedProblem
    before: Problem  # the problem with which the result is compared
    start: Problem  # the input of the solver: `before` with shared parameters made equal
    # options for the start, including its fixed ids; defaults are not resolved
    options: SolveOptions
    factors: tuple[Factor, ...]  # factors on the start, without those of rules
    bounds: Bounds | None  # bounds of the cameras of the start
    applied: Applied | None  # the resolved rules; None without any
    # the refined images and the points that they see; None: the entire problem
    part: LocalPart | None = None
    # marginal prior of the remaining problem; None if the remaining problem is constant
    rest: RestPrior | None = None

    @cached_property
    def layout(self) -> Layout:
        """Factors, restrictions and options for the values of the start."""
        return lay_out(self.start, self.options, self.factors, self.bounds, self.applied)

    def at(self, problem: Problem, options: SolveOptions | None = None) -> Prepared:
        """Return a copy for another start: rules stay resolved, indices are computed again."""
        options = self.options if options is None else options
        return dataclasses.replace(self, before=problem, start=problem, options=options)

    def laid_out_at(self, problem: Problem, options: SolveOptions) -> Prepared:
        """Return a copy for other values that reuses this layout."""
        moved = dataclasses.replace(self, before=problem, start=problem)
        vars(moved)["layout"] = self.layout._replace(options=options)
        return moved

    def result(self, output: Mapping[str, Any]) -> Result:
        """Return the output of an executor as a result of the start, with all warnings."""
        options, known, limits = self.layout
        before = self.before
        values, outside = known_readouts(before, output)
        warnings = {"one_process": output.get("alone", ""), "readout_outside": outside}
        refined = with_estimates(before, values)
        if known is not None and options.check_solution:
            from bundle.graphs.factors.problem_factors import wrong_factor  # slow to import

            warnings["wrong_factor"] = wrong_factor(self.start, known.factors, output)
        warnings["weak_baseline"] = weak_baseline(options, before, refined, output["summary"])
        if known is None and limits is None and self.applied is None and self.part is None:
            warnings["no_tracks"] = _without_tracks(before, options)
        fields = with_warnings(output["summary"], warnings)
        fields["is_solution_usable"] &= not warnings.get("no_tracks")
        if options.check_solution:
            fields = with_model_alarm(fields, before, options)
        output = {**output, "summary": fields}
        return Result(
            problem=refined,
            initial_problem=before,
            options=options,
            factor_costs_before=output["factor_costs_before"],
            factor_costs_after=output["factor_costs_after"],
            active_bounds=() if limits is None else limits.active(refined),
            constraints=rule_ends(self.applied, before, refined),
            **record_fields(output),
        )

    def finished(self, result: Result, state: State | None = None) -> Result:
        """Convert the last result for the start to a result for the problem of the request.

        ``state``: state of the run before this result; None: nothing was filtered.
        """
        last, given, placed = result.problem, self.request.problem, self.placed
        ends = rule_ends(self.applied, placed.problem, last)
        if self.part is not None:
            record = self.part.record
            if self.rest is not None:
                from bundle.solving.rounds.rest_prior import without_prior

                result, record = without_prior(result, record, self.rest)
            return dataclasses.replace(
                result,
                problem=self.part.merge(last, state),
                initial_problem=given,
                options=_as_asked(result.options, self.request.options),
                constraints=ends,
                part=record,
                observation_mask=self.part.observation_mask(state),
                factors=self.request.factors,
                priors=self.request.priors,
            )
        refined = placed.taken_from(last)
        mask = None if state is None else state.observation_mask[: given.num_observations]
        return dataclasses.replace(
            result,
            problem=refined,
            initial_problem=given,
            constraints=ends,
            similarity=placed.similarity,
            control_points=placed.control_points(refined),
            edits=self.edits(),
            observation_mask=None if mask is None or mask.all() else mask,
            factors=self.request.factors,
            priors=self.request.priors,
        )

    def edits(self) -> tuple[Edit, ...]:
        """Return the changes of the entire problem before the solve."""
        last, edits, placed = self.request.problem, [], self.placed
        if placed.similarity is not None:
            edits.append(Edit("alignment", last, placed.taken_from(placed.problem)))
            last = edits[-1].after
        if self.start is not self.before:
            edits.append(Edit("rules", last, placed.taken_from(self.start)))
        return tuple(edits)


class Executor(Protocol):
    """A way to run the core's solver."""

    def run(self, prepared: Prepared, progress: Progress | None) -> dict[str, Any]:
        """Return the output of the core.

        ``alone`` in it is the reason why only one of several processes ran the solver.
        """


def prepare(request: SolveRequest) -> Prepared:
    """Move a problem to its priors, resolve the rules, and select the subset to refine."""
    part, align = request.part, request.align
    if part is not None:
        if align:
            raise InputError(
                "align: not valid with only_images, which leaves all other images in place"
            )
        align = False
    placed = place_at_priors(request.problem, request.factors, request.priors, align)
    local = None if part is None else _local_part(request.problem, part, placed)
    start, options, applied = _resolve_rules(
        placed.problem,
        request.options,
        request.constraints,
        None if local is None else local.refined_ids,
    )
    whole = Prepared(
        request=request,
        placed=placed,
        before=placed.problem,
        start=start,
        options=options,
        factors=placed.factors,
        bounds=request.bounds,
        applied=applied,
    )
    return whole if local is None else _within(local, whole)


def _resolve_rules(
    problem: Problem, options: SolveOptions, rules: Rules, part: Mapping[str, Set[int]] | None
) -> tuple[Problem, SolveOptions, Applied | None]:
    """Return the start, the options, and the resolved rules (None without rules).

    ``part``: ids of the refined cameras, images and points; None: all.
    """
    if isinstance(rules, tuple | list) and not rules:
        return problem, options, None
    from bundle.solving.constraints.ends import Applied  # not imported without rules

    if isinstance(rules, Applied):  # resolved by the caller
        return problem, options, rules
    from bundle.solving.constraints.resolve import apply

    start, applied = apply(rules, problem, options, part)
    if applied is not None and applied.fixed_point_ids:
        held = (*options.fixed_point_ids, *applied.fixed_point_ids)
        options = options.replace(fixed_point_ids=held)
    return start, options, applied


def _local_part(problem: Problem, part: PartRequest, placed: PlacedProblem) -> LocalPart:
    from bundle.model.problem_keys import find_images
    from bundle.solving.rounds.local_part import LocalPart  # imported with only_images only

    if placed.control_point_ids:
        raise InputError(
            "priors: control points are not valid with only_images, which leaves all other images "
            "in place"
        )
    images = find_images("only_images", problem, part.images)
    return LocalPart(problem, images, placed.factors, marginal=part.rest == "marginal")


def _within(part: LocalPart, whole: Prepared) -> Prepared:
    """Restrict a prepared solve to a subset; the remaining problem is constant or marginalized."""
    given, options, applied = whole.request.problem, whole.options, whole.applied
    if whole.start is not given:
        part = part.of(whole.start)
    part.check_observed()
    factors, rest = part.factors, None
    if part.is_marginal:
        from bundle.solving.rounds.rest_prior import marginalize_rest  # for this rest only

        refuse(given, given.rolling_shutter, "rest: marginal")
        if applied is not None:
            raise InputError("rest: expected fixed with constraints, found marginal")
        rest = marginalize_rest(given, part, options, whole.bounds)
        options = options.replace(gauge="none") if rest.holds_gauge else options
        factors += () if rest.factor is None else (rest.factor,)
    return dataclasses.replace(
        whole,
        before=part.problem,
        start=part.problem,
        options=part.options(options),
        factors=factors,
        bounds=part.bounds(whole.bounds),
        applied=None if applied is None else applied.restricted(part.problem),
        part=part,
        rest=rest,
    )


def _without_tracks(problem: Problem, options: SolveOptions) -> str:
    """Return a warning if no point connects two images; "" otherwise."""
    if not are_images_unrelated(problem, options):
        return ""
    return (
        "No point is observed twice, so nothing relates the images: residuals vanish wherever the "
        "cameras are, and the result is not a reconstruction."
    )


def rule_ends(applied: Applied | None, before: Problem, after: Problem) -> tuple[RuleEnd, ...]:
    """Return the outcome of each rule; see :func:`bundle.solving.constraints.ends.rule_ends`."""
    if applied is None or not applied.rules:
        return ()
    from bundle.solving.constraints import ends

    return ends.rule_ends(applied, before, after)


def _as_asked(used: SolveOptions, asked: SolveOptions) -> SolveOptions:
    """Return the used options without the ids that only the local adjustment made constant."""
    return used.replace(
        fixed_image_ids=asked.fixed_image_ids,
        fixed_camera_ids=asked.fixed_camera_ids,
        fixed_point_ids=asked.fixed_point_ids,
        refine_sensor_from_rig=asked.refine_sensor_from_rig,
        fixed_sensors=asked.fixed_sensors,
    )


# Alarm of a solve of a model that eliminates the cameras first.
#
# The points' system after eliminating the cameras couples all points of an image. The 3 k
# coordinates of the k points of an image form a clique, whose elimination needs the sum of c^2 + 3
# c for c below 3 k in every order, about (3 k)^3 / 3. Ceres is ignored the flops of this
# system: the bound of the largest image replaces them. The other order, points first, is counted
# exactly.

ADVICE = "Leave --ordering (linear_solver_ordering) at points-first."


def with_model_alarm(
    summary: Mapping[str, Any], problem: Problem, options: SolveOptions
) -> dict[str, Any]:
    """Return the fields of a summary, with a warning if eliminating points first is far cheaper."""
    is_asked = options.linear_solver_ordering == "cameras_first" and "points" in options.refine
    direct = ("DENSE_SCHUR", "SPARSE_SCHUR", "SPARSE_NORMAL_CHOLESKY")
    is_direct = summary["linear_solver_type_used"] in direct
    look = (lambda: _look(summary, problem, options)) if is_asked and is_direct else None
    return with_ordering_alarm(
        summary,
        lambda: (problem.observation_image, problem.observation_point),
        look,
        ADVICE if look is not None else "",
    )


def _look(summary: Mapping[str, Any], problem: Problem, options: SolveOptions) -> BestOrder:
    points_first = options.replace(linear_solver_ordering="points_first").asdict()
    if summary["linear_solver_type_used"] == "SPARSE_NORMAL_CHOLESKY":
        pattern, order, _ = _core.ordered_full_pattern(
            problem, points_first, _core.MOST_ENTRIES_FOR_AMD
        )
    else:
        pattern = _core.reduced_pattern(problem, points_first)
        order = _core.order_blocks(*pattern, "amd")
    counts = _core.count_factor(*pattern, order)
    return BestOrder(
        ordering="points first, amd",
        flops=counts["flops"],
        nonzeros=counts["entries"],
        used_flops=0.0 if summary["factor_flops"] else _least_flops(problem, options),
    )


def _least_flops(problem: Problem, options: SolveOptions) -> float:
    """Return the flops of the clique of the image with most free points."""
    free = ~np.isin(problem.point_ids, np.array(options.fixed_point_ids, np.int64))
    seen = problem.observation_image[free[problem.observation_point]]
    if not len(seen):
        return 0.0
    c = 3.0 * float(np.bincount(seen).max()) - 1
    return c * (c + 1) * (2 * c + 1) / 6 + 1.5 * c * (c + 1)
