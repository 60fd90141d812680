"""Covisibility edges: information of a model on the relative poses of its images.

Let images i and j observe a point X, with x = R_j X + t_j in the frame of j. The point is fixed to
one image; the other observes it. If j moves relative to i by d = (w, t, l), rotation, translation
and log scale in its own frame, x moves by G d, G = [-[x]x, I, x]. An image observes this motion as
an angle. Let u be the direction of the point from the image, r its distance and f the focal length.
Pixels move by f / r (I - u u^T) times the motion of the point: exactly in the centre of the image
and approximately elsewhere. The information is

    W = sum over points  w_X G^T (f_i^2 / r_i^2 (I - u_i u_i^T) + f_j^2 / r_j^2 (I - u_j u_j^T)) G,

all in the frame of j. An image cannot observe a scaling about its own centre, but both images
together observe all seven numbers: a scaling about one centre is a scaling about the other plus a
shift along the baseline. W therefore has little information on scale if the parallax is small. This
is the case in which a monocular model drifts.

A track of n images has 2 n measurements and a point of 3 coordinates, so 2 n - 3 of them inform the
poses. Pairs of images would count them repeatedly. p pairs have 4 p numbers, so that each is
weighted by

    w_X = (2 n - 3) / (4 p).

This assumes that a point is constant while it is carried, so that W is somewhat too large.
:mod:`.loop_graph` estimates the excess from the closures.

If a drifted model returns to a place, points observed in both passes fit at most one pass. If two
images do not both fit a point, the intersection of their rays is used instead, if they intersect.
In this way, common points connect images of the same pass. The rays of images of different passes
are skew, so that these images are not connected by mistake. An edge requires that at least half of
the shared points are usable.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.model.cameras import camera_models, param_kinds
from bundle.model.lenses.exact_image import pixel_directions
from bundle.model.problem import Problem
from bundle.model.residuals import reprojection_errors
from bundle.model.rigid_motions import cross_matrices, dot, quaternion_inverse, quaternion_rotate

Array = NDArray[np.float64]

MIN_SHARED = 6  # smallest number of points that two images must share for an edge
MOST_NEIGHBOURS = 10
"""Number of following images on a point's track with which an image forms pairs."""
MAX_ERROR = 4.0
"""Largest error in pixels of an observation in use; MEDIANS times the median if that is larger."""
MEDIANS = 5.0
LEAST_SINE = 0.02  # smallest sine of the angle of two rays that are intersected
_ROWS = 50_000


@dataclass(frozen=True)
class CovisibilityEdges:
    """Pairs of images that share points."""

    pairs: NDArray[np.int64]  # (m, 2) indices of images, ascending
    num_shared: NDArray[np.int64]  # (m,) number of shared points in use
    # (m, 7, 7) information of the second image relative to the first, in the frame of the second:
    # rotation, translation, log scale; observations have a sigma of 1 px, or their own
    information: Array


def fitting_observations(problem: Problem) -> NDArray[np.bool_]:
    """Return the mask (num_observations,) of observations that fit the model."""
    errors, unseen = reprojection_errors(problem)
    known = np.isfinite(errors) & ~unseen
    fits: NDArray[np.bool_] = known & (errors <= _limit(errors[known]))
    return fits


def covisibility_edges(problem: Problem, fitting: NDArray[np.bool_]) -> CovisibilityEdges:
    """Return the edges between images that share enough points; see the head of the file.

    Args:
        problem: the model; not modified.
        fitting: (num_observations,) mask of observations that fit the model.
    """
    views = _views(problem, fitting)
    point, image = views.point, views.image
    length = np.bincount(point, minlength=problem.num_points).astype(np.float64)
    weight = np.maximum(2 * length - 3, 0.0) / np.maximum(4 * _pairs_per_track(length), 1.0)
    sums = _Sums()
    for lag in range(1, min(MOST_NEIGHBOURS, max(len(point) - 1, 0)) + 1):
        first = np.flatnonzero((point[:-lag] == point[lag:]) & (image[:-lag] != image[lag:]))
        for begin in range(0, len(first), _ROWS):
            i = first[begin : begin + _ROWS]
            block, counts = _information(views, i, i + lag)
            code = image[i] * problem.num_images + image[i + lag]
            sums.add(code, weight[point[i], None, None] * block, counts)
    code, block, counted, shared = sums.all()
    kept = (counted >= MIN_SHARED) & (2 * counted >= shared)
    pairs = np.stack(np.divmod(code[kept], max(problem.num_images, 1)), axis=1)
    return CovisibilityEdges(pairs, counted[kept], block[kept])


class _Views(NamedTuple):
    """Observations sorted by point, then image, with their directions in the world."""

    image: NDArray[np.int64]
    point: NDArray[np.int64]
    fits: NDArray[np.bool_]
    center: Array
    rotation: Array  # quaternions of cam_from_world
    to_point: Array  # vector from the centre to the model's point
    ray: Array  # unit vector of the pixel; nan if unknown
    weight: Array  # focal length in sigmas
    limit: Array  # largest error as an angle


