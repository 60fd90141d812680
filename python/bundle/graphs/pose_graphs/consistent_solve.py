"""Solve of a pose graph without the closures outside the largest consistent set."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arrays import freeze
from bundle.base.words import plural
from bundle.graphs.pose_graphs.consistency import ClosureConsistency, closure_consistency
from bundle.graphs.pose_graphs.information import checked_information
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.model.pose_graph_arrays import PoseGraph

UNPROVEN_SET = "unproven_set"
MOST_LEFT_OUT = "most_left_out"

Floats = NDArray[np.float64]
Solve = Callable[[PoseGraph, PoseGraphOptions], tuple[PoseGraphResult, Floats]]


def solve_consistent(graph: PoseGraph, options: PoseGraphOptions, solve: Solve) -> PoseGraphResult:
    """Solve without the closures outside the largest consistent set; report on all edges.

    Args:
        graph: graph to solve; not modified.
        options: options with ``consistency``.
        solve: function from a graph and options without ``consistency`` to the result and the poses
            at the start.

    Raises:
        InputError: for the reasons of :func:`closure_consistency` or of ``solve``.
    """
    begun = perf_counter()
    weighed = checked_information(graph, options.information)
    found = closure_consistency(weighed, options.num_threads or 1)
    kept = np.ones(graph.num_edges, bool)
    kept[[entry.edge for entry in found.left_out]] = False
    edges = np.flatnonzero(kept)
    check_time = perf_counter() - begun
    solved, start = solve(
        graph.replace(
            edges=graph.edges[edges],
            measurements=graph.measurements[edges],
            information=graph.information[edges],
            edge_lines=graph.edge_lines[edges],
        ),
        options.replace(consistency=False),
    )
    after = _core.edge_chi2(weighed, options.error, solved.problem.poses).copy()
    before = _core.edge_chi2(weighed, options.error, start).copy()
    after[edges], before[edges] = solved.chi2_after, solved.chi2_before
    weights = np.zeros(graph.num_edges)
    weights[edges] = solved.weights
    said = _warnings(found)
    return dataclasses.replace(
        solved,
        problem=graph.replace(poses=solved.problem.poses, has_poses=True),
        initial_problem=graph,
        options=options.replace(num_threads=solved.options.num_threads),
        chi2_before=freeze(before),
        chi2_after=freeze(after),
        weights=freeze(weights),
        rejected=tuple(int(edges[edge]) for edge in solved.rejected),
        left_out=found.left_out,
        build_time_in_seconds=solved.build_time_in_seconds + check_time,
        summary=dataclasses.replace(
            solved.summary,
            num_left_out_edges=len(found.left_out),
            warnings=(*solved.summary.warnings, *said.values()),
            warning_kinds=(*solved.summary.warning_kinds, *said),
        ),
    )


def _warnings(found: ClosureConsistency) -> dict[str, str]:
    said = {}
    if not found.proven:
        said[UNPROVEN_SET] = (
            "The search for the largest consistent set of closures reached its time limit: "
            "the best set found is used, and a larger one may exist."
        )
    if 2 * len(found.left_out) >= found.num_closures > 1:
        said[MOST_LEFT_OUT] = (
            f"{plural(len(found.left_out), 'closure')} of {found.num_closures} contradict "
            "the largest consistent set and are left out: no majority shows which are "
            "correct."
        )
    return said
