"""Which points an image could observe.

A point is visible when its key lies in the ball of the image, it is no farther than its reach, its
surface faces the camera, it projects into the image and nothing stands in between. Where far more
images see a point than its track needs, pairs are thinned at random before these tests, evenly
over what the image's ball holds, so that the work grows with the observations asked for.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from bundle._core import hardware_threads
from bundle.cameras import project
from bundle.rotations import dot, rotate
from bundle.synthetic.cells import Cells
from bundle.synthetic.intrinsics import Intrinsics
from bundle.synthetic.scene import Pairs, Points, Scene
from bundle.synthetic.scene_options import MIN_OBSERVATIONS_PER_IMAGE

__all__ = ["pixels", "visible_pairs"]

Array = NDArray[np.float64]

# Of the pairs that pass thinning perhaps a third are visible; a track wants some choice of images.
_PAIRS_PER_OBSERVATION = 6.0
# Beyond this, relative to the corner of the image, distortion polynomials may fold back into it.
_FIELD_MARGIN = 1.15
# Their candidates are in memory together.
_IMAGES_AT_A_TIME = 64


def visible_pairs(
    rng: np.random.Generator,
    scene: Scene,
    intrinsics: Intrinsics,
    points: Points,
    lengths: Array,
) -> Pairs:
    """Return who could observe what.

    Args:
        rng: source of the thinning.
        scene: the images, and what their views have in common.
        intrinsics: the true cameras.
        points: the points.
        lengths: (n,) observations that each point wants.
    """
    images = scene.images
    cells = Cells(points.keys, 0.5 * float(np.median(images.ball_radii)))
    by_cell = points.take(cells.order)
    touched = [
        cells.touched_by(center, radius)
        for center, radius in zip(images.ball_centers, images.ball_radii, strict=True)
    ]
    views_of_cell = np.bincount(np.concatenate(touched), minlength=len(cells))
    views = np.repeat(views_of_cell, np.diff(cells.starts))
    share = _PAIRS_PER_OBSERVATION * lengths[cells.order] / np.maximum(views, 1)

    def seen_by(image: int, members: NDArray[np.int64]) -> NDArray[np.int32]:
        members = members[_visible(scene, intrinsics, by_cell, members, image)]
        return cells.order[members].astype(np.int32)

    seen: list[NDArray[np.int32]] = []
    with ThreadPoolExecutor(hardware_threads()) as pool:
        for first in range(0, len(touched), _IMAGES_AT_A_TIME):
            block = range(first, min(first + _IMAGES_AT_A_TIME, len(touched)))
            # Random numbers are drawn in the order of images, whatever the number of threads.
            thinned = [
                _thin(rng, cells.members(touched[image]), share, float(images.richness[image]))
                for image in block
            ]
            seen += pool.map(seen_by, block, thinned)
    image_index = np.repeat(
        np.arange(len(seen), dtype=np.int32), [len(its_points) for its_points in seen]
    )
    point_index = np.concatenate(seen)
    by_point = np.argsort(point_index, kind="stable")
    return Pairs.from_sorted(point_index[by_point], image_index[by_point], len(points))


def pixels(
    scene: Scene,
    intrinsics: Intrinsics,
    positions: Array,
    observation_image: NDArray[np.int32],
    observation_point: NDArray[np.int32],
) -> Array:
    """Return the exact projections (M, 2) of observations, in pixels."""
    xy = np.empty((len(observation_image), 2))
    by_image = np.argsort(observation_image, kind="stable")
    ends = np.cumsum(np.bincount(observation_image, minlength=len(scene.images.centers)))
    for image, part in enumerate(np.split(by_image, ends[:-1])):
        in_camera = _in_camera(scene, positions[observation_point[part]], image)
        xy[part], _ = project(intrinsics.model, intrinsics.of_image(image), in_camera)
    return xy


def _thin(
    rng: np.random.Generator, members: NDArray[np.int64], share: Array, richness: float
) -> NDArray[np.int64]:
    """Keep a share of the members; all where few would be left."""
    keep = share[members] * richness
    if len(members) == 0 or keep.min() >= 1.0:
        return members
    thinned = members[rng.random(len(members)) < keep]
    few = 10 * MIN_OBSERVATIONS_PER_IMAGE
    return thinned if len(thinned) >= few else members


def _visible(
    scene: Scene,
    intrinsics: Intrinsics,
    points: Points,
    candidates: NDArray[np.int64],
    image: int,
) -> NDArray[np.int64]:
    """Return which of the candidates an image sees, as positions in ``candidates``."""
    images = scene.images
    center, focal = images.centers[image], images.focal[image]
    offset = points.keys[candidates] - images.ball_centers[image]
    kept = np.flatnonzero(dot(offset, offset) <= images.ball_radii[image] ** 2)

    to_camera = center - points.positions[candidates[kept]]
    distance = np.sqrt(dot(to_camera, to_camera))
    normals = points.normals[candidates[kept]]
    faces = (dot(normals, to_camera) >= scene.min_cosine * distance) | (dot(normals, normals) == 0)
    kept = kept[faces & (distance <= points.reach[candidates[kept]])]

    in_camera = _in_camera(scene, points.positions[candidates[kept]], image)
    width, height = images.sizes[image]
    corner = 0.5 * np.hypot(width, height) / (focal * max(width, height))
    off_axis = in_camera[:, 0] ** 2 + in_camera[:, 1] ** 2
    in_field = (in_camera[:, 2] > 0) & (off_axis <= (_FIELD_MARGIN * corner * in_camera[:, 2]) ** 2)
    kept, in_camera = kept[in_field], in_camera[in_field]

    xy, valid = project(intrinsics.model, intrinsics.of_image(image), in_camera)
    x, y = xy[:, 0], xy[:, 1]
    inside = valid & (x >= 0) & (x <= width) & (y >= 0) & (y <= height)
    kept = kept[inside]
    visible: NDArray[np.int64] = kept[scene.is_clear(center, points.positions[candidates[kept]])]
    return visible


def _in_camera(scene: Scene, positions: Array, image: int) -> Array:
    images = scene.images
    return rotate(images.rotations[image], positions - images.centers[image])
