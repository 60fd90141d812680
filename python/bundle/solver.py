"""Bundle adjustment: a problem and options in, a refined problem and its story out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bundle import _core
from bundle.arguments import check_function
from bundle.io import Source, as_problem
from bundle.options import SolveOptions
from bundle.problem import Problem
from bundle.reprojection import resolve_cheirality
from bundle.result import Result
from bundle.solve_record import record_fields

__all__ = ["Progress", "resolve_defaults", "solve"]

Progress = Callable[[dict[str, Any]], None]


def solve(
    problem: Source,
    options: SolveOptions | None = None,
    *,
    progress: Progress | None = None,
    **changes: Any,
) -> Result:
    """Refine a problem: minimise 1/2 sum rho(||r||^2) over what ``options.refine`` names.

    r is the reprojection error of an observation in pixels, rho the loss. The GIL is released while
    the solver runs. Ctrl-C stops it, within a step where the solver can be left (Ceres' own linear
    solvers cannot); the result then holds the best state and ``summary.interrupted``. Not
    converging is a result as well, not an exception.

    Args:
        problem: left untouched; also the path of one, or a pycolmap.Reconstruction.
        options: how to solve; the defaults of :class:`SolveOptions` if not given.
        progress: called after each iteration with a dict under the names of Ceres'
            IterationSummary. What it raises stops the solve and comes out of this function;
            KeyboardInterrupt stops it as Ctrl-C does.
        **changes: options by name, in place of those in ``options``.

    Raises:
        KeyboardInterrupt: Ctrl-C before the start was evaluated, so that there is nothing to keep.
        MemoryError: memory or a limit of it does not suffice.
        InputError: an option that does not exist, a camera model that is not supported, a fixed id
            that does not exist, options that exclude each other or the backend asked for, or dense
            matrices beyond the memory of this machine.
        OSError: the path cannot be read.
    """
    problem = as_problem(problem)
    options = SolveOptions.of(options, changes, "solve")
    check_function("progress", progress)
    options = resolve_defaults(problem, options)
    output = _core.solve(problem, options.asdict(), progress)
    refined = problem.replace(
        cam_from_world=output["cam_from_world"],
        camera_params=output["camera_params"],
        points=output["points"],
    )
    return Result(
        problem=refined,
        initial_problem=problem,
        options=options,
        **record_fields(output),
    )


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
