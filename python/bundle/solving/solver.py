"""Bundle adjustment: a problem and options in, a refined problem and its story out."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Set
from typing import TYPE_CHECKING, Any, NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle import _core
from bundle.base.arguments import check_function
from bundle.base.display import Display, Displayed
from bundle.base.words import contents, plural
from bundle.errors import InputError, brief, first_line
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
from bundle.graphs.pose_graphs.solve_pose_graph import solve_pose_graph
from bundle.interface.options import CHANGEABLE, SolveOptions
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.interface.solve_record import Progress, record_fields
from bundle.io.g2o_files import load_g2o
from bundle.io.recognition import is_pose_graph_file
from bundle.io.source import Source, as_problem
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.problem import Problem
from bundle.model.reprojection import resolve_cheirality
from bundle.solving.constraints.restrictions import Restrictions
from bundle.solving.placement import Start, place_at_priors
from bundle.solving.ranks.launch import current, threads_of_one_process
from bundle.solving.result import Result
from bundle.solving.sensor_changes import weak_baseline

if TYPE_CHECKING:
    from bundle.graphs.factors.factors import Factor
    from bundle.graphs.factors.problem_factors import ProblemFactors
    from bundle.solving.constraints.applied import Applied
    from bundle.solving.constraints.rule_list import Constraints
    from bundle.solving.constraints.rules import Rule
    from bundle.solving.placement import Prior

__all__ = [
    "STATE",
    "Prepared",
    "Progress",
    "Solver",
    "constrained",
    "prepare",
    "resolve_defaults",
    "result_of",
    "settle",
    "solve",
    "with_priors",
]

# What a solve gives back of a problem; the poses of rigs only where there are some.
STATE = ("cam_from_world", "camera_params", "points", "rig_from_world", "sensor_from_rig")


@overload
def solve(
    problem: PoseGraph,
    options: PoseGraphOptions | None = None,
    *,
    progress: Progress | None = None,
    **changes: Any,
) -> PoseGraphResult: ...


@overload
def solve(
    problem: Source,
    options: SolveOptions | None = None,
    *,
    factors: Iterable[Factor] = (),
    priors: Iterable[Prior] = (),
    align: bool | None = None,
    bounds: Mapping[tuple[str, int], tuple[ArrayLike, ArrayLike]] | None = None,
    constraints: Constraints | Iterable[str | Rule] | Applied = (),
    progress: Progress | None = None,
    **changes: Any,
) -> Result: ...


def solve(
    problem: Source | PoseGraph,
    options: SolveOptions | PoseGraphOptions | None = None,
    *,
    factors: Iterable[Factor] = (),
    priors: Iterable[Prior] = (),
    align: bool | None = None,
    bounds: Mapping[tuple[str, int], tuple[ArrayLike, ArrayLike]] | None = None,
    constraints: Constraints | Iterable[str | Rule] | Applied = (),
    progress: Progress | None = None,
    **changes: Any,
) -> Result | PoseGraphResult:
    """Refine a problem: minimise 1/2 sum rho(||r||^2) over what ``options.refine`` names.

    r is the reprojection error of an observation in pixels, rho the loss. The GIL is released while
    the solver runs. Ctrl-C stops it, within a step where the solver can be left (Ceres' own linear
    solvers cannot); the result then holds the best state and ``summary.interrupted``. Not
    converging is a result as well, not an exception.

    Factors add their own 1/2 rho(||r||^2), r whitened, rho the factor's loss. Their keys name
    variables of the problem: ``("image", image_id)`` is cam_from_world on se3 (qx qy qz qw tx ty
    tz; its tangent coordinates are rotation, then translation, in the frame of cam_from_world, as
    :class:`bundle.FactorGraph` has them), ``("camera", camera_id)`` the camera's parameters in
    COLMAP's order and ``("point", point_id)`` the coordinates, both Euclidean. Of rigs,
    ``("frame", frame_id)`` is rig_from_world and ``("sensor", (rig_id, camera_id))``
    sensor_from_rig, on se3 as images are. For instance measured positions of the images' centres,
    to 2 cm::

        factors = [bundle.PositionFactor(("image", i), xyz, 1 / 0.02**2) for i, xyz in gps.items()]
        bundle.solve(problem, factors=factors)

    As images are cam_from_world, a relative pose of two of them is a
    :class:`bundle.RelativePoseFactor`. What a factor touches is refined even if no observation sees
    it. What is held stays, and the cost of its factors counts.

    Both backends take factors of images, rigs and cameras, and of one point; those that couple a
    point with something else that is refined, and functions in Python, are for Ceres. With factors
    of images or points gauge "auto" holds nothing: they say where the world is, as far as they do,
    and the damping of the trust region holds the rest; "two_cameras" and "three_points" hold what
    would be free without the factors, and warn (``gauge_beside_factors``). The world of the factors
    is that of the problem, also where a far scene is solved about its centre.

    Priors of positions are factors, too. As a reconstruction stands in a frame of its own, the
    problem is first moved by the similarity that they determine, robustly (``similarity`` of the
    result), held images and points as well::

        priors = [bundle.PositionPrior(name, enu, (2, 5)) for name, enu in gps.items()]
        bundle.solve(problem, priors=priors)

    Ground control points (:class:`bundle.GroundControlPoint`, coordinates in the same metres) are
    priors as well. Each becomes a point of the solve, with its surveyed position as a prior of its
    own sigma and its pixels as observations with theirs; it decides where the problem is moved to
    as positions do, and is not among the points of the result. Check points have no influence.
    ``control_points`` of the result says how far all of them are from the survey::

        known = bundle.georeference.gcp_priors(problem, "gcp_list.txt")
        bundle.solve(problem, priors=known.priors).control_points

    Of a :class:`bundle.PoseGraph` the poses are refined, the options are those of
    :class:`bundle.PoseGraphOptions`, and the result is a :class:`bundle.PoseGraphResult`. Fixed
    poses stay; in a connected component without one the first pose is held::

        bundle.solve("x.g2o", init="chordal", error="log").summary.chi2_final

    Args:
        problem: left untouched; also the path of a reconstruction or of a pose graph, or a
            pycolmap.Reconstruction.
        options: how to solve; the defaults of :class:`SolveOptions` if not given.
        factors: beside the observations, such as :class:`bundle.PriorFactor`.
        priors: measured positions of images, and control points. Their costs come after those of
            the factors, those of control points last.
        align: whether the problem is first moved to where the priors are. None: if there are no
            factors, and at least three positions and control points that do not lie on one line.
        constraints: rules of what is held, bounded, shared or known, such as ``"cameras *: f prior
            2 %"`` (:class:`bundle.Constraints`). They speak of the problem after it was moved to
            the priors, and the costs of their priors come last. ``constraints`` of the result says
            what became of each. With rules about positions or rotations gauge "auto" holds nothing.
        bounds: ``{("camera", camera_id): (lower, upper)}``, a number for each parameter in COLMAP's
            order, infinite where there is no bound. The parameter starts between its bounds and
            stays there; bounds that are equal hold it. ``active_bounds`` of the result has those
            on which it ends.
        progress: called after each iteration with a dict under the names of Ceres'
            IterationSummary. What it raises stops the solve and comes out of this function;
            KeyboardInterrupt stops it as Ctrl-C does.
        **changes: options by name, in place of those in ``options``.

    Raises:
        KeyboardInterrupt: Ctrl-C before the start was evaluated, so that there is nothing to keep.
        MemoryError: memory or a limit of it does not suffice.
        InputError: an option that does not exist, a camera model that is not supported, a fixed id
            that does not exist, options that exclude each other or the backend asked for, dense
            matrices beyond the memory of this machine, bounds of no camera, of another number of
            parameters, or that exclude the start, or a factor with an unknown key, numbers that do
            not fit its variables, or no finite value at the start; a prior of no image, control
            points that are measured in no two images, or priors that do not determine where the
            problem is although ``align`` is True; a rule that names nothing of the problem,
            contradicts another one or the options, or excludes the start.
        OSError: the path cannot be read.
    """
    if is_pose_graph_file(problem):
        problem = load_g2o(problem)  # type: ignore[arg-type]
    if isinstance(problem, PoseGraph):
        beside = {
            "factors": factors,
            "priors": priors,
            "bounds": bounds,
            "constraints": constraints,
        }
        for name, value in (beside | {"align": align}).items():
            if value is not None and value != ():
                raise InputError(f"{name}: expected none for a pose graph, found {brief(value)}")
        return solve_pose_graph(problem, options, progress=progress, **changes)  # type: ignore[arg-type]
    problem = as_problem(problem)
    options = SolveOptions.of(options, changes, "solve")  # type: ignore[arg-type]
    check_function("progress", progress)
    ready = prepare(problem, options, factors, priors, align, bounds, constraints)
    placed, options, limits = ready.placed, ready.options, ready.limits
    output = _run(ready, progress)
    if ready.known is not None and options.check_solution:
        output["summary"] = _checked(ready.start, ready.known.factors, output)
    return with_priors(result_of(placed.problem, options, output, limits), placed, problem)


def _run(ready: Prepared, progress: Progress | None) -> dict[str, Any]:
    """Return what the core makes of a start, by all processes where there are several.

    What cannot be divided is this process's alone, with a warning.
    """
    options, factors = ready.options.asdict(), ready.core_factors()
    crew = current()
    if crew is None:
        return _core.solve(ready.start, options, progress, ready.limits, factors)
    from bundle.solving.ranks.divided_solve import solve_divided
    from bundle.solving.ranks.one_process import reason_to_be_alone, with_warning

    reason = reason_to_be_alone(options, factors)
    if reason:
        output = _core.solve(ready.start, options, progress, ready.limits, factors)
        return with_warning(output, reason, crew.num_ranks)
    return solve_divided(crew, ready.start, options, progress, ready.limits, factors)


def _checked(start: Problem, factors: Iterable[Factor], output: dict[str, Any]) -> dict[str, Any]:
    """Return the summary's fields with what a spot check says of factors in Python."""
    from bundle.graphs.factors.problem_factors import checked_solve

    return checked_solve(start, factors, output)


