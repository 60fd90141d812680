"""Viewing geometry of a set of images: causes of weakly separable intrinsics and poses.

Let all images of a camera look along one direction d. Stretching the world along d by s, together
with the focal length, changes no pinhole image: x = f X / Z. If images are only shifted against
each other, along d or across it, no scene separates the focal length from the depth. Rotated images
do separate them. Over a flat scene across d, stretching moves only the images ("height"). Then even
slightly inclined images separate focal length and depth poorly (Wu 2014: Critical configurations
for radial distortion self-calibration; Sturm 1997: critical motion sequences).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.model.problem import Problem
from bundle.model.rotations import quaternion_inverse, quaternion_rotate

ONE_PLACE = 1e-3
"""Spread of images, relative to the distance of their points, that counts as pure rotation."""
PARALLEL_DEGREES = 12.0
"""Root mean square angle to their mean, below which viewing directions count as equal."""
FLAT = 0.1
"""Relief of a flat scene, relative to the distance of the points."""
ALONG_DEGREES = 30.0
"""Angle to the viewing direction, below which a path counts as forward motion."""
MOST_POINTS = 20000

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Viewing:
    """Viewing geometry of images.

    Attributes:
        spread_degrees: root mean square angle of the viewing directions to their mean.
        baseline: root mean square distance of the projection centres from their middle, in median
            distances of points.
        relief: root mean square distance of the points from their plane (or line), likewise, from
            the tenth to the ninetieth percentile.
        tilt_degrees: angle of the mean viewing direction to the plane's normal.
        path_degrees: angle of the mean viewing direction to the main direction of the path.
        path_share: share of the path along its main direction, 1 for a straight line.
    """

    spread_degrees: float
    baseline: float
    relief: float
    tilt_degrees: float
    path_degrees: float
    path_share: float

    @property
    def cause(self) -> str:
        """Name of the critical configuration that these images are in or near; "": none."""
        if self.baseline < ONE_PLACE:
            return "pure_rotation"
        if self.spread_degrees > PARALLEL_DEGREES:
            return ""
        forward = self.path_degrees < ALONG_DEGREES and self.path_share > 0.9
        if forward:
            return "forward_motion"
        if self.relief < FLAT and self.tilt_degrees < 45:
            return "flat_scene"
        return "parallel_views"


def viewing(problem: Problem, images: NDArray[np.int64]) -> Viewing | None:
    """Return the viewing geometry of these images; None if they observe nothing."""
    chosen = np.flatnonzero(np.isin(problem.observation_image, images))
    if not len(chosen) or not len(images):
        return None
    chosen = chosen[:: max(len(chosen) // MOST_POINTS, 1)]
    points = problem.points[problem.observation_point[chosen]]
    centers = problem.projection_centers
    away = np.linalg.norm(points - centers[problem.observation_image[chosen]], axis=1)
    distance = float(np.median(away)) or 1.0
    axes = quaternion_rotate(
        quaternion_inverse(problem.cam_from_world[images, :4]), np.array([0.0, 0.0, 1.0])
    )
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    mean = axes.mean(axis=0)
    length = float(np.linalg.norm(mean))
    mean = mean / length if length > 0 else axes[0]
    off = np.degrees(np.arccos(np.clip(axes @ mean, -1, 1)))
    _, spans, path = np.linalg.svd(centers[images] - centers[images].mean(axis=0))
    total = float((spans**2).sum())
    relief, normal = plane(points)
    return Viewing(
        spread_degrees=float(np.sqrt((off**2).mean())),
        baseline=float(np.sqrt(total / len(images))) / distance,
        relief=relief / distance,
        tilt_degrees=_angle(normal, mean),
        path_degrees=_angle(path[0], mean),
        path_share=float(spans[0] ** 2 / total) if total > 0 else 0.0,
    )


def plane(points: Vector) -> tuple[float, Vector]:
    """Return relief and normal of the plane through points, without the farthest tenth of them."""
    middle = np.median(points, axis=0)
    far = np.linalg.norm(points - middle, axis=1)
    inner = points[far <= np.quantile(far, 0.9)] - middle
    if len(inner) < 3:
        return 0.0, np.array([0.0, 0.0, 1.0])
    _, normals = np.linalg.eigh(inner.T @ inner)
    heights = inner @ normals[:, 0]
    low, high = np.quantile(heights, [0.1, 0.9])
    return float(high - low) / 2.56, normals[:, 0]


def _angle(a: Vector, b: Vector) -> float:
    """Return the angle between two lines in degrees."""
    return float(np.degrees(np.arccos(min(abs(float(a @ b)), 1.0))))
