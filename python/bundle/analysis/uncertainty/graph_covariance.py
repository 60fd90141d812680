"""Covariances of a pose graph at its own poses; ``graph_covariance.cpp`` has the mathematics."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.analysis.uncertainty.covariance_result import (
    GraphCovariance,
    is_id,
)
from bundle.base.arrays import freeze
from bundle.base.words import not_converged, number, plural
from bundle.errors import InputError, brief
from bundle.graphs.pose_graphs.edge_weights import (
    WeightedGraph,
    check_edges_exist,
    weighted_graph,
)
from bundle.graphs.pose_graphs.joints import find_joints
from bundle.interface.analysis_options import SCALES, one_of
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.model.pose_graph_arrays import PoseGraph

GRAPH_GAUGES = ("first", "inner", "none")

AT_MINIMUM = 1e-4
"""Relative decrease of the cost by one more step, below which a state counts as a minimum."""

LOST = 1e10
"""Inflation above which the variances have fewer than six digits."""


Floats = NDArray[np.float64]


class GraphWords(NamedTuple):
    """Nouns of a graph in errors."""

    block: str
    term: str
    held: str
    command: str
    remedy: str


POSES = GraphWords(
    *("pose", "edge", "fixed pose", "bundle diagnose"),
    "fix a pose in the middle, or split the graph",
)


def graph_covariance(
    graph: Any,
    options: PoseGraphOptions | None = None,
    *,
    relative: Iterable[tuple[int, int]] = (),
    gauge: str = "first",
    scale: str = "unit",
    **changes: Any,
) -> GraphCovariance:
    """Compute the covariances of the poses of a graph; see :func:`bundle.covariance`."""
    gauge, scale = one_of("gauge", gauge, GRAPH_GAUGES), one_of("scale", scale, SCALES)
    weighted = weighted_graph(graph, options, changes, "covariance")
    used = weighted.graph
    if used.num_poses > 1:
        check_edges_exist(used)
    pairs = list(relative)
    rows = _rows_of(used, pairs)
    held, _, for_gauge = _core.hold_poses(used)
    if gauge == "none" and for_gauge:
        raise InputError(
            "gauge: none expects a fixed pose in each component, found "
            f"{plural(len(for_gauge), 'component')} without; first holds a pose in each"
        )
    _check_poses(weighted, held, for_gauge, rows)
    out = _core.graph_covariance(
        used, weighted.options.error, gauge == "inner", False, rows, weighted.options.num_threads
    )
    if out["undetermined_pose"] >= 0:
        raise undetermined(POSES, [used.pose_name(int(out["undetermined_pose"]))])
    chi2 = float(_core.edge_chi2(used, weighted.options.error).sum())
    dof = used.tangent_size * (used.num_edges - int((~held).sum()))
    without_loss = weighted.options.loss == "trivial"
    sigma0, factor, notes = scaled(POSES, out, chi2, dof, scale, without_loss, len(for_gauge))
    return GraphCovariance(
        pose_ids=used.ids,
        pose_covariance=freeze(factor * out["poses"]),
        relative_ids=freeze(np.array(pairs, np.int64).reshape(-1, 2)),
        relative_covariance=freeze(factor * out["relative"]),
        cross_covariance=freeze(factor * out["across"]),
        sigma0=sigma0,
        dof=dof,
        gauge=gauge,
        held_pose_ids=tuple(int(used.ids[pose]) for pose in for_gauge),
        scale=scale,
        notes=notes,
    )


def scaled(
    words: GraphWords,
    out: dict[str, Any],
    squares: float,
    dof: int,
    scale: str,
    without_loss: bool = False,
    num_floating: int = 0,
) -> tuple[float, float, tuple[str, ...]]:
    """Return sigma0, the factor of all covariances, and notes; refuse rounding errors."""
    inflation = float(out["inflation"])
    if not np.isfinite(inflation):
        raise InputError(
            "graph: expected well-conditioned normal equations, found variances that are only "
            f"rounding errors; {words.remedy}"
        )
    sigma0 = float(np.sqrt(squares / dof)) if dof > 0 else float("nan")
    if scale == "sigma0" and not dof > 0:
        raise InputError(
            f"scale: expected degrees of freedom to estimate sigma0 from, found {dof}; use unit"
        )
    notes = []
    decrease = float(out["predicted_decrease"])
    if decrease > AT_MINIMUM * 0.5 * squares and decrease > 1e-9:
        notes.append(not_converged(200 * decrease / squares, without_loss))
    if num_floating > 1:
        notes.append(
            f"{plural(num_floating, 'component')} without a fixed pose: the covariances of each "
            "are about itself alone."
        )
    if inflation > LOST:
        digits = plural(max(0, round(16 - np.log10(inflation))), "digit")
        notes.append(
            f"Some {words.block} is {number(float(np.sqrt(inflation)))} times less certain than "
            f"with all others known: its covariance has about {digits}."
        )
    return sigma0, sigma0 * sigma0 if scale == "sigma0" else 1.0, tuple(notes)


def _check_poses(
    weighted: WeightedGraph, held: NDArray[np.bool_], for_gauge: list[int], rows: list[Any]
) -> None:
    """Refuse undetermined directions, and relative poses between unconnected poses."""
    used = weighted.graph
    joints = find_joints(used, held, weighted.options.error)
    if joints.num_open:
        moved = np.flatnonzero(joints.directions.any(axis=1)) // used.tangent_size
        poses = moved.tolist() or [int(joint.poses[0]) for joint in joints.opened]
        raise undetermined(POSES, [used.pose_name(pose) for pose in dict.fromkeys(poses)])
    component = np.asarray(_core.pose_components(used.num_poses, used.edges))
    floating = set(component[for_gauge].tolist())
    for a, b in rows:
        if component[a] != component[b] and {int(component[a]), int(component[b])} & floating:
            raise unconnected(POSES, used.pose_name(a), used.pose_name(b))


def unconnected(words: GraphWords, a: str, b: str) -> InputError:
    """Return the error about a pair without a relative position."""
    return InputError(
        f"relative: expected {words.block}s that {words.term}s or {words.held}s connect, found "
        f"{a} and {b}"
    )


def undetermined(words: GraphWords, names: Sequence[str]) -> InputError:
    """Return the error about undetermined poses or variables."""
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return InputError(
        f"graph: expected {words.term}s that determine all {words.block}s but for the gauge, found "
        f"{words.block if len(names) == 1 else words.block + 's'} {', '.join(names[:3])}{more} "
        f"with a direction open; {words.command} says which"
    )


def _rows_of(graph: PoseGraph, pairs: list[Any]) -> list[tuple[int, int]]:
    """Return pairs of pose ids as pairs of array positions."""
    place = {key: row for row, key in enumerate(graph.ids.tolist())}
    rows = []
    for k, pair in enumerate(pairs):
        ends = tuple(pair) if isinstance(pair, tuple | list | np.ndarray) else ()
        if len(ends) != 2 or not all(is_id(end) and int(end) in place for end in ends):
            raise InputError(f"relative: expected pairs of pose ids, found {brief(pair)} at [{k}]")
        if ends[0] == ends[1]:
            raise InputError(
                f"relative: expected two different poses, found {brief(pair)} at [{k}]"
            )
        rows.append((place[int(ends[0])], place[int(ends[1])]))
    return rows
