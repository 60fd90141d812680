"""Normal equations of a graph at its values, with a named block for each pose or variable.

Covariances, diagnosis and chi2 by kind are written once, on these blocks. A pose graph keeps its
arrays and its elimination (``graph_covariance.cpp`` has the mathematics); ``factor_equations.py``
has the normal equations of a factor graph. The terms are edges or factors.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.graphs.pose_graphs.edge_weights import WeightedGraph
from bundle.graphs.pose_graphs.joints import Joints, find_joints

AT_MINIMUM = 1e-4
"""Relative decrease of the cost by one more step, below which a state counts as a minimum."""

Floats = NDArray[np.float64]
Pairs = Sequence[tuple[int, int]]
"""Positions of two blocks each."""


class Words(NamedTuple):
    """Nouns and remedies of a graph in sentences."""

    block: str
    term: str
    held: str
    command: str
    shorten: str
    doubt: str


class TermTests(NamedTuple):
    """Redundancy and test (m,) of the terms, NaN where unknown, with the test's degrees.

    ``decrease``: decrease of the cost by one more step.
    """

    redundancy: Floats
    test: Floats
    rank: NDArray[np.int64]
    decrease: float = 0.0

    def is_at_minimum(self, cost: float) -> bool:
        """Tell whether one more step would hardly lower the cost."""
        return not (self.decrease > AT_MINIMUM * cost and self.decrease > 1e-9)


class SelectedInverse(NamedTuple):
    """Blocks (t, t) of the inverse: of each block, of X_a^-1 X_b of a pair, and across the pair.

    ``undetermined``: position of a block that is not determined; -1 without one. ``inflation``:
    largest ratio of a variance to the variance with all other blocks known.
    """

    blocks: Any
    relative: Any
    across: Any
    undetermined: int
    inflation: float
    tests: TermTests


class NormalEquations(Protocol):
    """J^T W J of a graph, with a block of t tangent coordinates for each key."""

    words: Words  # nouns of the input
    num_gauge: int  # null directions in which whole components move
    num_floating: int  # components, each with covariances relative to itself
    squares: Floats  # r^T W r of each term
    weighted_squares: float  # their sum, with the weights of a loss
    cost: float  # 1/2 sum rho
    dof: int  # number of residuals minus free coordinates under the gauge

    def name(self, block: int) -> str:
        """Return the name of a block for sentences."""

    def open_blocks(self) -> list[int]:
        """Return the blocks that null directions beyond the gauge move; empty if there are none."""

    def separated(self, pairs: Pairs) -> tuple[int, int] | None:
        """Return the first pair of blocks whose components move against each other."""

    def selected_inverse(
        self, is_inner: bool = False, pairs: Pairs = (), with_tests: bool = False
    ) -> SelectedInverse:
        """Return blocks of the inverse; ``is_inner``: of the pseudo-inverse."""

    @property
    def spectrum(self) -> dict[str, Any] | None:
        """Eigenvalues and condition numbers of the determined part."""


POSES = Words(
    *("pose", "edge", "fixed pose", "bundle diagnose"),
    "fix a pose in the middle, or split the graph",
    "refine with a loss for wrong closures (dcs, gnc-tls)",
)


class PoseEquations:
    """Normal equations of a pose graph; :class:`NormalEquations`."""

    words = POSES

    def __init__(self, weighted: WeightedGraph) -> None:
        self.weighted, self.graph = weighted, weighted.graph
        self._error, self._threads = weighted.options.error, weighted.options.num_threads
        self.held, _, self.for_gauge = _core.hold_poses(self.graph)
        self.squares = _core.edge_chi2(self.graph, self._error)
        self.weighted_squares = float(self.squares.sum())
        self.cost = 0.5 * self.weighted_squares
        self.num_floating = len(self.for_gauge)
        self.num_gauge = self.graph.tangent_size * self.num_floating
        self.held_ids = tuple(int(self.graph.ids[pose]) for pose in self.for_gauge)
        self.dof = self.graph.tangent_size * (self.graph.num_edges - int((~self.held).sum()))

    @cached_property
    def joints(self) -> Joints:
        """Undetermined and weak directions."""
        return find_joints(self.graph, self.held, self._error)

    def name(self, block: int) -> str:
        """Return the name of a block."""
        return self.graph.pose_name(block)

    def open_blocks(self) -> list[int]:
        """Return the blocks that null directions beyond the gauge move."""
        if not self.joints.num_open:
            return []
        moved = np.flatnonzero(self.joints.directions.any(axis=1)) // self.graph.tangent_size
        poses = moved.tolist() or [int(joint.poses[0]) for joint in self.joints.opened]
        return list(dict.fromkeys(poses))

    def separated(self, pairs: Pairs) -> tuple[int, int] | None:
        """Return the first pair whose components move against each other."""
        component = np.asarray(_core.pose_components(self.graph.num_poses, self.graph.edges))
        floating = set(component[self.for_gauge].tolist())
        for a, b in pairs:
            if component[a] != component[b] and {int(component[a]), int(component[b])} & floating:
                return a, b
        return None

    def selected_inverse(
        self, is_inner: bool = False, pairs: Pairs = (), with_tests: bool = False
    ) -> SelectedInverse:
        """Return blocks of the inverse."""
        out = _core.graph_covariance(
            self.graph, self._error, is_inner, with_tests, list(pairs), self._threads
        )
        redundancy, test, rank = (out[f"edge_{name}"] for name in ("redundancy", "test", "rank"))
        tests = TermTests(redundancy, test, rank, float(out["predicted_decrease"]))
        found = (int(out["undetermined_pose"]), float(out["inflation"]), tests)
        return SelectedInverse(out["poses"], out["relative"], out["across"], *found)

    @property
    def spectrum(self) -> dict[str, Any] | None:
        """Spectrum of the determined part; None without a free pose."""
        if self.held.all():
            return None
        directions = self.joints.directions
        return _core.graph_spectrum(self.graph, self.held, self._error, directions, self._threads)
