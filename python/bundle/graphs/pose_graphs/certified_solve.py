"""Certificate of a solve, and the second solve where a staircase finds lower poses."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from bundle.base.words import number
from bundle.graphs.pose_graphs.certificate import Certificate
from bundle.graphs.pose_graphs.certify import NEAR_COST, certify, check_certifiable
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.interface.solve_record import Progress
from bundle.model.pose_graph_arrays import PoseGraph

STAIRCASE, CHORDAL_MINIMUM = ESCAPES = ("staircase", "chordal_minimum")
"""Names of the starts of second solves."""

LOWER = 1e-6
"""Relative decrease of the cost below which the second solve is the same minimum."""

Solve = Callable[[PoseGraph, PoseGraphOptions], PoseGraphResult]


def certified(
    graph: PoseGraph, options: PoseGraphOptions, solve: Solve, progress: Progress | None = None
) -> PoseGraphResult:
    """Solve, certify the solution, and solve again from lower poses that the certificate has.

    These are the staircase's poses if their F is lower, or the critical point of F if this was far
    from the solution. The certificate of the result is that of the first solution. A result without
    a usable solution has none. Ctrl-C during the certificate keeps the solution, as interrupted.

    Args:
        graph: graph to solve.
        options: options with ``certify``.
        solve: function that solves a graph with options.
        progress: called after each step of the certificate.

    Raises:
        InputError: the graph or the loss has no certificate.
    """
    check_certifiable(graph, options.loss)
    solved = solve(graph, options)
    if not solved.summary.is_solution_usable or solved.summary.interrupted:
        return solved
    solved = dataclasses.replace(solved, options=options)
    try:
        certificate = certify(solved, num_threads=solved.options.num_threads, progress=progress)
    except KeyboardInterrupt:
        interrupted = dataclasses.replace(solved.summary, interrupted=True)
        return dataclasses.replace(solved, summary=interrupted)
    solved = dataclasses.replace(solved, certificate=certificate)
    there, init, how = _lower_poses(certificate)
    if there is None:
        return solved
    first = solved.summary
    second = solve(
        graph.replace(poses=there.poses, has_poses=True),
        options.replace(certify=False, init="file"),
    )
    last = second.summary
    is_lower = last.final_cost < (1 - LOWER) * first.final_cost
    if not (is_lower and last.is_solution_usable and not last.interrupted):
        return solved
    reason = f"The certificate of a first solve failed (chi2 {number(first.chi2_final)}). {how}"
    return dataclasses.replace(
        second,
        initial_problem=graph,
        options=options,
        chi2_before=solved.chi2_before,
        certificate=certificate,
        summary=dataclasses.replace(
            last, init=init, init_choice=reason, chi2_initial=first.chi2_initial
        ),
    )


def _lower_poses(certificate: Certificate) -> tuple[PoseGraph | None, str, str]:
    """Return poses below the solution, their name and their origin; None without such poses."""
    stairs = certificate.staircase
    if stairs is not None and stairs.cost < (1 - LOWER) * certificate.cost:
        return (
            stairs.problem,
            STAIRCASE,
            f"A convex relaxation, of rank {stairs.rank}, gave lower poses.",
        )
    if certificate.cost * (1 + NEAR_COST) < certificate.initial_cost:
        words = "The minimum of the chordal cost next to it gave lower poses."
        return certificate.problem, CHORDAL_MINIMUM, words
    return None, "", ""
