"""Points that the observations determine weakly or not at all.

Let u_i be the unit vectors of the rays from the camera centres to a point. They differ by at most
2 max |u_i - mean u| and by at least max |u_i - mean u|. For small values this is an angle. The
bound avoids a loop over all pairs of rays.

A solve can shrink a loosely connected part of a scene until its points lie on its cameras. Their
depths are then orders of magnitude below the others. All parts connected to such points move with
them, so a connected component is one cluster of collapsed points.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.diagnosis.diagnosis_result import CollapsedCluster
from bundle.analysis.diagnosis.track_table import TrackTable
from bundle.analysis.statistics.depths import collapsed_observations, depths_of_observations
from bundle.base.records import dataclass
from bundle.base.words import sorted_ids
from bundle.model.problem import Problem

AT_CAMERA = 1e-6
"""Share of the median distance of points from their cameras."""
PARALLEL = 1e-4
"""Limit in radians; rays with smaller differences put a point beyond ten thousand baselines."""

Ids = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class PointChecks:
    """Ids of points; see :class:`bundle.analysis.diagnosis.diagnosis_result.Diagnosis`."""

    unobserved: Ids
    seen_once: Ids
    seen_twice: Ids
    at_cameras: Ids
    at_infinity: Ids


def check_points(problem: Problem, tracks: TrackTable) -> PointChecks:
    """Return the points, grouped by the kind of their deficiency."""
    lengths, images, points = tracks.lengths, tracks.images, tracks.points
    rays = problem.points[points] - problem.projection_centers[images]
    distances = np.linalg.norm(rays, axis=1)
    usual = float(np.median(distances)) if len(distances) else 0.0
    at_camera = np.zeros(problem.num_points, bool)
    at_camera[points[distances <= AT_CAMERA * usual]] = True
    far = np.zeros(problem.num_points, bool)
    if len(points):
        rays /= np.maximum(distances, np.finfo(float).tiny)[:, None]
        starts = np.flatnonzero(np.diff(points, prepend=-1))
        counts = np.diff(starts, append=len(points))
        mean = np.add.reduceat(rays, starts) / counts[:, None]
        off = np.linalg.norm(rays - np.repeat(mean, counts, axis=0), axis=1)
        spread = np.maximum.reduceat(off, starts)
        far[points[starts]] = (spread < PARALLEL / 2) & (counts > 1)
    ids = problem.point_ids
    return PointChecks(
        unobserved=ids[lengths == 0],
        seen_once=ids[lengths == 1],
        seen_twice=ids[lengths == 2],
        at_cameras=ids[at_camera],
        at_infinity=ids[far & ~at_camera],
    )


def collapsed_clusters(problem: Problem, tracks: TrackTable) -> tuple[CollapsedCluster, ...]:
    """Return the clusters of collapsed points, the one with the most observations first."""
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
