"""Values of the edges of a pose graph without a solve: poses to start from, and chi^2."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arguments import check_type
from bundle.graphs.pose_graphs.information import checked_information
from bundle.interface.option_fields import choice
from bundle.interface.pose_graph_options import POSE_ERRORS
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.starts import started


def initial_poses(graph: PoseGraph, init: str = "chordal") -> NDArray[np.float64]:
    """Return poses from edges alone, relative to the fixed or first pose of each component.

    Args:
        graph: pose graph; not modified.
        init: "odometry", "spanning_tree" or "chordal".

    Raises:
        InputError: for the reasons of :func:`bundle.solve`.
    """
    check_type("graph", graph, PoseGraph)
    init = choice("init", init, ("odometry", "spanning_tree", "chordal"))
    held, _, _ = _core.hold_poses(graph)
    return started(checked_information(graph, "file"), held, init, 1).poses


def pose_graph_chi2(graph: PoseGraph, error: str = "log") -> NDArray[np.float64]:
    """Return r^T Omega r of each edge at the graph's poses: (m,).

    Args:
        graph: pose graph; not modified.
        error: "log", "g2o" or "ceres", as in :class:`PoseGraphOptions`.

    Raises:
        InputError: an information matrix is asymmetric or indefinite.
    """
    check_type("graph", graph, PoseGraph)
    error = choice("error", error, POSE_ERRORS)
    return _core.edge_chi2(checked_information(graph, "file"), error)
