"""Solve of a pose graph: start, loss, and result."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arrays import check_function, check_type
from bundle.base.tails import ONE_IN_2000, ONE_IN_A_MILLION
from bundle.base.words import plural
from bundle.errors import InputError
from bundle.graphs.pose_graphs.edge_weights import checked_information
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult, PoseGraphSummary
from bundle.interface.ordering_alarm import BestOrder, with_ordering_alarm
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.interface.solve_record import Progress, record_fields, with_warnings
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.starts import choose_lower, choose_start, lower_start, started

if TYPE_CHECKING:
    from bundle.graphs.pose_graphs.gnc_solve import Proposal

# Functions import the modules of robust, consistent and certified solves: together with those of a
# plain one they would take longer than its first call.

Floats = NDArray[np.float64]

SUSPICIOUS_STEPS = "suspicious_steps"
SEVERAL_COMPONENTS = "several_components"
FREE_DIRECTIONS = "free_directions"
LOCAL_MINIMUM = "local_minimum"
BETTER_START = "better_start"
MOST_CHECKED = 2500
"""Largest number of closures for which ``auto`` checks consistency: three million pairs, some
seconds."""


def solve_pose_graph(
    graph: PoseGraph,
    options: PoseGraphOptions | None = None,
    *,
    progress: Progress | None = None,
    **changes: Any,
) -> PoseGraphResult:
    """Refine a pose graph: minimise 1/2 sum rho(r^T Omega r) over its edges.

    Fixed poses stay. A connected component without a fixed pose would have gauge freedom. Its first
    pose is held constant, which removes exactly 3 degrees of freedom in 2D and 6 in 3D.
    The summary counts and lists these poses. The GIL is released; Ctrl-C keeps the best state.

    ``progress``: called after each iteration, as by :func:`bundle.solve`; with ``certify`` also
    after each step of the certificate, with the chordal cost.
    """
    check_type("graph", graph, PoseGraph)
    options = PoseGraphOptions.of(options, changes, "solve")
    check_function("progress", progress)
    cores = _core.hardware_threads()
    num_threads = min(options.num_threads or cores, cores)
    if num_threads != options.num_threads:
        options = options.replace(num_threads=num_threads)

    def solve(given: PoseGraph, how: PoseGraphOptions) -> PoseGraphResult:
        if not how.consistency:
            return _refined(given, how, progress)[0]
        from bundle.graphs.pose_graphs.consistency import solve_consistent

        return solve_consistent(given, how, lambda kept, how: _refined(kept, how, progress))

    if not options.certify:
        return solve(graph, options)
    from bundle.graphs.pose_graphs.certify import certified

    return certified(graph, options, solve, progress)


def _refined(
    graph: PoseGraph, options: PoseGraphOptions, progress: Progress | None
) -> tuple[PoseGraphResult, NDArray[np.float64]]:
    """Return the result of a solve with all edges, and the poses of its ``chi2_before``."""
    weighed = checked_information(graph, options.information)
    held, num_components, for_gauge = _core.hold_poses(weighed)
    doubted = _robust_edges(graph, options)
    # Trials leave the basin of the start, which robust solves must not.
    with_trials = options.loss == "trivial"
    order: _core.PoseOrder | None = None
    if options.init == "auto":
        if options.backend != "ceres":
            order = _core.order_poses(weighed, held, options.ordering)
        start = choose_start(weighed, held, doubted, options, order)
    elif options.init == "lower" and options.loss == "trivial":
        # Wrong closures deform the chordal start, which has no loss, and can take a solve with a
        # loss to a wrong minimum.
        order = _core.order_poses(weighed, held, options.ordering)
        start = choose_lower(
            weighed,
            held,
            options.num_threads,
            order,
            options.error,
        )
    elif options.init == "lower":
        start = started(weighed, held, "file", options.num_threads)
    else:
        start = started(weighed, held, options.init, options.num_threads)
        if options.loss == "trivial" and options.backend != "ceres":
            order = _core.order_poses(weighed, held, options.ordering)
    c_squared = options.loss_scale**2 * ONE_IN_2000[graph.tangent_size]
    proposals: list[Proposal] = []

    def solve(how: PoseGraphOptions) -> dict[str, Any]:
        if how.loss == "gnc_tls":
            from bundle.graphs.pose_graphs.gnc_solve import solve_gnc

            there = weighed.replace(poses=start.poses)
            return solve_gnc(there, held, doubted, how, progress, proposals)
        found = _core.solve_pose_graph(
            weighed,
            held,
            doubted,
            how.asdict(),
            progress,
            order,
            with_trials,
            start.chi2,
            start.poses,
        )
        if options.loss == "auto" and how.loss != "trivial":
            proposals.append((found["chi2_after"] <= c_squared, found["poses"]))
            agreed = _consistent_set(weighed, options.num_threads)
            if agreed is not None:
                proposals.append((agreed, start.poses))
        return found

    def doubts(found: dict[str, Any]) -> str:
        from bundle.graphs.pose_graphs.truncated_search import find_doubt

        there = weighed.replace(poses=found["poses"])
        chi2 = found["chi2_after"]
        return find_doubt(there, options.error, doubted, chi2, c_squared, options.num_threads)

    if options.loss == "auto":
        from bundle.graphs.pose_graphs.truncated_search import choose_loss

        used, output, why = choose_loss(solve, doubted, options, c_squared, doubts)
    else:
        used, output, why = options, solve(options), ""

    def cost(chi2: NDArray[np.float64]) -> float:
        from bundle.graphs.pose_graphs.truncated_search import loss_cost

        return loss_cost(chi2, doubted, used, c_squared)

    rejected = _rejected(graph, output, doubted, used)
    advice = "the Jacobians of edges are part of bundle: please report this"
    warnings = {
        SUSPICIOUS_STEPS: _core.watch_convergence(output["iterations"], advice),
        SEVERAL_COMPONENTS: _about_components(num_components),
        FREE_DIRECTIONS: _about_information(weighed),
    }
    # "auto" has compared the ends of this very solve from all starts.
    is_compared = options.init == "auto" and options.loss not in ("gnc_tls", "auto")
    is_judged = not output["summary"]["interrupted"] and used.max_num_iterations > 0
    if is_judged and not is_compared:
        lower = lower_start(weighed, held, doubted, start, used, output, cost)
        has_converged = output["summary"]["termination_type"] == "CONVERGENCE"
        if lower and has_converged:
            warnings[LOCAL_MINIMUM] = f"This is a local minimum: {lower}"
        elif lower:
            warnings[BETTER_START] = f"Not converged: {lower}"
    is_given = start.init == "file" or not graph.has_poses
    before = output["chi2_before"] if is_given else start.given_chi2
    if before is None:
        before = _core.edge_chi2(weighed, options.error)
    fields = with_warnings(output["summary"], warnings)
    summary = PoseGraphSummary(
        **_with_ordering_alarm(fields, weighed, held, options),
        num_rejected_edges=len(rejected),
        chi2_initial=float(before.sum()),
        chi2_start=float(output["chi2_before"].sum()),
        chi2_final=float(output["chi2_after"].sum()),
        init=start.init,
        init_choice=start.reason,
        loss=used.loss,
        loss_choice=why,
        num_components=num_components,
        num_gauge_freedoms=graph.tangent_size * len(for_gauge),
        held_pose_ids=tuple(int(graph.ids[pose]) for pose in for_gauge),
    )
    result = PoseGraphResult(
        problem=graph.replace(poses=output["poses"], has_poses=True),
        initial_problem=graph,
        options=options,
        chi2_before=before,
        chi2_after=output["chi2_after"],
        weights=output["weights"],
        rejected=rejected,
        **record_fields(output, summary),
    )
    return result, start.poses if is_given else graph.poses


def _with_ordering_alarm(
    fields: dict[str, Any], graph: PoseGraph, held: NDArray[np.bool_], options: PoseGraphOptions
) -> dict[str, Any]:
    """Compare the requested order with the one of ``auto``, and with an earlier solve."""

    def look() -> BestOrder:
        best = _core.order_poses(graph, held, "auto")
        return BestOrder(ordering=best.name, flops=best.flops, nonzeros=best.entries)

    is_asked = options.ordering != "auto" and fields["backend_used"] == "FUSED"
    advice = "Leave --pose-ordering (ordering) at auto." if is_asked else ""
    return with_ordering_alarm(
        fields, lambda: (graph.edges, held), look if is_asked else None, advice
    )


def _consistent_set(graph: PoseGraph, num_threads: int) -> NDArray[np.bool_] | None:
    """Return the mask of edges without contradicting closures; None if it cannot be computed."""
    if int(graph.is_closure.sum()) > MOST_CHECKED:
        return None
    from bundle.graphs.pose_graphs.consistency import closure_consistency

    try:
        found = closure_consistency(graph, num_threads)
    except InputError:
        return None
    used = np.ones(graph.num_edges, bool)
    used[[entry.edge for entry in found.left_out]] = False
    return used


def _rejected(
    graph: PoseGraph,
    output: dict[str, Any],
    doubted: NDArray[np.bool_],
    options: PoseGraphOptions,
) -> tuple[int, ...]:
    """Return the edges with a weight below 1/2 and a large error; losses reduce all weights."""
    if options.loss == "trivial":
        return ()
    out = doubted & (output["weights"] < 0.5)
    if options.loss != "gnc_tls":
        out &= output["chi2_after"] > ONE_IN_A_MILLION[graph.tangent_size]
    worst_first = np.argsort(-output["chi2_after"], kind="stable")
    return tuple(int(edge) for edge in worst_first if out[edge])


def _robust_edges(graph: PoseGraph, options: PoseGraphOptions) -> NDArray[np.bool_]:
    if options.loss == "trivial":
        return np.zeros(graph.num_edges, bool)
    if options.loss_on == "all":
        return np.ones(graph.num_edges, bool)
    return graph.is_closure


def _about_information(graph: PoseGraph) -> str:
    if not graph.num_edges or graph.prepared_edges.has_information:
        return ""
    return "No edge has information other than 0: any poses have cost 0."


def _about_components(num_components: int) -> str:
    if num_components == 1:
        return ""
    held = plural(num_components, "component")
    return (
        f"The graph has {held} without a connecting edge: their relative placement is undetermined."
    )
