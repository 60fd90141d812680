"""Initial poses of pose graphs: file, odometry, spanning tree, chordal relaxation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.base.words import number
from bundle.errors import InputError
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.model.pose_graph_arrays import PoseGraph

FEW = 5  # number of solver steps after which the costs of starts are compared

SLOW = 20  # number of steps above which a solve counts as slow and other starts are tried after it

SAME = 1e-6
"""Relative difference of costs below which two solves are taken to approach the same minimum.
Smaller than the tolerance of a comparison of minima, larger than the last steps of a solve."""

NOT_LOWER = 1e-6  # relative difference of costs below which another start does not count as better

ROUNDING = 1e-12
"""Relative rounding error of poses. It bounds the cost that rounding alone can cause."""

NAMES = {
    "file": "the file's poses",
    "chordal": "the chordal start",
    "odometry": "odometry",
    "spanning_tree": "the spanning tree",
}

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class Start:
    """Initial poses."""

    poses: Floats  # initial poses, in the layout of ``PoseGraph.poses``
    init: str  # "file", "odometry", "spanning_tree" or "chordal"
    reason: str = ""  # reason of the choice; "" if the user chose
    starts: dict[str, Floats] | None = None  # poses of the starts that were compared, by name
    costs: dict[str, float] | None = None  # their costs without a loss, by name
    chi2: Floats | None = None  # (m,) r^T Omega r of each edge there, if it was computed
    given_chi2: Floats | None = None  # (m,) r^T Omega r at the graph's poses, if it was computed


def start_without_poses(graph: PoseGraph) -> PoseGraph:
    """Add poses, from odometry or a spanning tree, to a graph whose file has none."""
    held, _, _ = _core.hold_poses(graph)
    joined = _core.odometry_gap(graph)[0] < 0
    init = "odometry" if joined and not graph.fixed.any() else "spanning_tree"
    return graph.replace(poses=_core.initial_poses(graph, held, init, 1))


def started(graph: PoseGraph, held: NDArray[np.bool_], init: str, num_threads: int) -> Start:
    """Return the start of the kind ``init``."""
    if init == "file":
        return Start(poses=graph.poses, init=init)
    if init == "odometry":
        first, second = _core.odometry_gap(graph)
        if first >= 0:
            raise InputError(
                "init: expected an edge from each id to the next for odometry, found a gap "
                f"between {graph.ids[first]} and {graph.ids[second]}; use spanning_tree"
            )
    return Start(poses=_core.initial_poses(graph, held, init, num_threads), init=init)


def choose_lower(
    graph: PoseGraph,
    held: Flags,
    num_threads: int,
    order: _core.PoseOrder,
    error: str,
) -> Start:
    """Return the chordal start or the file's poses, whichever has the lower cost.

    ``held``: (n,) mask of constant poses. ``order``: order of elimination of the relaxation.
    """
    try:
        chordal = _core.initial_poses(graph, held, "chordal", num_threads, order)
    except InputError:  # its system is singular
        return Start(poses=graph.poses, init="file")
    starts = {"file": graph.poses, "chordal": chordal}
    file_chi2, chordal_chi2 = _core.edge_chi2(graph, error), _core.edge_chi2(graph, error, chordal)
    file_cost, chordal_cost = 0.5 * float(file_chi2.sum()), 0.5 * float(chordal_chi2.sum())
    costs = {"file": file_cost, "chordal": chordal_cost}
    if not chordal_cost < file_cost:
        return Start(poses=graph.poses, init="file", starts=starts, costs=costs, chi2=file_chi2)
    reason = (
        f"The chordal start has the lower cost: twice the cost is {number(2 * chordal_cost)}, "
        f"against {number(2 * file_cost)} at the given poses."
    )
    return Start(
        poses=chordal,
        init="chordal",
        reason=reason,
        starts=starts,
        costs=costs,
        chi2=chordal_chi2,
        given_chi2=file_chi2,
    )


def choose_start(
    graph: PoseGraph,
    held: Flags,
    doubted: Flags,
    options: PoseGraphOptions,
    order: _core.PoseOrder | None = None,
) -> Start:
    """Return the start from which the solve ends at the lowest cost.

    If several starts end at this cost, a start that reached it in few steps is preferred, then the
    earliest.

    Costs at the start or after some steps are poor criteria: a start with a high cost may be in the
    basin of the right minimum, and a slow one may end below a fast one. All starts take a few steps
    first. If these end at the same cost, so do the solves. Otherwise the solves run to their ends,
    one for all starts that the few steps took to the same cost.

    Args:
        held: (n,) mask of constant poses.
        doubted: (m,) mask of edges to which the loss applies.
        options: options of the solve. For losses that run several solves, starts are compared
            without a loss.
        order: order of elimination; None for the Ceres backend.
    """
    if options.loss in ("gnc_tls", "auto"):
        options = options.replace(loss="trivial", loss_scale=1.0, loss_on="closures")
    starts = _starts(graph, held, options.num_threads)

    def reached(init: str, steps: int) -> float:
        return _reached(graph, starts[init], held, doubted, options, steps, order)

    costs = {init: reached(init, FEW) for init in starts}
    ends: dict[str, float] = {}
    is_same = max(costs.values()) <= (1 + SAME) * min(costs.values())
    for init, cost in costs.items():
        alike = [known for known in ends if abs(costs[known] - cost) <= SAME * abs(cost)]
        run = is_same or options.max_num_iterations <= FEW
        ends[init] = cost if run else ends[alike[0]] if alike else reached(init, 1 << 30)
    level = (1 + SAME) * min(ends.values())
    best = min(ends, key=lambda init: (ends[init] > level, costs[init] > level))
    compared = ", ".join(f"{number(2 * end)} from {NAMES[init]}" for init, end in ends.items())
    chosen = NAMES[best][0].upper() + NAMES[best][1:]
    when = f"after up to {FEW} steps" if is_same else "at the end"
    reason = f"{chosen}: twice the cost {when} is {compared}."
    return Start(poses=starts[best], init=best, reason=reason, starts=starts)


def lower_start(
    graph: PoseGraph,
    held: Flags,
    doubted: Flags,
    start: Start,
    options: PoseGraphOptions,
    solved: dict[str, Any],
    cost: Callable[[Floats], float],
) -> str:
    """Return a hint that names a start with a lower cost than the solve's final cost, or "".

    The initial costs of the other starts are compared first. After a slow solve, each other start
    also takes a few steps.

    Args:
        held: (n,) mask of constant poses.
        doubted: (m,) mask of edges to which the loss applies.
        cost: function that returns the cost for chi2 (m,).
    """
    end = float(solved["summary"]["final_cost"])
    is_lower = _comparison(graph, end)
    is_slow = len(solved["iterations"]["cost"]) > SLOW
    if (
        start.costs is not None
        and not is_slow
        and not is_lower(_costs_up_to(graph, held, start, options, end))
    ):
        return ""
    starts = _starts(graph, held, options.num_threads, start.starts)
    others = {init: poses for init, poses in starts.items() if init != start.init}
    when = "before any step"
    costs = {
        init: cost(_core.edge_chi2(graph, options.error, poses)) for init, poses in others.items()
    }
    if is_slow and options.loss != "gnc_tls" and not is_lower(costs):
        when = f"after {FEW} steps"
        costs = {
            init: _reached(graph, poses, held, doubted, options, FEW)
            for init, poses in others.items()
        }
    if not is_lower(costs):
        return ""
    least = min(costs, key=lambda init: costs[init])
    return (
        f"twice the cost is {number(2 * end)}, and {number(2 * costs[least])} from {NAMES[least]} "
        f"{when}. Start there (--init {least.replace('_', '-')}), or compare all (--init auto)."
    )


def _costs_up_to(
    graph: PoseGraph, held: Flags, start: Start, options: PoseGraphOptions, limit: float
) -> dict[str, float]:
    """Return the costs of starts without a loss; above ``limit`` a lower bound."""
    costs = dict(start.costs or {})
    for init in ("odometry", "spanning_tree"):
        costs[init] = _core.start_cost(graph, held, init, options.error, limit)
    return costs


def _comparison(graph: PoseGraph, end: float) -> Callable[[dict[str, float]], bool]:
    """Return a predicate: True if the lowest cost is below ``end`` by more than rounding."""

    def is_lower(costs: dict[str, float]) -> bool:
        gain = end - min(costs.values(), default=np.inf)
        if not gain > NOT_LOWER * end:
            return False
        size = max(1.0, float(np.abs(graph.poses).max()))
        trace = float(np.einsum("kii->", graph.information))
        return gain > trace * (ROUNDING * size) ** 2

    return is_lower


def _reached(
    graph: PoseGraph,
    poses: Floats,
    held: Flags,
    doubted: Flags,
    options: PoseGraphOptions,
    steps: int,
    order: _core.PoseOrder | None = None,
) -> float:
    """Return the cost after a number of steps of the solve from given poses."""
    few = options.replace(max_num_iterations=min(steps, options.max_num_iterations))
    solved = _core.solve_pose_graph(
        graph, held, doubted, few.asdict(), None, order, options.loss == "trivial", poses=poses
    )
    cost = float(solved["summary"]["final_cost"])
    return cost if np.isfinite(cost) else np.inf


def _starts(
    graph: PoseGraph, held: Flags, num_threads: int, known: dict[str, Floats] | None = None
) -> dict[str, Floats]:
    """Return the poses of every available start; the file's poses come first."""
    found = {"file": graph.poses} if graph.has_poses else {}
    for init in ("chordal", "odometry", "spanning_tree"):
        if known is not None and init in known:
            found[init] = known[init]
            continue
        try:
            found[init] = started(graph, held, init, num_threads).poses
        except InputError:  # its system is singular, or the chain of odometry has a gap
            continue
    return found
