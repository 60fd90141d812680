"""Bundle adjustment: a problem and options in, a refined problem and its story out."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from bundle import _core
from bundle.arguments import check_function
from bundle.io import Source, as_problem
from bundle.options import SolveOptions
from bundle.problem import Problem
from bundle.reprojection import resolve_cheirality
from bundle.result import Result
from bundle.solve_record import Progress, record_fields

if TYPE_CHECKING:
    from bundle.graph import Factor
    from bundle.graph.problem_factors import ProblemFactors

__all__ = ["Progress", "resolve_defaults", "solve"]


def solve(
    problem: Source,
    options: SolveOptions | None = None,
    *,
    factors: Iterable[Factor] = (),
    progress: Progress | None = None,
    **changes: Any,
) -> Result:
    """Refine a problem: minimise 1/2 sum rho(||r||^2) over what ``options.refine`` names.

    r is the reprojection error of an observation in pixels, rho the loss. The GIL is released while
    the solver runs. Ctrl-C stops it, within a step where the solver can be left (Ceres' own linear
    solvers cannot); the result then holds the best state and ``summary.interrupted``. Not
    converging is a result as well, not an exception.

    Factors add their own 1/2 rho(||r||^2), r whitened, rho the factor's loss. Their keys name
    variables of the problem: ``("image", image_id)`` is cam_from_world on se3 (qx qy qz qw tx ty
    tz; its tangent coordinates are rotation, then translation, in the frame of cam_from_world, as
    :class:`bundle.FactorGraph` has them), ``("camera", camera_id)`` the camera's parameters in
    COLMAP's order and ``("point", point_id)`` the coordinates, both Euclidean. For instance
    measured positions of the images' centres, to 2 cm::

        factors = [bundle.PositionFactor(("image", i), xyz, 1 / 0.02**2) for i, xyz in gps.items()]
        bundle.solve(problem, factors=factors)

    As images are cam_from_world, a relative pose of two of them is a
    :class:`bundle.RelativePoseFactor`. What a factor touches is refined even if no observation sees
    it. What is held stays, and the cost of its factors counts.

    Both backends take factors of images and cameras, and of one point; those that couple a point
    with something else that is refined, and functions in Python, are for Ceres. With factors of
    images or points gauge "auto" holds nothing: they say where the world is, as far as they do, and
    the damping of the trust region holds the rest; "two_cameras" and "three_points" hold what they
    always do, and warn (``gauge_beside_factors``). The world of the factors is that of the problem,
    also where a far scene is solved about its centre.

    Args:
        problem: left untouched; also the path of one, or a pycolmap.Reconstruction.
        options: how to solve; the defaults of :class:`SolveOptions` if not given.
        factors: beside the observations, such as :class:`bundle.PriorFactor`.
        progress: called after each iteration with a dict under the names of Ceres'
            IterationSummary. What it raises stops the solve and comes out of this function;
            KeyboardInterrupt stops it as Ctrl-C does.
        **changes: options by name, in place of those in ``options``.

    Raises:
        KeyboardInterrupt: Ctrl-C before the start was evaluated, so that there is nothing to keep.
        MemoryError: memory or a limit of it does not suffice.
        InputError: an option that does not exist, a camera model that is not supported, a fixed id
            that does not exist, options that exclude each other or the backend asked for, dense
            matrices beyond the memory of this machine, or a factor with an unknown key, numbers
            that do not fit its variables, or no finite value at the start.
        OSError: the path cannot be read.
    """
    problem = as_problem(problem)
    options = SolveOptions.of(options, changes, "solve")
    check_function("progress", progress)
    known = _problem_factors(problem, factors)
    if known is not None and known.locate and options.gauge == "auto":
        options = options.replace(gauge="none")
    options = resolve_defaults(problem, options)
    given = None if known is None else known.core()
    output = _core.solve(problem, options.asdict(), progress, given)
    refined = problem.replace(
        cam_from_world=output["cam_from_world"],
        camera_params=output["camera_params"],
        points=output["points"],
    )
    return Result(
        problem=refined,
        initial_problem=problem,
        options=options,
        factor_costs_before=output["factor_costs_before"],
        factor_costs_after=output["factor_costs_after"],
        **record_fields(output),
    )


def _problem_factors(problem: Problem, factors: Iterable[Factor]) -> ProblemFactors | None:
    """Return the factors; their modules are imported only where there are some."""
    if isinstance(factors, tuple | list) and not factors:
        return None
    from bundle.graph.problem_factors import ProblemFactors

    return ProblemFactors(problem, factors)


def resolve_defaults(problem: Problem, options: SolveOptions) -> SolveOptions:
    """Fill in what depends on where the problem comes from."""
    cores = _core.hardware_threads()
    gauge = options.gauge
    if gauge == "auto":
        gauge = "none" if problem.format == "bal" else "two_cameras"
    return options.replace(
        gauge=gauge,
        cheirality=resolve_cheirality(problem, options.cheirality),
        num_threads=min(options.num_threads or cores, cores),
    )
