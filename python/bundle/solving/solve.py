"""Bundle adjustment of a problem: the public function ``solve``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Unpack, overload

from numpy.typing import ArrayLike

from bundle.base.arrays import check_function
from bundle.errors import InputError, brief
from bundle.interface.option_class import takes_options
from bundle.interface.options import SolveOptions
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.interface.solve_record import Progress
from bundle.io.files import Source, as_problem
from bundle.io.g2o_files import load_g2o
from bundle.io.recognition import is_pose_graph_file
from bundle.model.pose_graph_arrays import PoseGraph

if TYPE_CHECKING:
    from bundle.georeference.measurements import Prior
    from bundle.graphs.factors.factors import Factor
    from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
    from bundle.interface.option_keywords import PoseGraphKeywords, SolveKeywords
    from bundle.solving.constraints.ends import Applied
    from bundle.solving.constraints.rule_list import Constraints
    from bundle.solving.constraints.rules import Rule
    from bundle.solving.result import Result


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
    hold_out: float = 0.0,
    hold_out_seed: int = 0,
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
    hold_out: float = 0.0,
    hold_out_seed: int = 0,
    progress: Progress | None = None,
    **changes: Any,
) -> Result | PoseGraphResult:
    """Refine a problem: minimise 1/2 sum rho(||r||^2) over the variables in ``options.refine``.

    r is the reprojection error of an observation in pixels, rho the loss. The GIL is released while
    the solver runs. Ctrl-C stops the solver, even within a step, except in Ceres' own linear
    solvers. The result then holds the best state and ``summary.interrupted``. A solve that does not
    converge also returns a result and raises no exception.

    Each factor adds its own cost 1/2 rho(||r||^2), with r whitened and rho the factor's loss. Keys
    of factors name variables of the problem:

    - ``("image", image_id)``: cam_from_world on se3, qx qy qz qw tx ty tz. Its tangent coordinates
      are rotation, then translation, in the frame of cam_from_world, as in
      :class:`bundle.FactorGraph`.
    - ``("camera", camera_id)``: parameters of the camera in COLMAP's order, Euclidean.
    - ``("point", point_id)``: coordinates of the point, Euclidean.
    - ``("frame", frame_id)``: rig_from_world of a rig's frame, on se3 as for images.
    - ``("sensor", (rig_id, camera_id))``: sensor_from_rig, on se3 as for images.

    This example adds measured positions of the images' centres with a sigma of 2 cm::

        factors = [bundle.PositionFactor(("image", i), xyz, 1 / 0.02**2) for i, xyz in gps.items()]
        bundle.solve(problem, factors=factors)

    Poses of images are cam_from_world. Use a :class:`bundle.RelativePoseFactor` for a relative pose
    of two images. Variables of factors are refined even if they have no observation. Constant
    variables stay constant; the cost includes their factors.

    Both backends support factors of images, rigs, cameras, or a single point. Only Ceres supports
    Python functions, and factors that couple a point with another refined variable. With factors of
    images or points, gauge "auto" fixes nothing: the factors determine the gauge in full or in
    part, and the damping of the trust region controls the remaining directions. "two_cameras" and
    "three_points" fix the gauge that would be free without the factors, and warn
    (``gauge_beside_factors``). Factors always use the world frame of the problem, even if a far
    scene is solved about its centre.

    Priors of positions are factors, too. A reconstruction has an arbitrary frame. Therefore the
    problem is first moved by the similarity that the priors determine robustly (``similarity`` of
    the result). Constant images and points move as well::

        priors = [bundle.PositionPrior(name, enu, (2, 5)) for name, enu in gps.items()]
        bundle.solve(problem, priors=priors)

    Priors of attitudes (:class:`bundle.GravityPrior`, :class:`bundle.OrientationPrior`,
    :class:`bundle.HeadingPrior`) refer to a world of east, north, up. Without positions, the
    problem is first rotated robustly to fit them, about the middle of its cameras; its position and
    scale do not change.

    Priors of velocities (:class:`bundle.VelocityPrior`) constrain the twists of images with rolling
    shutters. They refer to the same world, but move nothing: without positions, the problem must
    already have its axes and its length unit.

    Ground control points (:class:`bundle.GroundControlPoint`, coordinates in the same frame and in
    metres) are priors as well. Each becomes a point of the solve. Its surveyed position is a prior
    and its pixels are observations, each with its own sigma. Control points help to determine the
    similarity, and are not among the points of the result. Check points have no influence.
    ``control_points`` of the result has the residuals of all of them to the survey::

        known = bundle.georeference.gcp_priors(problem, "gcp_list.txt")
        bundle.solve(problem, priors=known.priors).control_points

    For a :class:`bundle.PoseGraph`, the poses are refined, the options are those of
    :class:`bundle.PoseGraphOptions`, and the result is a :class:`bundle.PoseGraphResult`. Fixed
    poses stay. In a connected component without a fixed pose, the first pose is constant::

        bundle.solve("x.g2o", init="chordal", error="log").summary.chi2_final

    Args:
        problem: the problem, which is not changed; also the path of a reconstruction or of a pose
            graph, or a pycolmap.Reconstruction.
        options: solve options; the defaults of :class:`SolveOptions` if not given.
        factors: factors in addition to the observations, such as :class:`bundle.PriorFactor`.
        priors: measured positions, attitudes and velocities of images, and control points. Their
            costs come after those of the factors: positions, attitudes, control points, velocities.
        align: True to move the problem to its priors first. None: move it if there are no factors,
            and at least three positions and control points that do not lie on one line, two beside
            gravity or orientations, or attitudes without positions.
        constraints: rules that fix, bound or share parameters or add priors, such as
            ``"cameras *: f prior 2 %"`` (:class:`bundle.Constraints`). They refer to the problem
            after it was moved to the priors. The costs of their priors come last. ``constraints``
            of the result has the outcome of each rule. With rules about positions or rotations,
            gauge "auto" fixes nothing.
        bounds: ``{("camera", camera_id): (lower, upper)}``, with one number per parameter in
            COLMAP's order, infinite without a bound. The parameter must start between its bounds
            and stays there; equal bounds make it constant. ``active_bounds`` of the result lists
            the bounds that parameters reach.
        hold_out: share of the observations in percent that a second fit does not see; 0: no second
            fit. It starts at the result. ``held_out`` of the result has its errors at the
            observations that it saw and at those that it did not see. All else in the result is of
            the fit to all observations. :func:`bundle.hold_out` describes the choice.
        hold_out_seed: seed of the choice.
        progress: function called after each iteration with a dict, whose keys are the names of
            Ceres' IterationSummary. An exception of this function stops the solve and is passed on;
            KeyboardInterrupt has the effect of Ctrl-C.
        **changes: options by name, which replace those in ``options``.

    Raises:
        KeyboardInterrupt: Ctrl-C before the start was evaluated; there is no state to return.
        MemoryError: memory, or a limit of memory, is not sufficient.
        InputError: one of these causes.

            - Options: an option or a fixed id does not exist, a camera model is not supported,
              options exclude each other or the requested backend, or dense matrices exceed the
              memory of this machine.
            - Bounds: their camera does not exist, their number of parameters is wrong, or they
              exclude the start.
            - Factors: a key is unknown, numbers do not fit the variables, or the value at the start
              is not finite.
            - Priors: the image does not exist, no control point is measured in two images, or the
              priors do not determine the similarity although ``align`` is True.
            - Rules: a rule names something that the problem does not have, contradicts another rule
              or the options, or excludes the start.
        OSError: the path cannot be read.
    """
    if is_pose_graph_file(problem):
        problem = load_g2o(problem)
    if isinstance(problem, PoseGraph):
        beside = {
            "factors": factors,
            "priors": priors,
            "bounds": bounds,
            "constraints": constraints,
        }
        for name, value in (beside | {"align": align, "hold_out": hold_out or None}).items():
            if value is not None and value != ():
                raise InputError(f"{name}: expected none for a pose graph, found {brief(value)}")
        # The modules of the other kind of problem are most of the time of a first solve.
        from bundle.graphs.pose_graphs.solve_pose_graph import solve_pose_graph

        return solve_pose_graph(problem, options, progress=progress, **changes)  # type: ignore[arg-type]
    from bundle.interface.judging_options import HoldOutOptions
    from bundle.solving.request import SolveRequest
    from bundle.solving.rounds.plan import RunPlan
    from bundle.solving.rounds.solve_rounds import run

    problem = as_problem(problem)
    options = SolveOptions.of(options, changes, "solve")
    check_function("progress", progress)
    held_out = HoldOutOptions(hold_out=hold_out, hold_out_seed=hold_out_seed)
    request = SolveRequest(
        problem=problem,
        options=options,
        factors=factors,
        priors=priors,
        align=align,
        bounds=bounds,
        constraints=constraints,
    )
    return run(request, RunPlan(held_out=held_out), progress)
