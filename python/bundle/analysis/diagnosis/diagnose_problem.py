"""Diagnosis of a problem: rank, conditioning, components, points and images.

Points that the observations determine weakly: let u_i be the unit vectors of the rays from the
camera centres to a point. They differ by at most 2 max |u_i - mean u| and by at least max |u_i -
mean u|. For small values this is an angle. The bound avoids a loop over all pairs of rays.

A solve can shrink a loosely connected part of a scene until its points lie on its cameras. Their
depths are then orders of magnitude below the others. All parts connected to such points move with
them, so a connected component is one cluster of collapsed points.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

import bundle._core as _core
from bundle.analysis.diagnosis.diagnose_graph import diagnose_graph
from bundle.analysis.diagnosis.diagnosis_result import CollapsedCluster, Component, Diagnosis
from bundle.analysis.diagnosis.findings import EquationCounts, Unknowns, findings, scale_drift
from bundle.analysis.diagnosis.modes import component_modes, null_modes, rotation_modes, weak_modes
from bundle.analysis.diagnosis.shutter_modes import shutter_modes
from bundle.analysis.diagnosis.track_table import FEW_SHARED, TrackTable
from bundle.analysis.factor_equations import diagnose_factor_graph, with_keys
from bundle.analysis.statistics.suspicions import collapsed_observations, depths_of_observations
from bundle.base.words import sorted_ids
from bundle.graphs.factors.factor_graph import FactorGraph
from bundle.graphs.factors.same_problem import pose_graph_of, problem_of
from bundle.graphs.pose_graphs.edge_weights import is_graph, refuse_for_graphs
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
from bundle.interface.analysis_options import DELTA0
from bundle.interface.finding import one_list
from bundle.interface.option_class import takes_options
from bundle.interface.options import SolveOptions
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.io.files import Source, as_problem
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.problem import Problem
from bundle.solving.gauge_freedom import gauge_freedom_of
from bundle.solving.prepare import prepare
from bundle.solving.request import SolveRequest
from bundle.solving.result import Result

if TYPE_CHECKING:
    from bundle.georeference.measurements import Prior
    from bundle.graphs.factors.factors import Factor
    from bundle.interface.option_keywords import PoseGraphKeywords, SolveKeywords
    from bundle.solving.constraints.ends import Applied
    from bundle.solving.constraints.rule_list import Constraints
    from bundle.solving.constraints.rules import Rule

FEW_OBSERVATIONS = 10
"""Number of observations below which the pose of an image is poorly determined."""


@overload
def diagnose(
    problem: PoseGraph | PoseGraphResult,
    options: PoseGraphOptions | None = None,
    **changes: Unpack[PoseGraphKeywords],
) -> Diagnosis: ...


@overload
def diagnose(
    problem: Source | Result | FactorGraph,
    options: SolveOptions | None = None,
    *,
    factors: Iterable[Factor] = (),
    priors: Iterable[Prior] = (),
    align: bool | None = None,
    bounds: Mapping[tuple[str, int], tuple[ArrayLike, ArrayLike]] | None = None,
    constraints: Constraints | Iterable[str | Rule] | Applied = (),
    reliability: bool = False,
    delta0: float = DELTA0,
    **changes: Unpack[SolveKeywords],
) -> Diagnosis: ...


@takes_options(SolveOptions)
def diagnose(
    problem: Source | Result | PoseGraph | PoseGraphResult | FactorGraph,
    options: SolveOptions | PoseGraphOptions | None = None,
    *,
    factors: Iterable[Factor] = (),
    priors: Iterable[Prior] = (),
    align: bool | None = None,
    bounds: Mapping[tuple[str, int], tuple[ArrayLike, ArrayLike]] | None = None,
    constraints: Constraints | Iterable[str | Rule] | Applied = (),
    reliability: bool = False,
    delta0: float = DELTA0,
    **changes: Any,
) -> Diagnosis:
    """Find the determined and undetermined parameters of a problem at its current values.

    The points are eliminated; points without parallax are removed exactly. The resulting reduced
    camera system is scaled to a unit diagonal. Its null directions are compared with the
    translations, rotations and scaling of the world. Null directions beyond these, and weak
    directions, are named with the parameters that move and the cause. The problem is not solved.
    The diagnosis uses the linearisation at these values, so a problem far from its solution may
    look better or worse than at the solution.

    For a pose graph, the result of its solve, or a g2o file, the diagnosis has the rank from the
    information of the edges, weak joints by pose and edge, condition numbers, and edges that the
    others contradict. ``options`` are then
    :class:`bundle.PoseGraphOptions`, of which error, information and loss have an effect. The
    result of a solve is diagnosed with its own options and the final weights of the solve.

    A :class:`FactorGraph` of relative poses or of reprojections is diagnosed as the pose graph or
    the problem that it represents. Any other factor graph has keys in place of ids and factors in
    place of edges.

    Args:
        problem: a problem, the result of a solve, a path or a pycolmap.Reconstruction; not
            modified.
        options: refined and fixed parameters, and the loss, as in :func:`bundle.solve`; a result
            uses its own options. The gauge is free unless it is set to another value than "auto".
        factors: factors in addition to the observations, as in :func:`bundle.solve`.
        priors: measured positions and control points, as in :func:`bundle.solve`.
        align: as in :func:`bundle.solve`.
        bounds: as in :func:`bundle.solve`.
        constraints: as in :func:`bundle.solve`.
        reliability: also compute :func:`bundle.reliability`; only for reconstructions.
        delta0: as in :func:`bundle.reliability`.
        **changes: options by name, which replace those in ``options``.

    Raises:
        InputError: as :func:`bundle.solve`.
        OSError: the path cannot be read.

    Example:
        >>> bundle.diagnose("sparse/0").nullity
        7
    """
    if isinstance(problem, FactorGraph):
        return _diagnose_factor_graph(
            problem,
            changes,
            options=options,
            factors=factors,
            priors=priors,
            align=align,
            bounds=bounds,
            constraints=constraints,
            reliability=reliability or None,
        )
    if is_graph(problem):
        refuse_for_graphs(
            factors=factors,
            priors=priors,
            align=align,
            bounds=bounds,
            constraints=constraints,
            reliability=reliability or None,
        )
        return diagnose_graph(problem, options, **changes)  # type: ignore[arg-type]
    drift = None
    if isinstance(problem, Result):
        drift = scale_drift(problem)
        options = problem.options.replace(gauge="auto") if options is None else options
        problem = problem.problem
    problem = as_problem(problem)  # type: ignore[arg-type]
    options = SolveOptions.of(options, changes, "diagnose")
    if options.gauge == "auto":
        options = options.replace(gauge="none")
    prepared = prepare(
        SolveRequest(
            problem=problem,
            options=options,
            factors=factors,
            priors=priors,
            align=align,
            bounds=bounds,
            constraints=constraints,
        )
    )
    start, layout = prepared.start, prepared.layout
    options = layout.options

    tracks = TrackTable(start)
    found = _core.reduced_spectrum(
        start, options.asdict(), tracks.pieces, layout.limits, layout.core_factors()
    )
    expected = int(found["expected_nullity"])
    if layout.known is not None:
        # For several components, gauge_freedom would count all.
        is_apart = tracks.pieces.max(initial=-1) > 0
        expected = int(found["num_gauge"])
        if not is_apart:
            known, rules = layout.known.factors, prepared.applied
            expected = gauge_freedom_of(start, prepared.options, known, rules).degrees
    unknowns = Unknowns(start, found)
    collapsed = collapsed_clusters(start, tracks)
    counts = EquationCounts(unknowns, tracks)
    modes = null_modes(unknowns, found["null_directions"], tracks, collapsed, counts)
    components = _components(start, tracks)
    apart = component_modes(start, tracks, components)
    is_loose = found["nullity"] > expected
    short = {mode.image_ids for mode in modes if mode.kind == "underdetermined"}
    turning = [
        mode for mode in rotation_modes(start, tracks, counts) if mode.image_ids not in short
    ]
    modes = [*(apart if is_loose else ()), *turning, *modes]
    modes += weak_modes(unknowns, found["eigenvalues"], found["directions"], tracks, modes)
    # With ties, the poses of the neighbours determine the twists.
    if options.twists == "free" and layout.known is None and "poses" in options.refine:
        of_twists = shutter_modes(start)
        unnamed = "undetermined_poses" if of_twists else ""
        modes = [mode for mode in modes if mode.kind != unnamed] + of_twists
    points = check_points(start, tracks)
    null = np.asarray(found["null_points"], np.int64)
    # Any ray fits a point at a camera; this differs from points whose rays are parallel.
    parallel = np.setdiff1d(
        start.point_ids[null[tracks.lengths[null] > 1]], points["points_at_cameras"]
    )
    parts: dict[str, Any] = {
        "nullity": int(found["nullity"]),
        "expected_nullity": expected,
        "nullity_is_exact": bool(found["nullity_is_exact"]),
        "components": components,
        "weak_modes": tuple(modes),
        "points_without_parallax": parallel,
        "collapsed": collapsed,
        "condition_number": _condition(found),
        "condition_number_unscaled": float(found["condition_number_unscaled"]),
        "eigenvalues": found["eigenvalues"],
        "max_null_eigenvalue": float(found["max_null_eigenvalue"]),
        **points,
        "points_seen_once": np.setdiff1d(points["points_seen_once"], _held_points(start, options)),
        "points_at_infinity": np.setdiff1d(points["points_at_infinity"], parallel),
        "images_with_few_observations": start.image_ids[_observations(start) < FEW_OBSERVATIONS],
        "images_with_few_shared_points": start.image_ids[
            (tracks.shared < FEW_SHARED) & (_observations(start) > 0) & ~_held(start, options)
        ],
    }
    bare = Diagnosis(**parts, findings=())
    said = findings(bare, start, tracks, found, apart, drift)
    if reliability:
        from bundle.analysis.uncertainty.reliability import reliability_of  # on request only

        parts["reliability"] = reliability_of(prepared, delta0)
        said = one_list(said, parts["reliability"].findings)
    return Diagnosis(**parts, findings=said)


def _diagnose_factor_graph(graph: FactorGraph, changes: dict[str, Any], **given: Any) -> Diagnosis:
    """Diagnose the pose graph or problem that a factor graph represents, otherwise the graph."""
    threads = SolveOptions.of(None, changes, "diagnose").num_threads
    refuse_for_graphs(
        **given, **{name: value for name, value in changes.items() if name != "num_threads"}
    )
    if (poses := pose_graph_of(graph)) is not None:
        return with_keys(diagnose_graph(poses.graph, num_threads=threads), poses)
    if (same := problem_of(graph)) is not None:
        return diagnose(same.problem, same.options.replace(num_threads=threads))
    return diagnose_factor_graph(graph, threads)


def _held(problem: Problem, options: SolveOptions) -> NDArray[np.bool_]:
    """Return the mask of images with constant poses."""
    if "poses" not in options.refine:
        return np.ones(problem.num_images, bool)
    return np.asarray(np.isin(problem.image_ids, options.fixed_image_ids))


def _held_points(problem: Problem, options: SolveOptions) -> NDArray[np.int64]:
    """Return the ids of constant points."""
    if "points" not in options.refine:
        return problem.point_ids
    return np.array(options.fixed_point_ids, np.int64)


def _components(problem: Problem, tracks: TrackTable) -> tuple[Component, ...]:
    pieces = tracks.pieces
    of_point = np.full(problem.num_points, -1)
    of_point[tracks.points] = pieces[tracks.images]
    return tuple(
        Component(
            image_ids=tuple(sorted(problem.image_ids[pieces == piece].tolist())),
            num_points=int((of_point == piece).sum()),
        )
        for piece in range(pieces.max(initial=-1) + 1)
    )


def _condition(found: dict[str, Any]) -> float:
    values = found["eigenvalues"]
    return float(found["max_eigenvalue"] / values[0]) if len(values) else math.nan


def _observations(problem: Problem) -> NDArray[np.int64]:
    return np.bincount(problem.observation_image, minlength=problem.num_images)


AT_CAMERA = 1e-6  # share of the median distance of points from their cameras
PARALLEL = 1e-4
"""Limit in radians; rays with smaller differences put a point beyond ten thousand baselines."""

Ids = NDArray[np.int64]


def check_points(problem: Problem, tracks: TrackTable) -> dict[str, Ids]:
    """Return the ids of deficient points, by the fields of :class:`bundle.Diagnosis`."""
    lengths, images, points = tracks.lengths, tracks.images, tracks.points
    rays = problem.points[points] - problem.projection_centers[images]
    distances = np.linalg.norm(rays, axis=1)
    usual = float(np.median(distances)) if len(distances) else 0.0
    at_camera = np.zeros(problem.num_points, bool)
    at_camera[points[distances <= AT_CAMERA * usual]] = True
    far = np.zeros(problem.num_points, bool)
    if len(points):
        rays /= np.maximum(distances, np.finfo(float).tiny)[:, None]
        starts = np.flatnonzero(np.diff(points, prepend=-1))
        counts = np.diff(starts, append=len(points))
        mean = np.add.reduceat(rays, starts) / counts[:, None]
        off = np.linalg.norm(rays - np.repeat(mean, counts, axis=0), axis=1)
        spread = np.maximum.reduceat(off, starts)
        far[points[starts]] = (spread < PARALLEL / 2) & (counts > 1)
    ids = problem.point_ids
    return {
        "unobserved_points": ids[lengths == 0],
        "points_seen_once": ids[lengths == 1],
        "points_seen_twice": ids[lengths == 2],
        "points_at_cameras": ids[at_camera],
        "points_at_infinity": ids[far & ~at_camera],
    }


def collapsed_clusters(problem: Problem, tracks: TrackTable) -> tuple[CollapsedCluster, ...]:
    """Return the clusters of collapsed points, the one with the most observations first."""
    mask = collapsed_observations(problem, depths_of_observations(problem))
    chosen = np.flatnonzero(mask)
    if not len(chosen):
        return ()
    images, points = problem.observation_image[chosen], problem.observation_point[chosen]
    piece = tracks.pieces[images]
    clusters = []
    for one in np.unique(piece).tolist():
        own = piece == one
        clusters.append(
            CollapsedCluster(
                point_ids=sorted_ids(problem.point_ids, np.unique(points[own])),
                image_ids=sorted_ids(problem.image_ids, np.unique(images[own])),
                num_observations=int(own.sum()),
            )
        )
    return tuple(sorted(clusters, key=lambda cluster: -cluster.num_observations))
