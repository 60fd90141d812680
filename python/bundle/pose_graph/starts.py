"""Where the solve of a pose graph starts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bundle import _core
from bundle.errors import InputError
from bundle.pose_graph.pose_graph_arrays import PoseGraph
from bundle.words import number

__all__ = ["Start", "choose_start", "chordal_chi2", "start_without_poses", "started"]

HOPELESS = 10.0
"""A start whose chi2 is more than so many times another's is left for the other."""


@dataclass(frozen=True, kw_only=True)
class Start:
    """Poses to start from.

    Attributes:
        poses: as those of a graph.
        init: "file", "odometry", "spanning_tree" or "chordal".
        reason: why, where that was chosen; "" where it was asked for.
        chordal_chi2: of the chordal start, where the choice looked at it.
    """

    poses: NDArray[np.float64]
    init: str
    reason: str = ""
    chordal_chi2: float | None = None


def start_without_poses(graph: PoseGraph) -> PoseGraph:
    """Return a graph whose file has no poses with those of odometry, or of a spanning tree."""
    held, _, _ = _core.hold_poses(graph)
    joined = _core.odometry_gap(graph)[0] < 0
    init = "odometry" if joined and not graph.fixed.any() else "spanning_tree"
    return graph.replace(poses=_core.initial_poses(graph, held, init, 1))


def started(graph: PoseGraph, held: NDArray[np.bool_], init: str, num_threads: int) -> Start:
    """Return the start of one kind.

    Raises:
        InputError: odometry was asked for, but consecutive ids without an edge break its chain.
    """
    if init == "file":
        return Start(poses=graph.poses, init=init)
    if init == "odometry":
        first, second = _core.odometry_gap(graph)
        if first >= 0:
            raise InputError(
                "init: expected an edge between all consecutive ids for odometry, found none "
                f"between {graph.ids[first]} and {graph.ids[second]}; spanning_tree needs no such"
            )
    return Start(poses=_core.initial_poses(graph, held, init, num_threads), init=init)


def choose_start(graph: PoseGraph, held: NDArray[np.bool_], error: str, num_threads: int) -> Start:
    """Return where ``auto`` starts: at the file's poses, unless a chordal start is far better."""
    try:
        chordal = started(graph, held, "chordal", num_threads).poses
    except InputError as failure:
        reason = f"The file's poses, as there is no chordal start: {failure}."
        return Start(poses=graph.poses, init="file", reason=reason)
    before = float(_core.edge_chi2(graph, error).sum())
    after = float(_core.edge_chi2(graph.replace(poses=chordal), error).sum())
    compared = f"chi2 {number(before)} at the file's poses, {number(after)} at the chordal start"
    if after * HOPELESS < before:
        reason = f"The chordal start, more than {HOPELESS:g} times better: {compared}."
        return Start(poses=chordal, init="chordal", reason=reason, chordal_chi2=after)
    reason = f"The file's poses, as nothing is {HOPELESS:g} times better: {compared}."
    return Start(poses=graph.poses, init="file", reason=reason, chordal_chi2=after)


def chordal_chi2(
    graph: PoseGraph, held: NDArray[np.bool_], error: str, num_threads: int
) -> float | None:
    """Return chi2 of the chordal start; None if there is none."""
    try:
        chordal = started(graph, held, "chordal", num_threads)
    except InputError:
        return None
    return float(_core.edge_chi2(graph.replace(poses=chordal.poses), error).sum())
