"""Headline of a refined pose graph: chi2 before and after, rejected closures, movement.

"Before" is the graph as given. If the solve began at other poses, which it composed from the edges,
a sentence has their chi2. chi2 per degree of freedom is about 1 if the information matrices of the
edges state their errors.
"""

from __future__ import annotations

import numpy as np

from bundle.base.words import number, plural, rounded
from bundle.graphs.pose_graphs.pose_graph_result import ESCAPES, PoseGraphResult
from bundle.interface.summary import short_outcome
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.reports.terminal.certificate_facts import certificate_sentences


def degrees_of_freedom(graph: PoseGraph) -> int:
    """Return the number of measurements in addition to those that determine the poses."""
    return graph.tangent_size * (graph.num_edges - graph.num_poses + graph.num_components)


def graph_headline(solved: PoseGraphResult) -> list[str]:
    """Return the sentences of a result."""
    summary, graph = solved.summary, solved.initial_problem
    if not summary.is_solution_usable and not summary.interrupted:
        return [solved.outcome, "There is no usable solution."]
    done = short_outcome(summary, plural(len(solved.iterations["iteration"]) - 1, "step"))
    edges = plural(graph.num_edges - len(solved.left_out), "edge", grouped=True)
    all_edges = {0: edges, 1: "the only edge"}.get(graph.num_edges, f"all {edges}")
    all_edges = f"the {edges} kept" if solved.left_out else all_edges
    chi2 = f"chi2 {number(summary.chi2_initial)} -> {number(summary.chi2_final)}"
    return [
        f"{done}: {chi2} on {all_edges}{_per_degree(solved)}.",
        *certificate_sentences(solved),
        *_start(solved),
        *_rejected(solved),
        *_movement(solved),
    ]


def _per_degree(solved: PoseGraphResult) -> str:
    degrees = degrees_of_freedom(solved.initial_problem)
    if degrees <= 0 or solved.options.loss != "trivial" or solved.left_out:
        return ""
    return f", {number(solved.summary.chi2_final / degrees)} per degree of freedom"


def _start(solved: PoseGraphResult) -> list[str]:
    summary = solved.summary
    if summary.init in ("file", *ESCAPES):
        return []
    name = summary.init.replace("_", " ")
    other = "the file has no poses"
    if solved.initial_problem.has_poses:
        other = f"chi2 {number(summary.chi2_initial)} -> {number(summary.chi2_start)}"
    return [f"The solve began at poses composed from the edges ({name}): {other}."]


def _rejected(solved: PoseGraphResult) -> list[str]:
    rejected, left_out = len(solved.rejected), len(solved.left_out)
    if not rejected and not left_out:
        return []
    edges = plural(solved.initial_problem.num_edges, "edge", grouped=True)
    said = [f"the loss rejects {rejected:,}"] * bool(rejected)
    said += [f"the test of consistency leaves out {left_out:,}"] * bool(left_out)
    included = "; chi2 includes them" if rejected and not left_out else ""
    return [f"Of {edges}, {' and '.join(said)}{included}."]


def _movement(solved: PoseGraphResult) -> list[str]:
    graph, last = solved.initial_problem, solved.problem
    if not graph.has_poses:
        return []
    first = slice(0, 2) if graph.dimension == 2 else slice(4, 7)
    moved = np.linalg.norm(last.poses[:, first] - graph.poses[:, first], axis=1)
    center = np.median(last.poses[:, first], axis=0)
    extent = 2 * float(np.median(np.linalg.norm(last.poses[:, first] - center, axis=1)))
    middle, most = float(np.median(moved)), rounded(float(moved.max()))
    share = f"; {rounded(100 * middle / extent)} % of the graph" if extent > 0 else ""
    return [f"Poses moved by {rounded(middle)} (median{share}), at most {most}."]
