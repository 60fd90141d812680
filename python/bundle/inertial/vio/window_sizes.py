"""Sizes of a window's normal equations: rows, columns, nonzeros before and after elimination.

Two coordinates are coupled if a residual depends on both. A reprojection couples a landmark with
the pose that anchors it and with the pose that observes it, an IMU factor two consecutive states, a
prior all its blocks. Eliminating a landmark couples all poses that observe it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bundle.inertial.vio.landmark_table import LandmarkTable

Array = np.ndarray[Any, Any]

BLOCKS = (6, 9)
"""Coordinates of a state: its pose, which images observe, and its velocity and biases."""
POINT = 3


def window_sizes(table: LandmarkTable, window: dict[str, Any], fill_ratio: float) -> dict[str, Any]:
    """Return the sizes of a window's solve, as named in a :class:`KeyframeRecord`.

    Args:
        table: landmarks of the window.
        window: the window in the core's format, with its priors.
        fill_ratio: nonzeros of the factor relative to the reduced matrix; 1 if it is dense.
    """
    states, points = len(window["states"]), len(table.ids)
    camera = np.array([6 * window["refine_camera"], int(window["refine_time_offset"])])
    sizes = np.concatenate([np.tile(BLOCKS, states), camera]).astype(float)
    seen = np.zeros((points, len(sizes)), bool)  # blocks that each landmark is coupled with
    seen[np.arange(points), 2 * table.anchors] = True
    seen[table.landmarks, 2 * table.observers] = True
    observed = np.bincount(table.landmarks, minlength=points) > 0
    seen[observed, 2 * states :] = True
    coupled = np.eye(len(sizes), dtype=bool)
    for first in range(0, 2 * (states - 1), 2):
        coupled[first : first + 4, first : first + 4] = True
    for prior in window["priors"]:
        coupled[np.ix_(prior["blocks"], prior["blocks"])] = True
    direct = coupled.copy()
    for blocks in (2 * table.anchors[table.landmarks], 2 * states, 2 * states + 1):
        direct[2 * table.observers, blocks] = True
        direct[blocks, 2 * table.observers] = True
    reduced = coupled | (seen.T.astype(float) @ seen > 0)
    columns = float(sizes.sum())
    with_points = 2 * POINT * float((seen @ sizes).sum()) + POINT**2 * points
    nonzeros = float(sizes @ reduced @ sizes)
    priors = [len(prior["vector"]) for prior in window["priors"]]
    lower = (nonzeros + columns) / 2
    return {
        "window_size": states,
        "num_landmarks": points,
        "num_observations": len(table.landmarks),
        "num_rows": 2 * (len(table.landmarks) + points) + 15 * (states - 1) + sum(priors),
        "num_columns": int(columns) + POINT * points,
        "num_prior_columns": int(sum(sizes[prior["blocks"]].sum() for prior in window["priors"])),
        "num_information_nonzeros": int(sizes @ direct @ sizes + with_points),
        "num_reduced_nonzeros": int(nonzeros),
        "num_factor_nonzeros": round(
            fill_ratio * lower if fill_ratio != 1 else columns * (columns + 1) / 2
        ),
    }
