"""``bundle.covariance`` of every kind of input, and its computation for a reconstruction.

Distant points dominate the gauge under inner constraints. The constraints require N^T x = 0 over
all unknowns x, with N the changes by moving, rotating and scaling the world
(core/covariance/free_gauge.h). For a point at a distance d from the centre, the rows of N for
rotation and scale are about d, and their weight is d^2. A point a thousand scene sizes away has the
weight of a million points. If a few such points outweigh all others together, poses are as
uncertain as the direction of these points. This follows from the definition, but users rarely want
it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

import bundle._core as _core
from bundle.analysis.uncertainty.covariance_result import Covariance, rows_of
from bundle.base.arrays import freeze
from bundle.base.records import dataclass
from bundle.base.words import named, not_converged, noun, plural
from bundle.errors import InputError
from bundle.interface.analysis_options import GAUGES, PARTS, ROBUST, SCALES, parts_of
from bundle.interface.option_class import takes_options
from bundle.interface.option_fields import choice
from bundle.interface.options import SolveOptions
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.io.files import Source, as_problem
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.problem import Problem
from bundle.solving.executors import ThisProcess, solve_prepared
from bundle.solving.prepare import Prepared, prepare
from bundle.solving.request import SolveRequest
from bundle.solving.result import Result

if TYPE_CHECKING:
    from bundle.analysis.uncertainty.graph_covariance import FactorGraphCovariance
    from bundle.georeference.measurements import Prior
    from bundle.graphs.factors.factor_graph import FactorGraph
    from bundle.graphs.factors.factors import Factor
    from bundle.graphs.factors.variables import Key
    from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
    from bundle.interface.option_keywords import PoseGraphKeywords
    from bundle.solving.constraints.rule_list import Constraints
    from bundle.solving.constraints.rules import Rule
    from bundle.solving.request import Rules

AT_MINIMUM = 1e-4
"""Relative decrease of the cost by one more step, below which a state counts as a minimum."""


def intrinsics_covariance(
    problem: Problem, options: SolveOptions, constraints: Rules = ()
) -> Covariance:
    """Return the covariance of the intrinsics, scaled by sigma0, as :func:`covariance` does.

    Sums are in doubles, also for small models: ten times faster than long doubles, with fewer
    digits.
    """
    gauge = "two_cameras"  # intrinsics do not depend on it
    request = SolveRequest(
        problem=problem, options=options.replace(gauge=gauge), constraints=constraints
    )
    recipe = Recipe(request, ("intrinsics",), gauge, "sigma0", "weights", long_sums=False)
    return recipe.compute([])


HARD_TWISTS = (
    "Hard twists ignore that a camera's motion differs from that of its neighbours: standard "
    "deviations are too small, those of readouts by a factor of about 5. Use tied twists."
)


@dataclass(frozen=True)
class Recipe:
    """All inputs of a covariance; supports pickling."""

    request: SolveRequest
    of: tuple[str, ...]
    gauge: str
    scale: str
    robust: str
    long_sums: bool = True

    def compute(self, pairs: list[tuple[int, int]]) -> Covariance:
        """Return the covariance, with the relative poses of these pairs of image ids."""
        given = self.request.problem
        rows = rows_of(given.image_ids, pairs, "image")
        if not given.num_observations:
            raise InputError("problem: expected observations, found 0")
        refuse_huge(given)
        ready = at_control_points(prepare(self.request))
        layout = ready.layout
        factors = layout.core_factors()

        def run(problem: Problem, options: SolveOptions) -> dict[str, Any]:
            return _core.covariance(
                problem,
                options.asdict(),
                layout.limits,
                factors,
                self.gauge == "inner",
                self.robust == "sandwich",
                "points" in self.of,
                rows,
                self.long_sums,
            )

        out = run(ready.start, layout.options)
        dof = out["num_residuals"] - out["num_parameters"] + out["gauge_degrees"]
        if dof < 0:  # a factor of rounding errors is meaningless
            raise InputError(
                "problem: expected at least as many residuals as parameters, found "
                f"{out['num_residuals']} for {out['num_parameters'] - out['gauge_degrees']} "
                "(bundle diagnose names the undetermined parameters)"
            )
        sigma0 = float(np.sqrt(out["weighted_squares"] / dof)) if dof > 0 else float("nan")
        notes = list(out["warnings"])
        if layout.options.twists == "hard":
            notes.append(HARD_TWISTS)
        if out["gauge_degrees"] > 0 and (moved := note_on_inner_constraints(ready.start, out)):
            notes.append(moved)
        cost = 0.5 * out["weighted_squares"]
        if out["predicted_decrease"] > AT_MINIMUM * cost:
            share = 100 * out["predicted_decrease"] / cost if cost > 0 else float("inf")
            notes.append(not_converged(share, layout.options.loss == "trivial"))
        factor = 1.0
        if self.scale == "sigma0":
            if not dof > 0:
                raise InputError(
                    f"scale: expected degrees of freedom to estimate sigma0 from, found {dof} "
                    f"({out['num_residuals']} residuals); use unit"
                )
            if factors is None:
                factor = sigma0 * sigma0
            else:
                out = run(*_scaled(ready.start, layout.options, sigma0))
        known = {"sigma0": sigma0, "dof": dof, "notes": tuple(notes)}
        return self._result(out, pairs, factor, known | {"unit": length_unit(ready).strip()})

    def _result(
        self, out: dict[str, Any], pairs: list[Any], factor: float, known: dict[str, Any]
    ) -> Covariance:
        problem = self.request.problem
        refuse_rounding(problem, out)
        num_points = problem.num_points  # control points of the start follow them

        def some(part: str, ids: NDArray[Any], values: NDArray[Any]) -> tuple[Any, Any]:
            count = len(ids) if part in self.of else 0
            scaled = values[:count] if factor == 1 else freeze(values[:count] * factor)
            return freeze(np.array(ids[:count], np.int64)), scaled

        points = out.get("points", np.zeros((0, 3, 3)))
        sensors = np.stack([problem.sensor_rig_ids, problem.sensor_camera_ids], axis=1)
        names = {
            "pose": some("poses", problem.image_ids, out["poses"][: problem.num_images]),
            "frame": some("poses", problem.frame_ids, out["frames"]),
            "sensor": some("poses", sensors, out["sensors"]),
            "camera": some("intrinsics", problem.camera_ids, out["cameras"]),
            "point": some("points", problem.point_ids, points),
        }
        shutters: dict[str, Any] = {
            f"{name}_covariance": out[f"{name}s"]
            if factor == 1
            else freeze(out[f"{name}s"] * factor)
            for name, part in (("twist", "poses"), ("readout", "intrinsics"))
            if f"{name}s" in out and part in self.of
        }
        null = out["null_points"]
        relative = out["relative"]
        return Covariance(
            **{f"{name}_ids": ids for name, (ids, _) in names.items()},
            **{f"{name}_covariance": values for name, (_, values) in names.items()},
            relative_ids=freeze(np.array(pairs, np.int64).reshape(-1, 2)),
            relative_covariance=relative if factor == 1 else freeze(relative * factor),
            null_point_ids=freeze(np.array(problem.point_ids[null[null < num_points]], np.int64)),
            gauge=self.gauge,
            scale=self.scale,
            robust=self.robust,
            **known,
            **shutters,
            _relative=replace(self, of=("poses",)).compute,
        )


def _scaled(problem: Problem, options: SolveOptions, sigma0: float) -> tuple[Problem, SolveOptions]:
    """Return a problem with sigmas multiplied by sigma0; a loss keeps its weights."""
    old = problem.observation_sigma
    sigmas = np.full(problem.num_observations, sigma0) if old is None else sigma0 * old
    if options.loss != "trivial":
        options = options.replace(loss_scale=options.loss_scale / sigma0)
    return problem.replace(observation_sigma=sigmas), options


LARGEST = 1e50
"""Limit of coordinates; gauges need fourth powers, which would exceed the range of doubles."""

FAR = 100.0  # multiple of the median distance of points from the median of the cameras


def length_unit(prepared: Prepared) -> str:
    """Return " m" if positions, control points or scale bars determine the scale, else ""."""
    if not prepared.placed.groups:  # most refinements, which need none of these
        return ""
    from bundle.georeference.prior_alignment import ProblemPriors
    from bundle.georeference.scale_bars import FoundBars
    from bundle.georeference.target_priors import TargetPriors

    metric = ProblemPriors | TargetPriors | FoundBars
    return " m" if any(isinstance(one, metric) for one in prepared.placed.groups) else ""


def at_control_points(prepared: Prepared) -> Prepared:
    """Return a prepared request with its control points at a minimum for the present cameras.

    Preparation places them at the intersection of their rays, which is not the minimum.
    """
    targets, start = prepared.placed.targets, prepared.start
    if targets is None or not targets.used:
        return prepared
    added = np.isin(start.point_ids, targets.point_ids)
    part = start.select(points=added).problem
    options = SolveOptions(
        refine=("points",), loss=prepared.options.loss, loss_scale=prepared.options.loss_scale,
        cheirality=prepared.options.cheirality, num_threads=prepared.options.num_threads,
        function_tolerance=1e-15, gradient_tolerance=0.0, gauge="none", check_solution=False,
    )  # fmt: skip
    ids = {("point", key) for key in targets.point_ids}
    known = () if prepared.layout.known is None else prepared.layout.known.factors
    of_targets = [factor for factor in known if ids.issuperset(factor.keys)]  # bars, too
    own = SolveRequest(problem=part, options=options, factors=of_targets)
    points = start.points.copy()
    points[added] = solve_prepared(prepare(own), None, ThisProcess()).problem.points
    return prepared.at(start.replace(points=points))


def note_on_inner_constraints(problem: Problem, out: dict[str, Any]) -> str:
    """Return a sentence if few points dominate the inner constraints; else "".

    Distant points do by their weight, the square of their distance d from the cameras. So do points
    whose sigma exceeds d, if they cause a third of the sigma of most poses: an error e of one of n
    points moves the world by e / n, and turns it by e d / sum d^2.
    """
    takes_part = np.bincount(problem.observation_point, minlength=problem.num_points) > 0
    takes_part[out["null_points"]] = False
    rows = np.flatnonzero(takes_part)
    if not len(rows):
        return ""
    centers = problem.projection_centers
    center = np.median(centers, axis=0)
    distances = np.linalg.norm(problem.points[rows] - center, axis=1)
    weights = (distances / max(float(distances.max()), 1e-300)) ** 2
    is_meant = distances > FAR * np.median(distances)
    which = f"more than {FAR:g} times as far away as most"
    if not weights[is_meant].sum() > weights[~is_meant].sum():
        if "points" not in out:
            return ""
        squares = np.trace(out["points"][rows], axis1=1, axis2=2)
        turns = weights / max(float(weights.sum()), 1e-300) / np.maximum(distances, 1e-300)
        arm = np.median(np.linalg.norm(centers - center, axis=1))
        shares = (squares > distances**2) * squares * (1 / len(rows) + turns * arm) ** 2
        is_meant, which = shares > shares.max() / FAR, "with a sigma above the distance"
        of_poses = np.median(np.trace(out["poses"][:, 3:, 3:], axis1=1, axis2=2))
        if not shares.sum() > of_poses / 9:
            return ""
    ids = problem.point_ids[rows[is_meant]].tolist()
    return (
        f"{plural(len(ids), 'point')} {which} ({named('point', ids)}) "
        f"{noun(len(ids), 'dominates', 'dominate')} the inner constraints: sigmas "
        "are relative to these. Use two_cameras, or leave them out."
    )


def refuse_huge(problem: Problem) -> None:
    """Refuse coordinates whose powers exceed the range of doubles; the error names the first."""
    for kind, ids, coordinates in (
        ("point", problem.point_ids, problem.points),
        ("image", problem.image_ids, problem.cam_from_world[:, 4:]),
    ):
        sizes = np.abs(coordinates).max(axis=1, initial=0.0)
        for row in np.flatnonzero(sizes > LARGEST)[:1]:
            raise InputError(
                f"{kind} {ids[row]}: expected coordinates of at most {LARGEST:g}, found "
                f"{sizes[row]:g}; covariances need their fourth powers"
            )


def refuse_rounding(problem: Problem, out: dict[str, Any]) -> None:
    """Refuse negative and infinite variances, and NaN variances of images with observations."""
    seen = np.zeros(problem.num_images, bool)
    seen[problem.observation_image] = True
    for kind, ids, blocks, known in (
        ("image", problem.image_ids, out["poses"], seen),
        ("camera", problem.camera_ids, out["cameras"], False),
        ("point", problem.point_ids, out.get("points", np.zeros((0, 3, 3))), False),
    ):
        variances = np.diagonal(blocks, axis1=1, axis2=2)[: len(ids)]
        wrong = (variances < 0) | np.isinf(variances)
        no_number = np.isnan(variances).any(axis=1) & known
        for row in np.flatnonzero(wrong.any(axis=1) | no_number[: len(wrong)])[:1]:
            raise InputError(
                f"{kind} {ids[row]}: expected variances, found {variances[row].min():g}, which is "
                "only a rounding error: the problem is too ill-conditioned; bundle diagnose names "
                "the cause"
            )


def request_at(
    problem: Any,
    options: Any,
    changes: dict[str, Any],
    function: str,
    gauge: str = "none",
    *,
    constraints: Constraints | Iterable[str | Rule],
    **given: Any,
) -> SolveRequest:
    """Return the request for the normal equations of a problem or result.

    ``given``: factors, priors, align and bounds, as in :func:`bundle.solve`; ``function``: name in
    messages about ``changes``.
    """
    if isinstance(problem, Result):
        check_same_factors(problem, given["factors"], given["priors"], constraints)
        options = problem.options if options is None else options
        problem = problem.problem
    return SolveRequest(
        problem=as_problem(problem),
        options=SolveOptions.of(options, changes, function).replace(gauge=gauge),
        constraints=constraints if not isinstance(constraints, Iterable) else tuple(constraints),
        **given,
    )


def check_same_factors(result: Result, *given: Iterable[Any]) -> None:
    """Refuse a result without the factors of its solve: it is a minimum with them only."""
    count = len(result.factor_costs_after)
    shutter = result.problem.rolling_shutter
    if result.options.twists == "tied" and shutter is not None:
        count -= int(shutter.tied(result.problem).sum())  # from the options
    if count and all(isinstance(one, tuple | list) and not one for one in given):
        raise InputError(
            "problem: expected the factors, priors or constraints of the solve "
            f"({count}) together with its result"
        )


@overload
def covariance(
    problem: PoseGraph | PoseGraphResult,
    options: PoseGraphOptions | None = None,
    *,
    relative: Iterable[tuple[int, int]] = (),
    gauge: str | None = None,
    scale: str = "unit",
    **changes: Unpack[PoseGraphKeywords],
) -> Covariance: ...


@overload
def covariance(
    problem: FactorGraph,
    *,
    of: Iterable[Key] | None = None,
    relative: Iterable[tuple[Key, Key]] = (),
    gauge: str | None = None,
    scale: str = "unit",
    num_threads: int = 0,
) -> FactorGraphCovariance: ...


@overload
def covariance(
    problem: Source | Result,
    options: SolveOptions | None = None,
    *,
    of: str | Iterable[str] = PARTS,
    relative: Iterable[tuple[int, int]] = (),
    gauge: str | None = None,
    scale: str = "unit",
    robust: str = "weights",
    factors: Iterable[Factor] = (),
    priors: Iterable[Prior] = (),
    bounds: Mapping[tuple[str, int], tuple[ArrayLike, ArrayLike]] | None = None,
    constraints: Constraints | Iterable[str | Rule] = (),
    **changes: Any,
) -> Covariance: ...


@takes_options(SolveOptions)
def covariance(
    problem: Source | Result | PoseGraph | PoseGraphResult | FactorGraph,
    options: SolveOptions | PoseGraphOptions | None = None,
    *,
    of: str | Iterable[Any] | None = PARTS,
    relative: Iterable[tuple[Any, Any]] = (),
    gauge: str | None = None,
    scale: str = "unit",
    robust: str = "weights",
    factors: Iterable[Factor] = (),
    priors: Iterable[Prior] = (),
    bounds: Mapping[tuple[str, int], tuple[ArrayLike, ArrayLike]] | None = None,
    constraints: Constraints | Iterable[str | Rule] = (),
    **changes: Any,
) -> Covariance | FactorGraphCovariance:
    """Compute the marginal covariances of poses, points and intrinsics.

    For residuals of known sigma, the information matrix is H = J^T J over all free parameters.
    Blocks of its inverse are marginal covariances, for example of a pose when all points and
    intrinsics are estimated as well. The problem should be a minimum of a solve with the same
    options; otherwise ``notes`` says that it is not.

    Images alone leave position, rotation and scale of the world free, and H is singular. ``gauge``
    selects how this is resolved. "inner" gives the pseudo-inverse of H, the covariance of least
    trace (S-transformation of Baarda; Triggs et al. 2000, section 9); fixed parameters, priors and
    metric rigs reduce the gauge automatically. "two_cameras" and "three_points" hold the same
    parameters constant as a solve with that gauge. Poses and points that are then constant have
    covariance 0. "none": priors and fixed parameters determine the gauge. Angles, ratios of lengths
    and relative poses, apart from their scale, do not depend on the gauge, with one exception:
    "three_points" also fixes the shape of a triangle, two numbers too many. All covariances are
    then too small, and a note says so.

    Points without parallax are left out along their undetermined direction, exactly and without
    damping. ``null_point_ids`` lists them. They take no part in the inner constraints.

    For a pose graph, the result of its solve, or a g2o file, the result has the covariance of each
    pose, as a right perturbation X Exp(d) in the frame of the body, from the information of the
    edges. ``options`` are then :class:`bundle.PoseGraphOptions`, of which error, information and
    loss have an effect. A loss reduces the weight of edges and makes poses less certain. The result
    of a solve uses its own options and the final weights of the solve. ``gauge`` is "first" (the
    default: as in a solve, the first pose of each component without a fixed pose is constant),
    "inner" (the pseudo-inverse) or "none" (fixed poses determine the gauge). ``relative`` has pairs
    of pose ids, for the covariance of X_a^-1 X_b.

    For a :class:`FactorGraph` the result is a :class:`FactorGraphCovariance` at the values of the
    graph. ``of`` is a list of keys (by default all), ``relative`` a list of pairs of keys. Losses
    reduce weights. ``gauge`` is "first" (the default: the first variable of each component is
    constant and, if the scale is free, one more coordinate), "inner" or "none".

    Args:
        problem: problem, its path, or a pycolmap.Reconstruction. For a :class:`Result`, its refined
            problem and its options are used.
        options: refined and constant parameters, and the loss; by default those of
            :class:`SolveOptions`. Solver choices have no effect.
        of: some of "poses", "points", "intrinsics".
        relative: pairs (a, b) of image ids, for the covariance of cam_b_from_cam_a.
        gauge: "inner" (the default), "two_cameras", "three_points" or "none".
        scale: "unit": residuals have sigma 1 px, or ``observation_sigma`` if available; "sigma0":
            these times sigma0, estimated from the residuals. Priors keep their sigmas.
        robust: treatment of a loss. "weights": its weights rho' make an observation less certain;
            "sandwich": H^-1 (sum psi psi^T) H^-1, with psi the gradient of an observation, its
            residual corrected for its leverage. The latter holds for independent residuals of any
            distribution and has its own scale; for a point given the cameras, the scale is that of
            all residuals.
        factors: factors in addition to the observations, as in :func:`bundle.solve`.
        priors: measured positions and control points, in the frame of the problem; they do not move
            the problem.
        bounds: bounds of camera parameters; a parameter at an active bound is constant.
        constraints: rules, as in :func:`bundle.solve`.
        **changes: options by name, which replace those in ``options``.

    Raises:
        InputError: an argument is wrong; there are no observations; a coordinate exceeds 1e50; the
            gauge leaves a direction free; parameters beyond the gauge are undetermined; sigma0 has
            no degrees of freedom; a factor couples a point with another free parameter, or is a
            Python function.
        KeyboardInterrupt: Ctrl-C.
        MemoryError: memory or a memory limit is too small.
        OSError: the path cannot be read.

    Example:
        >>> cov = bundle.covariance("sparse/0", scale="sigma0")
        >>> cov.pose(7)[3:, 3:]
    """
    # Findings about a reconstruction need no graphs.
    from bundle.graphs.factors.factor_graph import FactorGraph, GraphResult
    from bundle.graphs.pose_graphs.edge_weights import is_graph, refuse_for_graphs

    if isinstance(problem, GraphResult):  # does not know its factors
        raise InputError("found the result of a graph: pass graph.with_values(result.values)")
    if isinstance(problem, FactorGraph) or is_graph(problem):
        refuse_for_graphs(
            robust=None if robust == "weights" else robust,
            factors=factors,
            priors=priors,
            bounds=bounds,
            constraints=constraints,
        )
        of = None if of is PARTS else of
        gauge = "first" if gauge is None else gauge
        given: Any = {"relative": relative, "gauge": gauge, "scale": scale}
        if isinstance(problem, FactorGraph):
            from bundle.analysis.uncertainty.graph_covariance import factor_graph_covariance

            threads = SolveOptions.of(None, changes, "covariance").num_threads
            others = {name: one for name, one in changes.items() if name != "num_threads"}
            refuse_for_graphs(options=options, **others)
            return factor_graph_covariance(problem, of=of, num_threads=threads, **given)
        from bundle.analysis.uncertainty.graph_covariance import graph_covariance

        refuse_for_graphs(of=of)
        return graph_covariance(problem, options, **given, **changes)  # type: ignore[arg-type]
    gauge = choice("gauge", "inner" if gauge is None else gauge, GAUGES)
    recipe = Recipe(
        request=request_at(
            problem,
            options,
            changes,
            "covariance",
            "none" if gauge == "inner" else gauge,
            factors=factors,
            priors=priors,
            align=False,
            bounds=bounds,
            constraints=constraints,
        ),
        of=parts_of("of", of),  # type: ignore[arg-type]
        gauge=gauge,
        scale=choice("scale", scale, SCALES),
        robust=choice("robust", robust, ROBUST),
    )
    if recipe.robust == "sandwich" and recipe.scale == "sigma0":
        raise InputError(
            "scale: expected unit with the sandwich, which takes its scale from the residuals"
        )
    return recipe.compute(list(relative))