def _views(problem: Problem, fitting: NDArray[np.bool_]) -> _Views:
    order = np.lexsort((problem.observation_image, problem.observation_point))
    image = problem.observation_image[order].astype(np.int64)
    point = problem.observation_point[order].astype(np.int64)
    poses = problem.cam_from_world[image]
    rotation = poses[:, :4] / np.linalg.norm(poses[:, :4], axis=1, keepdims=True)
    center = -quaternion_rotate(quaternion_inverse(rotation), poses[:, 4:])
    local, focal = np.full((len(order), 3), np.nan), np.ones(len(order))
    camera, xy = problem.image_camera[image], problem.observation_xy[order]
    for index in np.unique(camera).tolist():
        mine = camera == index
        model = problem.camera_models[index]
        params = problem.camera_params[index, : len(camera_models()[model])]
        local[mine] = pixel_directions(model, params.tolist(), xy[mine])
        kinds = np.array(param_kinds(model))
        focal[mine] = params[kinds == "focal"].mean()
    local /= np.linalg.norm(local, axis=1, keepdims=True)
    errors, _ = reprojection_errors(problem)
    sigma = problem.observation_sigma
    return _Views(
        image=image,
        point=point,
        fits=fitting[order],
        center=center,
        rotation=rotation,
        to_point=problem.points[point] - center,
        ray=quaternion_rotate(quaternion_inverse(rotation), local),
        weight=focal if sigma is None else focal / sigma[order],
        limit=_limit(errors[np.isfinite(errors)]) / focal,
    )


def _information(
    views: _Views, i: NDArray[np.int64], j: NDArray[np.int64]
) -> tuple[Array, NDArray[np.bool_]]:
    """Return information (n, 7, 7) of pairs of observations, and the mask of pairs in use."""
    both = views.fits[i] & views.fits[j]
    met, of_i, of_j = _meet(views, i, j)
    from_i = np.where(both[:, None], views.to_point[i], of_i)
    from_j = np.where(both[:, None], views.to_point[j], of_j)
    counts = both | met
    from_i[~counts] = from_j[~counts] = 1.0
    turn = views.rotation[j]
    seen = np.zeros((len(i), 3, 3))
    for ends, of_end in ((i, from_i), (j, from_j)):
        x = quaternion_rotate(turn, of_end)
        squared = dot(x, x)[:, None, None]
        across = np.eye(3) - x[:, :, None] * x[:, None, :] / squared
        seen += (views.weight[ends] ** 2)[:, None, None] / squared * across
    x = quaternion_rotate(turn, from_j)
    g = np.zeros((len(i), 3, 7))
    g[:, :, :3] = -cross_matrices(x)
    g[:, :, 3:6] = np.eye(3)
    g[:, :, 6] = x
    block = np.swapaxes(g, 1, 2) @ seen @ g
    block[~counts] = 0.0
    return block, counts


def _meet(
    views: _Views, i: NDArray[np.int64], j: NDArray[np.int64]
) -> tuple[NDArray[np.bool_], Array, Array]:
    """Return the mask of ray pairs that intersect before both cameras, and the distances."""
    u, v = views.ray[i], views.ray[j]
    b = views.center[j] - views.center[i]
    cosine, along_u, along_v = dot(u, v), dot(b, u), dot(b, v)
    sine_squared = 1 - cosine**2
    with np.errstate(invalid="ignore", divide="ignore"):
        s = (along_u - cosine * along_v) / sine_squared
        t = (cosine * along_u - along_v) / sine_squared
        of_i, of_j = s[:, None] * u, t[:, None] * v
        apart = b + of_j - of_i
        miss = 0.5 * np.sqrt(dot(apart, apart))
        near = miss <= np.minimum(s * views.limit[i], t * views.limit[j])
        meet: NDArray[np.bool_] = near & (s > 0) & (t > 0) & (sine_squared > LEAST_SINE**2)
    return meet, of_i, of_j


class _Sums:
    """Sums of blocks by pair of images, accumulated chunk by chunk."""

    def __init__(self) -> None:
        self._parts: list[tuple[NDArray[np.int64], Array, NDArray[np.int64]]] = []

    def add(self, code: NDArray[np.int64], block: Array, counts: NDArray[np.bool_]) -> None:
        """Add blocks (n, 7, 7) and their mask to the sums of their pairs."""
        both = np.stack([counts, np.ones_like(counts)], axis=1).astype(np.int64)
        self._parts.append(_summed(code, block, both))

    def all(self) -> tuple[NDArray[np.int64], Array, NDArray[np.int64], NDArray[np.int64]]:
        """Return pairs (ascending), their sums, and the numbers of valid and of all blocks."""
        if not self._parts:
            none = np.empty(0, np.int64)
            return none, np.empty((0, 7, 7)), none, none
        code, block, both = _summed(
            *(np.concatenate(part) for part in zip(*self._parts, strict=True))
        )
        return code, block, both[:, 0], both[:, 1]


def _summed(
    code: NDArray[np.int64], block: Array, counts: NDArray[np.int64]
) -> tuple[NDArray[np.int64], Array, NDArray[np.int64]]:
    order = np.argsort(code, kind="stable")
    found, starts = np.unique(code[order], return_index=True)
    if not len(found):
        return found, block[:0], counts[:0]
    return found, np.add.reduceat(block[order], starts), np.add.reduceat(counts[order], starts)


def _limit(errors: Array) -> float:
    """Return the error in pixels above which an observation does not fit the model."""
    return max(MAX_ERROR, MEDIANS * float(np.median(errors))) if len(errors) else MAX_ERROR


def _pairs_per_track(length: Array) -> Array:
    lags = np.minimum(np.maximum(length - 1, 0), MOST_NEIGHBOURS)
    pairs: Array = lags * length - 0.5 * lags * (lags + 1)
    return pairs
