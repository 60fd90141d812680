"""A pose graph: poses, and measured relative poses between them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arrays import (
    Array,
    FrozenArrays,
    Index,
    check_arrays,
    check_shape,
    check_values,
    declare,
    freeze,
    immutable,
    refuse_row,
)
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.errors import InputError
from bundle.interface.tabular import Tabular

TANGENT = {3: 3, 7: 6}
"""Number of tangent coordinates of a pose, by the number of values that represent it."""
_AXES = {3: ("x", "y", "angle"), 7: ("qx", "qy", "qz", "qw", "tx", "ty", "tz")}
"""Names of these values."""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class PoseGraph(FrozenArrays, Displayed, Tabular):
    """Poses X_i (world_from_body) and edges that measure X_i^-1 X_j.

    Arrays are read-only. A 2D pose is x y angle (length unit, radians). A 3D pose is
    qx qy qz qw tx ty tz, with a quaternion of any norm but 0. Information matrices are in the order
    of the tangent coordinates of :class:`bundle.FactorGraph`: x y angle in 2D; rotation x y z, then
    translation x y z in 3D. (g2o files have the translation first; reading and writing permute.)
    Edge k is thus ``BetweenFactor(a, b, graph.measurements[k], graph.information[k])``.

    Attributes:
        poses: (n, 3) or (n, 7) poses.
        edges: (m, 2) positions of two poses; the second is measured in the frame of the first.
        measurements: (m, 3) or (m, 7) relative poses, in the layout of ``poses``.
        information: (m, d, d) with d = 3 or 6; symmetric positive semidefinite for a solve.
        ids: (n,) unique ids of the poses, 0 or above; by default their positions.
        fixed: (n,) True for a constant pose (FIX in g2o); by default all False.
        edge_lines: (m,) line of each edge in its file; 0 without a file.
        path: path of the file; "" from memory.
        has_poses: False if the file had only edges. The poses then come from odometry, or from a
            spanning tree if the chain of ids is broken.
        format: format of the file, "g2o" or "toro"; "" from memory.
        notes: sentences on entries that were interpreted.
        names: names of the poses in sentences; by default () for their ids.

    Raises:
        InputError: shapes or values are inconsistent.
    """

    poses: NDArray[np.float64]
    edges: NDArray[np.int32]
    measurements: NDArray[np.float64]
    information: NDArray[np.float64]
    ids: NDArray[np.int64] = None  # type: ignore[assignment]
    fixed: NDArray[np.bool_] = None  # type: ignore[assignment]
    edge_lines: NDArray[np.int64] = None  # type: ignore[assignment]
    path: str = ""
    has_poses: bool = True
    format: str = ""
    notes: tuple[str, ...] = ()
    names: tuple[str, ...] = ()

    _ARRAYS = declare(
        poses=Array(("n", "width"), "pose"),
        edges=Array(("m", 2), Index("n", "indices of poses"), np.int32),
        measurements=Array(("m", "width"), "pose"),
        information=Array(("m", "d", "d")),
        ids=Array(("n",), "whole", np.int64, default="range"),
        edge_lines=Array(("m",), dtype=np.int64, default=0),
    )

    def __post_init__(self) -> None:
        poses = immutable("poses", self.poses, np.float64)
        if poses.shape[1:] not in ((3,), (7,)):
            raise InputError(
                "poses: expected shape (n, 3), x y angle, or (n, 7), qx qy qz qw tx ty tz, "
                f"found {poses.shape}"
            )
        n, width = poses.shape
        fixed = np.zeros(n, bool) if self.fixed is None else np.asarray(self.fixed)
        if fixed.dtype != np.bool_:
            raise InputError(f"fixed: expected flags, found an array of {fixed.dtype.name}")
        check_shape("fixed", fixed, (n,))
        object.__setattr__(self, "fixed", freeze(fixed.copy()))
        if n == 0:
            raise InputError("poses: expected at least one, found an empty array")
        check_arrays(self, self._ARRAYS, width=width, d=TANGENT[width])
        refuse_row(
            self.edges[:, 0] == self.edges[:, 1],
            lambda k: f"edges[{k}]: expected two different poses, found {self.edges[k].tolist()}",
        )
        unique, counts = np.unique(self.ids, return_counts=True)
        refuse_row(
            counts > 1, lambda k: f"ids: expected unique ids, found {unique[k]} more than once"
        )

    def _tables(self) -> dict[str, Mapping[str, Any]]:
        axes = _AXES[self.poses.shape[1]]
        ends = self.ids[self.edges]
        return {
            "poses": {
                "pose_id": self.ids,
                **{axis: self.poses[:, k] for k, axis in enumerate(axes)},
                "is_fixed": self.fixed,
            },
            "edges": {
                "pose_id_a": ends[:, 0],
                "pose_id_b": ends[:, 1],
                **{axis: self.measurements[:, k] for k, axis in enumerate(axes)},
                "line": self.edge_lines,
            },
        }

    @property
    def dimension(self) -> int:
        """Dimension of the space: 2 or 3."""
        return 2 if self.poses.shape[1] == 3 else 3

    @property
    def tangent_size(self) -> int:
        """Degrees of freedom of a pose: 3 or 6."""
        return TANGENT[self.poses.shape[1]]

    @property
    def num_poses(self) -> int:
        """Number of poses."""
        return len(self.poses)

    @property
    def num_edges(self) -> int:
        """Number of edges."""
        return len(self.edges)

    @cached_property
    def is_closure(self) -> NDArray[np.bool_]:
        """(m,) True for loop closures: edges of poses that are not neighbors in the order of ids.

        Gaps between ids have no influence. An edge between keys of GTSAM with different letters is
        a closure.
        """
        return freeze(_core.find_closures(self.ids, self.edges))

    @property
    def num_components(self) -> int:
        """Number of connected components."""
        _, count, _ = _core.hold_poses(self)
        return int(count)

    def replace(self, **changes: Any) -> PoseGraph:
        """Return a copy with some attributes changed."""
        poses = immutable("poses", changes.get("poses", self.poses), np.float64)
        if not changes.keys() <= {"poses", "has_poses"} or poses.shape != self.poses.shape:
            return dataclasses.replace(self, **changes)
        # The other arrays are checked and read-only.
        moved = object.__new__(type(self))
        moved.__dict__.update(self.__dict__ | changes, poses=poses)
        check_values("poses", poses, self._ARRAYS["poses"])
        return moved

    @cached_property
    def prepared_edges(self) -> _core.PoseGraphEdges:
        """Normalised measurements and square roots of information, prepared once for all poses.

        Its list ``bad`` has the edges whose information is asymmetric, not positive semidefinite or
        not finite.
        """
        return _core.prepare_edges(self.num_poses, self.edges, self.measurements, self.information)

    def pose_name(self, position: int) -> str:
        """Return the name of a pose in sentences."""
        return self.names[position] if self.names else str(self.ids[position])

    def ends_of(self, position: int) -> tuple[str, str]:
        """Return the names of the poses of an edge."""
        first, second = self.edges[position].tolist()
        return self.pose_name(first), self.pose_name(second)

    def edge_name(self, position: int) -> str:
        """Return the name of an edge in messages: file and line if known, then its ids."""
        line = int(self.edge_lines[position])
        place = f"{self.path}:{line}: " if line and self.path else ""
        first, second = self.ends_of(position)
        return f"{place}edge {first} {second}"

    def __getstate__(self) -> dict[str, Any]:
        return {name: self.__dict__[name] for name in self.__dataclass_fields__}

    def _display(self) -> Display:
        closures = int(self.is_closure.sum())
        facts = [
            ("poses", f"{plural(self.num_poses, 'pose')}, {int(self.fixed.sum())} fixed"),
            ("edges", f"{plural(self.num_edges, 'edge')}, {plural(closures, 'closure')}"),
        ]
        if self.path:
            facts.append(("file", self.path))
        return Display(title=f"PoseGraph in {self.dimension}-D", facts=tuple(facts))
