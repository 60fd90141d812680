"""``bundle.covariance`` of every kind of input."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Unpack, overload

from numpy.typing import ArrayLike

from bundle.analysis.uncertainty.compute_covariance import Recipe, check_same_factors
from bundle.analysis.uncertainty.covariance_result import (
    Covariance,
    FactorGraphCovariance,
)
from bundle.errors import InputError
from bundle.graphs.factors.factor_graph import FactorGraph
from bundle.interface.analysis_options import GAUGES, PARTS, ROBUST, SCALES, one_of, parts_of
from bundle.interface.option_class import takes_options
from bundle.interface.options import SolveOptions
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.io.files import Source, as_problem
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.solving.request import SolveRequest
from bundle.solving.result import Result

if TYPE_CHECKING:
    from bundle.georeference.measurements import Prior
    from bundle.graphs.factors.factors import Factor
    from bundle.graphs.factors.variables import Key
    from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
    from bundle.interface.option_keywords import PoseGraphKeywords
    from bundle.solving.constraints.rule_list import Constraints
    from bundle.solving.constraints.rules import Rule


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
    covariance 0.
    "none": priors and fixed parameters determine the gauge. Angles, ratios of lengths and relative
    poses, apart from their scale, do not depend on the gauge, with one exception: "three_points"
    also fixes the shape of a triangle, two numbers too many. All covariances are then too small,
    and a note says so.

    Points without parallax are left out along their undetermined direction, exactly and without
    damping. ``null_point_ids`` lists them. They take no part in the inner constraints.

    For a pose graph, the result of its solve, or a g2o file, the result has the covariance of each
    pose, as a right perturbation X Exp(d) in the frame of the body, from the information of the
    edges. ``options`` are then
    :class:`bundle.PoseGraphOptions`, of which error, information and loss count. A loss reduces the
    weight of edges and makes poses less certain. The result of a solve uses its own options and the
    final weights of the solve. ``gauge`` is "first" (the default: as in a solve, the first pose of
    each component without a fixed pose is constant), "inner" (the pseudo-inverse) or "none" (fixed
    poses determine the gauge). ``relative`` has pairs of pose ids, for the covariance of X_a^-1
    X_b.

    For a :class:`FactorGraph` the result is a :class:`FactorGraphCovariance` at the values of the
    graph: of variables, with ``of`` a list of keys (by default all), and of the pairs of keys in
    ``relative``. Losses reduce weights. ``gauge`` is "first" (the default: of each component, the
    first variable and, for a free scale, one coordinate more are constant), "inner" or "none".

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
            distribution and has its own scale; of a point given the cameras, that of all residuals.
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
    # A report of a reconstruction needs no graphs.
    from bundle.graphs.pose_graphs.edge_weights import is_graph, refuse_for_graphs

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
            from bundle.analysis.factor_equations import factor_graph_covariance

            threads = SolveOptions.of(None, changes, "covariance").num_threads
            others = {name: one for name, one in changes.items() if name != "num_threads"}
            refuse_for_graphs(options=options, **others)
            return factor_graph_covariance(problem, of=of, num_threads=threads, **given)
        from bundle.analysis.normal_equations import graph_covariance

        refuse_for_graphs(of=of)
        return graph_covariance(problem, options, **given, **changes)  # type: ignore[arg-type]
    if isinstance(problem, Result):
        check_same_factors(problem, factors, priors, constraints)
        options = problem.options if options is None else options
        problem = problem.problem
    problem = as_problem(problem)  # type: ignore[arg-type]
    options = SolveOptions.of(options, changes, "covariance")
    gauge = one_of("gauge", "inner" if gauge is None else gauge, GAUGES)
    request = SolveRequest(
        problem=problem,
        options=options.replace(gauge="none" if gauge == "inner" else gauge),
        factors=factors,
        priors=priors,
        align=None,
        bounds=bounds,
        constraints=constraints if not isinstance(constraints, Iterable) else tuple(constraints),
    )
    recipe = Recipe(
        request=request if not request.priors else replace(request, align=False),
        of=parts_of("of", of),  # type: ignore[arg-type]
        gauge=gauge,
        scale=one_of("scale", scale, SCALES),
        robust=one_of("robust", robust, ROBUST),
    )
    if recipe.robust == "sandwich" and recipe.scale == "sigma0":
        raise InputError(
            "scale: expected unit with the sandwich, which takes its scale from the residuals"
        )
    return recipe.compute(list(relative))
