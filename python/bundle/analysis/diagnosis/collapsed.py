"""Clusters of points that have collapsed onto the cameras that observe them.

A solve can shrink a loosely connected part of a scene until its points lie on its cameras. Their
depths are then orders of magnitude below the others, and their derivatives as much larger. All
parts connected to such points move with them, so a connected component is one cluster.
"""

from __future__ import annotations

import numpy as np

from bundle.analysis.diagnosis.diagnosis_result import CollapsedCluster
from bundle.analysis.diagnosis.id_lists import sorted_ids
from bundle.analysis.diagnosis.track_table import TrackTable
from bundle.analysis.statistics.depths import collapsed_observations, depths_of_observations
from bundle.model.problem import Problem

__all__ = ["collapsed_clusters"]


def collapsed_clusters(problem: Problem, tracks: TrackTable) -> tuple[CollapsedCluster, ...]:
    """Return the clusters, the one with the most observations first."""
    mask = collapsed_observations(problem, depths_of_observations(problem))
    chosen = np.flatnonzero(mask)
    if not len(chosen):
        return ()
    images, points = problem.observation_image[chosen], problem.observation_point[chosen]
    piece = tracks.pieces[images]
    clusters = []
    for one in np.unique(piece).tolist():
        own = piece == one
        clusters.append(
            CollapsedCluster(
                point_ids=sorted_ids(problem.point_ids, np.unique(points[own])),
                image_ids=sorted_ids(problem.image_ids, np.unique(images[own])),
                num_observations=int(own.sum()),
            )
        )
    return tuple(sorted(clusters, key=lambda cluster: -cluster.num_observations))