class Solver(Displayed):
    """Bundle adjustment of one structure, solved again and again without setting up again.

    The structure is which image sees which point, the cameras' models, what is refined and how it
    is solved, with its factors and bounds. All that follows from it is laid out once: threads,
    unknowns, the order of the elimination, the analysed linear solver, buffers. A solve then starts
    at the values of a problem: poses, camera parameters, points, observed pixels. It takes the
    steps of :func:`bundle.solve`, bit for bit, and spends nearly all of its time in them.
    Exceptions: Ceres on several threads sums in any order; relative priors of ``constraints`` stay
    relative to the problem of the constructor.

    Ceres has no such solver: where ``options.backend`` or ``auto`` means Ceres, each solve starts
    from scratch. Values that make the gauge hold other numbers lay out everything anew; the
    two-level preconditioner forms its clusters by values in each solve.

    A solver pickles as its problem, options, factors and bounds, and is laid out anew when it is
    read; functions of factors have to pickle, too.

    Args:
        problem: the structure, and the values that :meth:`solve` starts from if not given others;
            also a path or a pycolmap.Reconstruction.
        options: how to solve; the defaults of :class:`SolveOptions` if not given. What depends on
            where the problem comes from, or on factors (``gauge``, ``cheirality``), is settled
            here.
        factors: beside the observations, as in :func:`bundle.solve`. What they measured stays as it
            is, in the world of the problem, whatever values a solve starts from.
        bounds: of camera parameters, as in :func:`bundle.solve`. Every solve starts within them.
        constraints: rules, as in :func:`bundle.solve`. What they say of the start they say of the
            values of this problem; parameters that are one number start as one.
        **changes: options by name, in place of those in ``options``.

    Raises:
        KeyboardInterrupt, MemoryError, InputError, OSError: as :func:`bundle.solve`.
    """

    def __init__(
        self,
        problem: Source,
        options: SolveOptions | None = None,
        *,
        factors: Iterable[Factor] = (),
        bounds: Mapping[tuple[str, int], tuple[ArrayLike, ArrayLike]] | None = None,
        constraints: Constraints | Iterable[str | Rule] | Applied = (),
        **changes: Any,
    ) -> None:
        problem = as_problem(problem)
        options = SolveOptions.of(options, changes, "Solver")
        problem, options, applied = constrained(problem, options, constraints)
        self._problem, self._bounds = problem, bounds
        factors = _listed(factors)
        self._options, known, self._limits = settle(problem, options, factors, bounds, applied)
        self._factors = factors if known is None else known.factors[: len(factors)]
        given = None if known is None else known.core()
        self._core = _core.Solver(problem, self._options.asdict(), self._limits, given)

    @property
    def problem(self) -> Problem:
        """The problem that the solver was made for."""
        return self._problem

    @property
    def options(self) -> SolveOptions:
        """Every option as used where :meth:`solve` does not change it."""
        return self._options

    @property
    def factors(self) -> tuple[Factor, ...]:
        """Those beside the observations."""
        return self._factors

    @property
    def bounds(self) -> dict[tuple[str, int], tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Of the cameras with a bound: {("camera", camera_id): (lower, upper)}."""
        if self._limits is None or self._limits.bounds is None:
            return {}
        return self._limits.bounds.given(self._problem)

    @property
    def constraints(self) -> Constraints:
        """The rules."""
        from bundle.solving.constraints.rule_list import Constraints

        return Constraints(() if self._applied is None else self._applied.rules)

    @property
    def _applied(self) -> Applied | None:
        return None if self._limits is None else self._limits.applied

    def solve(
        self, problem: Source | None = None, *, progress: Progress | None = None, **changes: Any
    ) -> Result:
        """Refine a problem of this structure, from its values; see :func:`bundle.solve`.

        One solve at a time: threads need a solver each. After any exception the solver can be used
        again.

        Args:
            problem: left untouched; the one of the constructor if not given. Its poses, camera
                parameters, points and observed pixels are free; all else that a solve looks at has
                to be the same.
            progress: as in :func:`bundle.solve`.
            **changes: for this solve alone: ``loss``, ``loss_scale``, ``max_num_iterations``,
                ``function_tolerance``, ``gradient_tolerance``, ``parameter_tolerance``,
                ``check_solution``.

        Raises:
            InputError: the problem has another structure, a camera parameter that is not within
                its bounds or values at which a factor has none, an option is none of these, or the
                solver is in use.
            KeyboardInterrupt, MemoryError, OSError: as :func:`bundle.solve`.
        """
        problem = self._problem if problem is None else as_problem(problem)
        check_function("progress", progress)
        options = self._options
        if changes:
            options = SolveOptions.of(options, changes, "Solver.solve")
            for name in changes:
                if name not in CHANGEABLE:
                    raise InputError(
                        f"{name}: expected one of {', '.join(CHANGEABLE)}, which may differ from "
                        "solve to solve; other options need another Solver"
                    )
        if self._limits is not None and problem is not self._problem:
            self._core.check_structure(problem)
            self._limits.check_start(problem)
        output = self._core.solve(problem, options.asdict() if changes else None, progress)
        if self._factors and options.check_solution:
            output["summary"] = _checked(problem, self._factors, output)
        return result_of(problem, options, output, self._limits)

    def __copy__(self) -> Solver:
        return _make_solver(*self._parts())

    def __deepcopy__(self, _memo: Any) -> Solver:
        return self.__copy__()  # nothing of it ever changes

    def __reduce__(self) -> tuple[Any, ...]:
        for position, factor in enumerate(self._factors):
            _check_pickles(f"factor {position}, {factor.name}", factor)
        return _make_solver, self._parts()

    def _parts(self) -> tuple[Any, ...]:
        applied = () if self._applied is None else self._applied
        return self._problem, self._options, self._factors, self.bounds, applied

    def _display(self) -> Display:
        changed = repr(self._options).partition("(")[2].rstrip(")")
        facts = [("problem", contents(self._problem)), ("options", changed or "defaults")]
        if self._factors:
            facts.append(("factors", f"{len(self._factors)}"))
        if self.bounds:
            facts.append(("bounds", f"of {plural(len(self.bounds), 'camera')}"))
        if self._applied is not None:
            facts.append(("constraints", plural(len(self._applied.rules), "rule")))
        return Display(title="Solver", facts=tuple(facts))


def _make_solver(
    problem: Problem,
    options: SolveOptions,
    factors: Iterable[Factor],
    bounds: Any,
    constraints: Any = (),
) -> Solver:
    return Solver(problem, options, factors=factors, bounds=bounds, constraints=constraints)


def _check_pickles(name: str, factor: Factor) -> None:
    """Raise an InputError if the factor is a function in Python that does not pickle."""
    function = getattr(factor, "function", None)
    if function is None:
        return
    import pickle

    try:
        pickle.dumps(function)
    except Exception as error:
        raise InputError(
            f"{name}: expected a function that pickles, as those of a module do, "
            f"found {brief(function)} ({first_line(error)})"
        ) from None


def result_of(
    problem: Problem,
    options: SolveOptions,
    output: dict[str, Any],
    limits: Restrictions | None = None,
) -> Result:
    """Return the result of what the core made of a problem."""
    refined = problem._moved(**{name: output[name] for name in STATE if name in output})
    result = Result(
        problem=refined,
        initial_problem=problem,
        options=options,
        factor_costs_before=output["factor_costs_before"],
        factor_costs_after=output["factor_costs_after"],
        active_bounds=() if limits is None else limits.active(refined),
        constraints=() if limits is None else limits.ends(problem, refined),
        **record_fields(output),
    )
    sentence = weak_baseline(result)
    if sentence is None:
        return result
    summary = result.summary
    return dataclasses.replace(
        result,
        summary=dataclasses.replace(
            summary,
            warnings=(*summary.warnings, sentence),
            warning_kinds=(*summary.warning_kinds, "weak_baseline"),
        ),
    )


def with_priors(result: Result, start: Start, given: Problem) -> Result:
    """Return the result of a solve of a start as one of the problem given."""
    if start.problem is given and start.targets is None:
        return result
    refined = start.result(result.problem)
    return dataclasses.replace(
        result,
        problem=refined,
        initial_problem=given,
        similarity=start.similarity,
        control_points=start.control_points(refined),
    )


class Prepared(NamedTuple):
    """What a solve with priors, factors and rules begins with.

    Attributes:
        placed: the problem in the frame of the priors.
        start: the same as the rules have it.
        options: nothing left to choose.
        known: the factors, those of priors and rules too; None without any.
        limits: bounds, and what the rules hold and tie; None without any.
    """

    placed: Start
    start: Problem
    options: SolveOptions
    known: ProblemFactors | None
    limits: Restrictions | None

    def core_factors(self) -> Any:
        """Return the factors as the core takes them."""
        return None if self.known is None else self.known.core()


def prepare(
    problem: Problem,
    options: SolveOptions,
    factors: Iterable[Factor],
    priors: Iterable[Prior],
    align: bool | None,
    bounds: Mapping[tuple[str, int], tuple[ArrayLike, ArrayLike]] | None,
    constraints: Constraints | Iterable[str | Rule] | Applied,
) -> Prepared:
    """Place a problem at its priors, apply the rules, check factors and fill in the options."""
    placed = place_at_priors(problem, factors, priors, align)
    start, options, applied = constrained(placed.problem, options, constraints)
    return Prepared(placed, start, *settle(start, options, placed.factors, bounds, applied))


def settle(
    problem: Problem,
    options: SolveOptions,
    factors: Iterable[Factor],
    bounds: Mapping[tuple[str, int], tuple[ArrayLike, ArrayLike]] | None,
    applied: Applied | None = None,
) -> tuple[SolveOptions, ProblemFactors | None, Restrictions | None]:
    """Check factors and bounds, add what the rules say, and fill in the options."""
    if applied is not None and applied.factors:
        factors = [*_listed(factors), *applied.factors]
    known = _problem_factors(problem, factors)
    locate = (known is not None and known.locate) or (applied is not None and applied.locate)
    if locate and options.gauge == "auto":
        options = options.replace(gauge="none")
    limits = Restrictions.make(problem, bounds, applied)
    return resolve_defaults(problem, options), known, limits


def constrained(
    problem: Problem,
    options: SolveOptions,
    constraints: Constraints | Iterable[str | Rule] | Applied,
    part: Mapping[str, Set[int]] | None = None,
) -> tuple[Problem, SolveOptions, Applied | None]:
    """Return the start, the options and what the rules mean there; None without rules.

    ``part``: ids of the cameras, images and points that are refined, where these are not all.
    """
    if isinstance(constraints, tuple | list) and not constraints:
        return problem, options, None
    from bundle.solving.constraints.applied import Applied
    from bundle.solving.constraints.resolve import apply

    if isinstance(constraints, Applied):  # by the caller, for another start
        return problem, options, constraints
    start, applied = apply(constraints, problem, options, part)
    if applied is not None and applied.fixed_point_ids:
        held = (*options.fixed_point_ids, *applied.fixed_point_ids)
        options = options.replace(fixed_point_ids=held)
    return start, options, applied


def _listed(factors: Iterable[Factor]) -> tuple[Factor, ...]:
    if isinstance(factors, tuple | list):
        return tuple(factors)
    from bundle.graphs.factors.variables import as_list

    return tuple(as_list("factors", "factors", factors))


def _problem_factors(problem: Problem, factors: Iterable[Factor]) -> ProblemFactors | None:
    """Return the factors; their modules are imported only where there are some."""
    if isinstance(factors, tuple | list) and not factors:
        return None
    from bundle.graphs.factors.problem_factors import ProblemFactors

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
        num_threads=min(options.num_threads or threads_of_one_process(cores), cores),
    )
