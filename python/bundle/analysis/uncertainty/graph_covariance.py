"""Covariances of a pose graph at its own poses; ``graph_covariance.cpp`` has the mathematics."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arrays import FrozenArrays, freeze
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import not_converged, number, plural
from bundle.errors import InputError, brief
from bundle.graphs.pose_graphs.edge_weights import (
    WeightedGraph,
    check_edges_exist,
    weighted_graph,
)
from bundle.graphs.pose_graphs.joints import find_joints
from bundle.interface.covariance_options import SCALES, one_of
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.interface.tabular import Tabular
from bundle.io.atomic import atomic_write as atomic
from bundle.model.pose_graph_arrays import PoseGraph

GRAPH_GAUGES = ("first", "inner", "none")

AT_MINIMUM = 1e-4
"""Relative decrease of the cost by one more step, below which a state counts as a minimum."""

LOST = 1e10
"""Inflation above which the variances have fewer than six digits."""

_Floats = NDArray[np.float64]
_Ids = NDArray[np.int64]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class GraphCovariance(FrozenArrays, Displayed, Tabular):
    """Marginal covariances of the poses of a graph: of each, with all others estimated as well.

    A pose X (world_from_body) has the covariance of d in X Exp(d), a right perturbation: in the
    plane x y angle, in space rotation [rad] and then translation, both in the frame of the body.
    Constant poses have covariance 0.

    Attributes:
        pose_ids: (n,) ids of poses.
        pose_covariance: (n, d, d) with d = 3 or 6.
        relative_ids: (m, 2) ids of poses a and b.
        relative_covariance: (m, d, d) of X_a^-1 X_b, a right perturbation; independent of the
            gauge.
        cross_covariance: (m, d, d) of d_a with d_b.
        sigma0: root of sum r^T W Omega r over the degrees of freedom; 1 if the information of the
            edges is right. NaN without degrees of freedom.
        dof: d times the number of edges, minus d times the number of free poses under the gauge.
        gauge: "first", "inner" or "none".
        held_pose_ids: constant poses without a FIX.
        scale: "unit": from the information of the edges; "sigma0": multiplied by sigma0^2.
        notes: sentences with remarks on the covariance.
    """

    pose_ids: _Ids
    pose_covariance: _Floats
    relative_ids: _Ids
    relative_covariance: _Floats
    cross_covariance: _Floats
    sigma0: float
    dof: int
    gauge: str
    held_pose_ids: tuple[int, ...]
    scale: str
    notes: tuple[str, ...] = ()

    def _tables(self) -> dict[str, Mapping[str, Any]]:
        """Return standard deviations, one row per pose or pair."""
        pairs = {"pose_id_a": self.relative_ids[:, 0], "pose_id_b": self.relative_ids[:, 1]}
        return {
            "poses": {"pose_id": self.pose_ids, **_sigmas(self.pose_covariance)},
            "relative": {**pairs, **_sigmas(self.relative_covariance)},
        }

    def pose(self, pose_id: int) -> _Floats:
        """Return the (d, d) covariance of a pose.

        Raises:
            InputError: the pose does not exist.
        """
        found = np.flatnonzero(self.pose_ids == pose_id)
        if not _is_id(pose_id) or not len(found):
            count = plural(len(self.pose_ids), "pose")
            raise InputError(f"pose: expected the id of one of {count}, found {brief(pose_id)}")
        one: _Floats = self.pose_covariance[found[0]]
        return one

    def relative(self, id_a: int, id_b: int) -> _Floats:
        """Return the (d, d) covariance of X_a^-1 X_b.

        Raises:
            InputError: the pair was not requested.
        """
        found = np.flatnonzero((self.relative_ids == (id_a, id_b)).all(axis=1))
        if not found.size:
            raise InputError(
                f"relative: expected a pair of {self.relative_ids.tolist()}, "
                f"found {brief((id_a, id_b))}"
            )
        of_pair: _Floats = self.relative_covariance[found[0]]
        return of_pair

    def save(self, path: str | Path) -> None:
        """Write all arrays and settings to an .npz file; a failed write leaves no partial file.

        Raises:
            OSError: the file cannot be written.
        """
        arrays: dict[str, Any] = {
            field.name: np.asarray(getattr(self, field.name)) for field in dataclasses.fields(self)
        }
        with atomic.replace_file(Path(path)) as temporary, temporary.open("wb") as stream:
            np.savez(stream, **arrays)

    def _display(self) -> Display:
        facts = (
            ("of", plural(len(self.pose_ids), "pose")),
            ("gauge", self.gauge),
            ("scale", self.scale),
            ("sigma0", f"{number(self.sigma0)} ({plural(self.dof, 'degree')} of freedom)"),
        )
        return Display(title="GraphCovariance", facts=facts)


def graph_covariance(
    graph: Any,
    options: PoseGraphOptions | None = None,
    *,
    relative: Iterable[tuple[int, int]] = (),
    gauge: str = "first",
    scale: str = "unit",
    **changes: Any,
) -> GraphCovariance:
    """Compute the covariances of the poses of a graph; see :func:`bundle.covariance`.

    Raises:
        InputError: an argument is wrong; the gauge or the edges leave directions free; sigma0 has
            no degrees of freedom.
        OSError: the path cannot be read.
    """
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
    _check_determined(weighted, held, for_gauge, rows)
    out = _core.graph_covariance(
        used, weighted.options.error, gauge == "inner", False, rows, weighted.options.num_threads
    )
    if out["undetermined_pose"] >= 0:
        raise _not_determined(used, [int(out["undetermined_pose"])])
    if not np.isfinite(out["inflation"]):
        raise InputError(
            "graph: expected well-conditioned normal equations, found variances that are only "
            "rounding errors; fix a pose in the middle, or split the graph"
        )
    chi2 = float(_core.edge_chi2(used, weighted.options.error).sum())
    dof = used.tangent_size * (used.num_edges - int((~held).sum()))
    sigma0 = float(np.sqrt(chi2 / dof)) if dof > 0 else float("nan")
    if scale == "sigma0" and not dof > 0:
        raise InputError(
            f"scale: expected degrees of freedom to estimate sigma0 from, found {dof}; use unit"
        )
    factor = sigma0 * sigma0 if scale == "sigma0" else 1.0
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
        notes=_notes(out, chi2, len(for_gauge), weighted.options.loss),
    )


def _notes(out: dict[str, Any], chi2: float, num_floating: int, loss: str) -> tuple[str, ...]:
    notes = []
    decrease = float(out["predicted_decrease"])
    if decrease > AT_MINIMUM * 0.5 * chi2 and decrease > 1e-9:
        notes.append(not_converged(200 * decrease / chi2, loss == "trivial"))
    if num_floating > 1:
        notes.append(
            f"{plural(num_floating, 'component')} without a fixed pose: the covariances of each "
            "are about itself alone."
        )
    if out["inflation"] > LOST:
        notes.append(
            f"Some pose is {number(float(np.sqrt(out['inflation'])))} times less certain than "
            "with all others known: its covariance has about "
            f"{max(0, round(16 - np.log10(out['inflation'])))} digits."
        )
    return tuple(notes)


def _check_determined(
    weighted: WeightedGraph, held: NDArray[np.bool_], for_gauge: list[int], rows: list[Any]
) -> None:
    """Refuse undetermined directions, and relative poses between unconnected poses."""
    used = weighted.graph
    joints = find_joints(used, held, weighted.options.error)
    if joints.num_open:
        moved = np.flatnonzero(joints.directions.any(axis=1)) // used.tangent_size
        poses = moved.tolist() or [int(joint.poses[0]) for joint in joints.opened]
        raise _not_determined(used, list(dict.fromkeys(poses)))
    component = np.asarray(_core.pose_components(used.num_poses, used.edges))
    floating = set(component[for_gauge].tolist())
    for a, b in rows:
        if component[a] != component[b] and {int(component[a]), int(component[b])} & floating:
            raise InputError(
                "relative: expected poses that edges or fixed poses connect, found "
                f"{used.pose_name(a)} and {used.pose_name(b)}"
            )


def _not_determined(graph: PoseGraph, poses: list[int]) -> InputError:
    ids = ", ".join(graph.pose_name(pose) for pose in poses[:3])
    more = f" and {len(poses) - 3} more" if len(poses) > 3 else ""
    noun = "pose" if len(poses) == 1 else "poses"
    return InputError(
        f"graph: expected edges that determine all poses but for the gauge, found {noun} {ids}"
        f"{more} with a direction open; bundle diagnose says which"
    )


def _rows_of(graph: PoseGraph, pairs: list[Any]) -> list[tuple[int, int]]:
    """Return pairs of pose ids as pairs of array positions."""
    place = {key: row for row, key in enumerate(graph.ids.tolist())}
    rows = []
    for k, pair in enumerate(pairs):
        ends = tuple(pair) if isinstance(pair, tuple | list | np.ndarray) else ()
        if len(ends) != 2 or not all(_is_id(end) and int(end) in place for end in ends):
            raise InputError(f"relative: expected pairs of pose ids, found {brief(pair)} at [{k}]")
        if ends[0] == ends[1]:
            raise InputError(
                f"relative: expected two different poses, found {brief(pair)} at [{k}]"
            )
        rows.append((place[int(ends[0])], place[int(ends[1])]))
    return rows


def _is_id(value: object) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def _sigmas(covariance: _Floats) -> dict[str, _Floats]:
    """Return the standard deviation of each tangent coordinate, in the plane or in space."""
    axes = ("x", "y", "angle") if covariance.shape[-1] == 3 else ("wx", "wy", "wz", "x", "y", "z")
    sigmas = np.sqrt(np.einsum("nii->ni", covariance))
    return {f"sigma_{axis}": sigmas[:, k] for k, axis in enumerate(axes)}
