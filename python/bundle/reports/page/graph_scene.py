"""3-D view of a graph: poses as points and frames, edges as lines (``scene_section.py``).

Poses are drawn as small frusta that look along the x axis of the body, with z up.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.figures.graph_figures import DrawnGraph
from bundle.figures.scene_view import SceneView
from bundle.reports.page.graph_facts import GraphFacts
from bundle.reports.page.scene_section import packed, scene_data, scene_section

MOST_FRAMES = 1500
MOST_POINTS, MOST_LINES = 60_000, 60_000

FIELD = 0.4
"""Tangent of half the drawn field of view."""


def graph_scene(facts: GraphFacts, drawn: DrawnGraph) -> tuple[str, dict[str, Any] | None]:
    """Return the section of the view and its data; None without positions."""
    places = drawn.positions
    if not len(places):
        return "", None
    there = facts.is_placed
    rotations = facts.rotations[there]
    low, high = np.quantile(places, [0.02, 0.98], axis=0)
    origin, unit = (low + high) / 2, max(float((high - low).max()) / 2, 1e-12)
    step = max(1, -(-len(places) // MOST_POINTS))
    points = np.arange(0, len(places), step)
    frames = np.arange(0, len(places), max(1, -(-len(places) // MOST_FRAMES)))
    errors = _worst_of_each(facts, there)[points]
    reach = float(np.quantile(np.linalg.norm((places - origin) / unit, axis=1), 0.98))

    def view(positions: NDArray[np.float64]) -> SceneView:
        placed = (positions - origin) / unit
        return SceneView(
            origin=origin,
            unit=unit,
            points=placed[points],
            point_indices=points,
            point_errors=errors,
            step=step,
            num_far=0,
            centers=placed[frames],
            image_indices=frames,
            image_ids=frames,
            axes=rotations[frames][:, :, [1, 2, 0]].transpose(0, 2, 1) * [[-1.0], [-1.0], [1.0]],
            half_fields=np.full((len(frames), 2), FIELD),
            middle=np.zeros(3),
            reach=max(reach, 1e-3),
            up=np.array([0.0, 0, 1]),
            forward=np.array([0.0, 1, 0]),
        )

    now = view(places)
    before = None
    if drawn.before is not None and np.isfinite(drawn.before).all():
        before = view(drawn.before)
    data = scene_data(now, before, error=("worst edge", "chi2"))
    data["frustum"] /= 2
    data["edges"] = {
        "path": _pairs(drawn.path, step, len(points)),
        "others": _pairs(drawn.others, step, len(points)),
    }
    section = scene_section(
        now,
        len(places),
        is_solved=before is not None,
        parts={"points": "poses", "cameras": "frames", "edges": "edges"},
        nouns=("pose", "frame"),
    )
    return section, data


def _worst_of_each(facts: GraphFacts, there: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the largest chi2 of the edges of each variable with a position."""
    worst = np.zeros(len(facts.positions))
    chi2 = np.nan_to_num(facts.chi2)
    for end in (0, 1):
        np.maximum.at(worst, facts.ends[:, end], chi2)
    found: NDArray[np.float64] = worst[there]
    return found


def _pairs(edges: NDArray[np.int64], step: int, count: int) -> str:
    """Return pairs of drawn points, packed; edges of points that are left out are left out."""
    kept = edges[(edges % step == 0).all(axis=1)] // step
    kept = kept[(kept < count).all(axis=1)]
    return packed(kept[:: max(1, -(-len(kept) // MOST_LINES))].astype(float))
