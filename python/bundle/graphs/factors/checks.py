"""Checks of Jacobians of any input: a reconstruction, a pose graph, a factor graph, a function.

For a pose graph, error and Jacobians of an edge are those of
``cpp/core/pose_graph/relative_pose.h``, without the square root of the information, which
multiplies both.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

from numpy.typing import ArrayLike

import bundle._core as _core
from bundle.base.arrays import check_function
from bundle.checking.function import ResidualFunction, UserFunction
from bundle.checking.gradient_report import GradientReport
from bundle.checking.jacobians import check_problem
from bundle.checking.residual_blocks import ManifoldLike, Name
from bundle.checking.sample_check import check_function_at
from bundle.errors import InputError, brief
from bundle.graphs.factors.factor_check import CheckedFactor, check_each, choose
from bundle.graphs.factors.factor_graph import FactorGraph
from bundle.graphs.factors.factor_report import FactorCheck
from bundle.graphs.factors.factors import Factor, FunctionFactor
from bundle.graphs.factors.variables import Array, Key, Variable
from bundle.interface.analysis_options import SAMPLES_PER_IMAGE, TOLERANCE
from bundle.interface.option_fields import choice, number
from bundle.interface.pose_graph_options import POSE_ERRORS
from bundle.io.files import Source
from bundle.io.g2o_files import load_g2o
from bundle.io.recognition import is_pose_graph_file
from bundle.model.pose_graph_arrays import PoseGraph

if TYPE_CHECKING:
    import os

AnySource: TypeAlias = "Source | PoseGraph | FactorGraph | str | os.PathLike[str]"


def check_jacobians(
    problem: AnySource,
    *,
    samples_per_image: int | None = SAMPLES_PER_IMAGE,
    seed: int = 0,
    tolerance: float = TOLERANCE,
    cheirality: str = "auto",
    error: str = "log",
    num_threads: int = 0,
    details: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> GradientReport | FactorCheck:
    """Check the analytic Jacobians that a solve of this input would use.

    Every residual is checked as Ceres evaluates it, with variable pose, intrinsics and point. The
    references are ceres::GradientChecker and Richardson extrapolation. Every other observation is
    checked away from the origin of its rotation's chart. For a :class:`bundle.FactorGraph`, all
    kinds of factors are checked, those in Python included; for a pose graph, its edges.

    Args:
        problem: a problem, the path of a problem, a pycolmap.Reconstruction, a pose graph or its
            path, or a factor graph; the check is at its values.
        samples_per_image: number of observations to check per image; for a graph, number of factors
            with the same code and the same manifolds; None: all.
        seed: seed of the sampling.
        tolerance: relative error above which an entry is wrong.
        cheirality: as in a solve; observations that it ignores are skipped.
        error: error of the edges of a pose graph, as in a solve.
        num_threads: number of threads; 0: all cores. Graphs are checked on one thread.
        details: also compute what ``bundle.html.write_check`` draws.
        progress: called with the number of finished and the total number of observations.

    Returns:
        Report; its truth value is True if all Jacobians are correct. Findings of a graph name
        factor, variables, rows and columns.

    Raises:
        InputError: a camera model is not supported, an argument is out of range, or a function of
            the graph returns wrong shapes.
        OSError: the path cannot be read.
    """
    if is_pose_graph_file(problem):
        problem = load_g2o(problem)
    if not isinstance(problem, FactorGraph | PoseGraph):
        return check_problem(
            problem,
            samples_per_image=samples_per_image,
            seed=seed,
            tolerance=tolerance,
            cheirality=cheirality,
            num_threads=num_threads,
            details=details,
            progress=progress,
        )
    check_function("progress", progress)
    is_graph = isinstance(problem, FactorGraph)
    total = len(problem.factors) if isinstance(problem, FactorGraph) else problem.num_edges
    settings: dict[str, Any] = {
        "most_of_a_kind": samples_per_image,
        "progress": None if progress is None else lambda done: progress(done, total),
        "seed": seed,
        "tolerance": tolerance,
        "details": details,
    }
    if isinstance(problem, PoseGraph):
        return check_edges(problem, error, **settings)
    assert is_graph
    return problem.check_gradients(**settings)


def check_gradients(
    function: ResidualFunction | Factor | FactorGraph,
    blocks: Sequence[ArrayLike] | Mapping[Key, ArrayLike] | None = None,
    manifolds: Sequence[ManifoldLike] | Mapping[Key, str] | None = None,
    *,
    names: Sequence[Name] | None = None,
    num_samples: int | None = None,
    radius: float = 0.1,
    seed: int = 0,
    tolerance: float = TOLERANCE,
    ambient: bool = True,
    tangent: str | None = None,
    details: bool = False,
) -> GradientReport | FactorCheck:
    """Check analytic Jacobians, and identify the mistake in wrong ones.

    The Jacobians are compared at the given point and at points around it. The two references are
    ceres::GradientChecker, and central differences with Richardson extrapolation and an error
    bound. In a test::

        assert bundle.check_gradients(residual, [pose, intrinsics, point], ["se3", None, None])
        assert bundle.check_gradients(factor, {"x": pose, "l": landmark}, {"x": "se2"})
        assert bundle.check_gradients(graph)

    Args:
        function: function from a list of arrays, one per block, to (residual, list of Jacobians),
            Jacobian i of shape (num_residuals, size of block i). It is called some hundred times
            per sample and block. The C++ header bundle/checkable.h (``bundle.get_include()``)
            converts a compiled ceres cost function to such a function. Or a factor, or a whole
            :class:`bundle.FactorGraph`.
        blocks: parameters, one array per block; for a factor, the values of its variables, by key
            or in the order of its keys; None for a graph.
        manifolds: one per block, or None if all are Euclidean. Choices: None or "euclidean";
            "angle_axis" (a rotation vector, differentiated as a vector space but sampled and named
            as a rotation); "quaternion_wxyz", "quaternion_xyzw"; "se3" (qx qy qz qw tx ty tz,
            COLMAP's pose); "sphere"; ("subset", constant entries). For a factor, those of
            :meth:`bundle.FactorGraph.add_variable`, by key or in the order of its keys.
        names: one entry per block, for the report: a name, or (name, names of its parameters). A
            factor has its keys.
        num_samples: number of points to check, including the given one; None: 10, and 3 for each
            factor of a graph.
        radius: distance of the other points, relative to each parameter; radians for rotations.
        seed: seed of the sampling.
        tolerance: relative error above which an entry is wrong.
        ambient: also compare derivatives along the normals of manifolds. They do not affect a
            solve, and GradientChecker does not test them. Factors have no such derivatives.
        tangent: library in whose tangent coordinates the Jacobians are: "gtsam" (as a factor
            graph), "manif" (also Sophus), "g2o", "g2o_expmap" (VertexSE3Expmap, as ORB-SLAM). The
            manifolds are then those of a factor graph, and Jacobian i has their tangent size. None:
            Jacobians by all numbers of the blocks, as Ceres; for a factor "gtsam".
        details: also compute what ``bundle.html.write_check`` draws: errors of all entries, and
            curves against the step size.

    Returns:
        Report; its truth value is True if all Jacobians are correct. Print it for details.

    Raises:
        InputError: blocks, manifolds or names do not match, or the function returns wrong shapes.
            Exceptions of the function are passed on, except ArithmeticError and ValueError away
            from the given point: the residual has no value there.
    """
    settings: dict[str, Any] = {
        "radius": radius,
        "seed": seed,
        "tolerance": tolerance,
        "details": details,
    }
    if tangent is not None:
        settings["tangent"] = tangent
    if not isinstance(function, FactorGraph | Factor):
        if isinstance(function, PoseGraph):
            raise InputError("function: expected factors, found a pose graph; try check_jacobians")
        if tangent is not None:
            UserFunction.check_call(function, blocks)
            keys = _keys(blocks, names)
            graph = _graph_of(FunctionFactor(keys, function), blocks, manifolds)
            check = graph.check_gradients(num_samples=num_samples or 10, **settings)
            return next(iter(check.reports.values()))
        return check_function_at(
            function,
            blocks,  # type: ignore[arg-type]
            manifolds,  # type: ignore[arg-type]
            names=names,
            num_samples=10 if num_samples is None else num_samples,
            radius=radius,
            seed=seed,
            tolerance=tolerance,
            ambient=ambient,
            details=details,
        )
    if names is not None:
        raise InputError("names: expected None for factors, whose names are their keys")
    if isinstance(function, FactorGraph):
        for argument, given in (("blocks", blocks), ("manifolds", manifolds)):
            if given is not None:
                raise InputError(f"{argument}: expected None for a graph, found {brief(given)}")
        return function.check_gradients(num_samples=num_samples or 3, **settings)
    graph = _graph_of(function, blocks, manifolds)
    return graph.check_gradients(num_samples=num_samples or 10, **settings)


def _keys(blocks: Any, names: Any) -> tuple[str, ...]:
    if names is None:
        return tuple(f"block {b}" for b in range(len(blocks)))
    is_list = isinstance(names, list | tuple) and len(names) == len(blocks)
    if not is_list or not all(isinstance(name, str) for name in names):
        raise InputError(f"names: expected a name per block, found {brief(names)}")
    return tuple(names)


def _graph_of(factor: Factor, values: Any, manifolds: Any) -> FactorGraph:
    graph = FactorGraph()
    known = _by_key("blocks", factor, values)
    kinds = {} if manifolds is None else _by_key("manifolds", factor, manifolds, every=False)
    for key in factor.keys:
        graph.add_variable(key, known[key], kinds.get(key) or "euclidean")
    graph.add_factor(factor)
    return graph


def _by_key(argument: str, factor: Factor, given: Any, *, every: bool = True) -> Mapping[Key, Any]:
    """Return entries by key, given by key or in the order of the keys."""
    keys = factor.keys
    if not isinstance(given, Mapping):
        if (
            isinstance(given, str | bytes)
            or not hasattr(given, "__len__")
            or len(given) != len(keys)
        ):
            raise InputError(
                f"{argument}: expected one entry per variable of {factor.name}, by key or in this "
                f"order, found {brief(given)}"
            )
        given = dict(zip(keys, given, strict=True))
    for key in keys if every else ():
        if key not in given:
            raise InputError(f"{argument}: expected {brief(key)} of {factor.name}")
    for key in given:
        if key not in keys:
            raise InputError(f"{argument}: {factor.name} has no variable {brief(key)}")
    return dict(given)


def check_edges(
    graph: PoseGraph,
    error: str = "log",
    *,
    most_of_a_kind: int | None = None,
    progress: Callable[[int], None] | None = None,
    **settings: Any,
) -> FactorCheck:
    """Check the Jacobians of at most ``most_of_a_kind`` odometry edges and closures."""
    error = choice("error", error, POSE_ERRORS)
    if most_of_a_kind is not None:
        most_of_a_kind = number("most_of_a_kind", most_of_a_kind, minimum=1, whole=True)
    manifold = "se2" if graph.poses.shape[1] == 3 else "se3"
    labels = ["closure" if closure else "odometry" for closure in graph.is_closure.tolist()]

    def make(edge: int) -> CheckedFactor:
        ends = graph.edges[edge].tolist()
        keys = [int(graph.ids[end]) for end in ends]
        line = int(graph.edge_lines[edge])
        place = f", line {line}" if line else ""
        variables = [
            Variable.make(key, graph.poses[end], manifold, False, None, None)
            for key, end in zip(keys, ends, strict=True)
        ]
        measured = graph.measurements[edge]

        def function(values: list[Array]) -> tuple[Array, list[Array]]:
            first, second = values
            residual, by_first, by_second = _core.relative_pose_error(
                error, first, second, measured
            )
            return residual, [by_first, by_second]

        name = f"edge {edge} from {keys[0]} to {keys[1]}{place}"
        return CheckedFactor(name, f"edge, {labels[edge]}", labels[edge], variables, function)

    chosen = choose(labels, most_of_a_kind)
    return check_each(map(make, chosen), settings, num_factors=graph.num_edges, progress=progress)
