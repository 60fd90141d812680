"""Certificate of a solve, and the second solve where a staircase finds lower poses."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from bundle.base.words import number
from bundle.graphs.pose_graphs.certify import certify, check_certifiable
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.model.pose_graph_arrays import PoseGraph

__all__ = ["STAIRCASE", "certified"]

STAIRCASE = "staircase"
"""Name of the start of the second solve."""

LOWER = 1e-6
"""Relative decrease of the cost below which the second solve is the same minimum."""

Solve = Callable[[PoseGraph, PoseGraphOptions], PoseGraphResult]


def certified(graph: PoseGraph, options: PoseGraphOptions, solve: Solve) -> PoseGraphResult:
    """Solve, certify the solution, and solve again from the staircase's poses if these are lower.

    The certificate of the result is that of the first solution. A result without a usable solution
    has none.

    Args:
        graph: graph to solve.
        options: options with ``certify``.
        solve: function that solves a graph with options.

    Raises:
        InputError: the graph or the loss has no certificate.
    """
    check_certifiable(graph, options.loss)
    solved = solve(graph, options)
    if not solved.summary.is_solution_usable or solved.summary.interrupted:
        return solved
    certificate = certify(solved, num_threads=solved.options.num_threads)
    solved = dataclasses.replace(solved, options=options, certificate=certificate)
    staircase = certificate.staircase
    if staircase is None or not staircase.cost < (1 - LOWER) * certificate.cost:
        return solved
    first = solved.summary
    there = graph.replace(poses=staircase.problem.poses)
    second = solve(there, options.replace(certify=False, init="file"))
    last = second.summary
    is_lower = last.final_cost < (1 - LOWER) * first.final_cost
    if not (is_lower and last.is_solution_usable and not last.interrupted):
        return solved
    reason = (
        f"The certificate of a first solve failed (chi2 {number(first.chi2_final)}). A convex "
        f"relaxation, of rank {staircase.rank}, gave lower poses."
    )
    return dataclasses.replace(
        second,
        initial_problem=graph,
        options=options,
        certificate=certificate,
        summary=dataclasses.replace(last, init=STAIRCASE, init_choice=reason),
    )
