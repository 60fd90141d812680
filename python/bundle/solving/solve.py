"""Bundle adjustment of a problem: the public function."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Unpack, overload

from numpy.typing import ArrayLike

from bundle.base.arguments import check_function
from bundle.errors import InputError, brief
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
from bundle.graphs.pose_graphs.solve_pose_graph import solve_pose_graph
from bundle.interface.option_class import takes_options
from bundle.interface.option_keywords import PoseGraphKeywords, SolveKeywords
from bundle.interface.options import SolveOptions
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.interface.solve_record import Progress
from bundle.io.files import Source, as_problem
from bundle.io.g2o_files import load_g2o
from bundle.io.recognition import is_pose_graph_file
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.solving.executors import solve_prepared
from bundle.solving.prepare import prepare
from bundle.solving.request import SolveRequest
from bundle.solving.result import Result

if TYPE_CHECKING:
    from bundle.graphs.factors.factors import Factor
    from bundle.solving.constraints.applied import Applied
    from bundle.solving.constraints.rule_list import Constraints
    from bundle.solving.constraints.rules import Rule
    from bundle.solving.placed_problem import Prior

__all__ = ["solve"]


@overload
def solve(
    problem: PoseGraph,
    options: PoseGraphOptions | None = None,
    *,
    progress: Progress | None = None,
    **changes: Unpack[PoseGraphKeywords],
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
    **changes: Unpack[SolveKeywords],
) -> Result: ...


@takes_options(SolveOptions)
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
    prepared = prepare(
        SolveRequest(
            problem=problem,
            options=options,
            factors=factors,  # type: ignore[arg-type]
            priors=priors,  # type: ignore[arg-type]
            align=align,
            bounds=bounds,
            constraints=constraints,
        )
    )
    return prepared.finished(solve_prepared(prepared, progress))
