"""Facts of a pose graph or a factor graph for its page, in one form for both.

The expected chi2 of an edge is its redundancy, the part of its errors that other edges check
(``analysis/diagnosis``): a fit of edges with right information has chi2 about equal to it. Edges
without a known redundancy have no expected chi2.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.analysis.diagnosis.diagnose_problem import diagnose
from bundle.analysis.diagnosis.diagnosis_result import Diagnosis
from bundle.base.records import dataclass
from bundle.base.words import change, number, plural
from bundle.errors import InputError, brief
from bundle.graphs.factors.factor_graph import FactorGraph, GraphResult
from bundle.graphs.factors.factors import PositionFactor, RelativePoseFactor, ReprojectionFactor
from bundle.graphs.pose_graphs.edge_weights import pose_graph_chi2
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.rigid_motions import rotation_matrices
from bundle.planning.inspection.elimination_costs import FactorGraphInspection
from bundle.planning.inspection.problem_inspection import inspect
from bundle.reports.terminal.graph_headline import degrees_of_freedom, graph_headline
from bundle.reports.terminal.inputs import contents_of

Floats = NDArray[np.float64]

ODOMETRY, CLOSURE = "odometry", "closure"
"""Kinds of the edges of a pose graph."""

CAM_FROM_WORLD = (PositionFactor, RelativePoseFactor, ReprojectionFactor)


@dataclass(frozen=True, eq=False, kw_only=True)
class GraphFacts:
    """Variables with positions, edges with errors, and analyses of a graph.

    Positions are (n, 2) or (n, 3), NaN for a variable without one; ``rotations`` are (n, 3, 3)
    world_from_body, identity where unknown; ``ends`` are the (m, 2) first and last variables of
    edges. ``chi2`` is r^T Omega r of each edge, ``sizes`` its number of residuals. Values before a
    solve are None or NaN without one, costs by iteration empty; a diagnosis or inspection that
    fails is None.
    """

    noun: str
    headline: Sequence[str]
    contents: str
    positions: Floats
    before: Floats | None
    rotations: Floats
    ends: NDArray[np.int64]
    names: Sequence[str]
    kinds: NDArray[np.str_]
    chi2: Floats
    chi2_before: Floats
    sizes: NDArray[np.int64]
    diagnosis: Diagnosis | None
    inspection: FactorGraphInspection | None
    costs: Floats

    @property
    def dimension(self) -> int:
        """Dimension of the positions: 2 or 3."""
        return int(self.positions.shape[1])

    @property
    def is_placed(self) -> NDArray[np.bool_]:
        """(n,) True for a variable with a position."""
        return np.asarray(np.isfinite(self.positions).all(axis=1))


def facts_of_pose_graph(source: PoseGraph | PoseGraphResult) -> GraphFacts:
    """Return the facts of a pose graph or of the result of its solve."""
    result = source if isinstance(source, PoseGraphResult) else None
    graph = result.problem if result is not None else source
    assert isinstance(graph, PoseGraph)
    if result is None:
        chi2, before = np.asarray(pose_graph_chi2(graph)), np.full(graph.num_edges, np.nan)
        total, degrees = float(chi2.sum()), max(degrees_of_freedom(graph), 1)
        per_degree = f"{number(total / degrees)} per degree of freedom (a minimum has about 1)"
        headline = [f"chi2 {number(total)} as given, {per_degree}."]
    else:
        chi2, before, headline = result.chi2_after, result.chi2_before, graph_headline(result)
    lines = graph.edge_lines.tolist()
    return GraphFacts(
        noun="edge",
        headline=headline,
        contents=contents_of(graph),
        positions=_places(graph.poses),
        before=None if result is None else _places(result.initial_problem.poses),
        rotations=_rotations(graph.poses),
        ends=graph.edges.astype(np.int64),
        names=[
            " ".join(graph.ends_of(k)) + (f" (line {line})" if line else "")
            for k, line in enumerate(lines)
        ],
        kinds=np.where(graph.is_closure, CLOSURE, ODOMETRY),
        chi2=chi2,
        chi2_before=before,
        sizes=np.full(graph.num_edges, graph.tangent_size),
        diagnosis=_analysed(lambda: diagnose(source)),
        inspection=_analysed(lambda: inspect(graph)),
        costs=np.zeros(0) if result is None else np.asarray(result.iterations["cost"]),
    )


def facts_of_factor_graph(graph: FactorGraph, result: GraphResult | None) -> GraphFacts:
    """Return the facts of a factor graph, at the values of a result if there is one."""
    graph.check_free()
    solved = graph if result is None else graph.with_values(result.values)
    costs, chi2, sizes = _core.factor_costs(*solved.core())
    before = np.full(len(chi2), np.nan)
    counts = f"{plural(len(graph.variables), 'variable')}, {plural(len(graph.factors), 'factor')}"
    if result is None:
        headline = [f"Cost now {number(float(costs.sum()))}."]
    else:
        _, before, _ = _core.factor_costs(*graph.core())
        summary = result.summary
        headline = [
            f"{result.outcome}: cost {change(summary.initial_cost, summary.final_cost)}.",
            *summary.warnings,
        ]
    place = {key: k for k, key in enumerate(graph.keys)}
    positions, rotations = _of_variables(solved)
    return GraphFacts(
        noun="factor",
        headline=headline,
        contents=counts,
        positions=positions,
        before=None if result is None else _of_variables(graph)[0],
        rotations=rotations,
        ends=np.array([[place[f.keys[0]], place[f.keys[-1]]] for f in graph.factors]),
        names=[", ".join(brief(key) for key in factor.keys) for factor in graph.factors],
        kinds=np.array([type(factor).__name__ for factor in graph.factors]),
        chi2=chi2,
        chi2_before=before,
        sizes=sizes,
        diagnosis=_analysed(lambda: diagnose(solved)),
        inspection=_analysed(lambda: inspect(graph)),
        costs=np.zeros(0) if result is None else np.asarray(result.iterations["cost"]),
    )


def _analysed(analyse: Any) -> Any:
    try:
        return analyse()
    except InputError:
        return None


def _places(poses: Floats) -> Floats:
    return poses[:, :2] if poses.shape[1] == 3 else poses[:, 4:]


def _rotations(poses: Floats) -> Floats:
    if poses.shape[1] == 7:
        return rotation_matrices(poses[:, :4])
    c, s, found = np.cos(poses[:, 2]), np.sin(poses[:, 2]), np.tile(np.eye(3), (len(poses), 1, 1))
    found[:, 0, 0] = found[:, 1, 1] = c
    found[:, 1, 0], found[:, 0, 1] = s, -s
    return found


def _of_variables(graph: FactorGraph) -> tuple[Floats, Floats]:
    """Return positions (2-D or 3-D) and rotations of poses and points."""
    variables = list(graph.variables.values())
    is_planar = not any(variable.manifold == "se3" for variable in variables)
    size = 2 if is_planar else 3
    pose = "se2" if is_planar else "se3"
    from_world = {
        factor.keys[0] for factor in graph.factors if isinstance(factor, CAM_FROM_WORLD)
    } | {f.keys[1] for f in graph.factors if isinstance(f, RelativePoseFactor)}
    touched = {key for factor in graph.factors if len(factor.keys) > 1 for key in factor.keys}
    positions = np.full((len(variables), size), np.nan)
    rotations = np.tile(np.eye(3), (len(variables), 1, 1))
    for k, variable in enumerate(variables):
        if variable.manifold == pose:
            positions[k] = _places(variable.value[None])[0]
            rotations[k] = _rotations(variable.value[None])[0]
            if variable.key in from_world:
                rotations[k] = rotations[k].T
                positions[k] = -rotations[k] @ positions[k]
        elif variable.manifold == "euclidean" and len(variable.value) == size:
            positions[k] = variable.value if variable.key in touched else np.nan
    return positions, rotations
