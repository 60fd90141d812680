"""Shared images of two models: common keypoints, and pairs of points observed at them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pycolmap
from numpy.typing import NDArray

__all__ = ["SAME_KEYPOINT", "SharedView", "shared_keypoints"]

SAME_KEYPOINT = 0.01
"""Largest difference in x and y, in pixels, of keypoints with the same index: single precision and
text files round coordinates."""


@dataclass(frozen=True)
class SharedView:
    """Meetings: pairs of points of two models that are observed at the same shared keypoint.

    Attributes:
        image: (n,) index of the shared image, in the caller's order.
        point_a: (n,) id of the point of A.
        point_b: (n,) id of the point of B.
        keypoints: for each shared image, table from observed keypoints of B to keypoints of A; None
            if A's image lacks the keypoint.
    """

    image: NDArray[np.int64]
    point_a: NDArray[np.int64]
    point_b: NDArray[np.int64]
    keypoints: tuple[dict[int, int | None], ...]


def shared_keypoints(
    a: pycolmap.Reconstruction, b: pycolmap.Reconstruction, images: list[tuple[int, int]]
) -> SharedView:
    """Return the common keypoints of shared images, and the pairs of points observed at them.

    Args:
        a: the first model.
        b: the second model.
        images: ids in A and in B of each shared image.
    """
    rows: list[tuple[int, int, int]] = []
    maps = []
    for index, (id_a, id_b) in enumerate(images):
        image_a, image_b = a.image(id_a), b.image(id_b)
        same = _same_keypoints(image_a, image_b)
        maps.append(same)
        for keypoint, other in same.items():
            if other is not None and image_a.point2D(other).has_point3D():
                ids = (
                    image_a.point2D(other).point3D_id,
                    image_b.point2D(keypoint).point3D_id,
                )
                rows.append((index, *ids))
    table = np.array(rows, np.int64).reshape(-1, 3)
    return SharedView(table[:, 0], table[:, 1], table[:, 2], tuple(maps))


def _same_keypoints(a: pycolmap.Image, b: pycolmap.Image) -> dict[int, int | None]:
    """Return A's keypoint for each observed keypoint of B, by index or else by coordinates.

    In models from the same database, keypoint indices agree. If a model was written with observed
    keypoints only, indices differ but coordinates agree. Coordinates shared by several keypoints of
    A are ambiguous and ignored.
    """
    xy = np.array([point.xy for point in a.points2D]).reshape(-1, 2)
    places: dict[tuple[float, float], int] = {}
    for index, (x, y) in enumerate(xy.tolist()):
        places[x, y] = -1 if (x, y) in places else index
    same: dict[int, int | None] = {}
    others = []
    for keypoint in map(int, b.get_observation_point2D_idxs()):
        at = b.point2D(keypoint).xy
        if keypoint < len(xy) and np.abs(xy[keypoint] - at).max() <= SAME_KEYPOINT:
            same[keypoint] = keypoint
        else:
            others.append(keypoint)
    taken = set(same.values())
    for keypoint in others:
        x, y = b.point2D(keypoint).xy.tolist()
        found = places.get((x, y), -1)
        same[keypoint] = None if found < 0 or found in taken else found
        taken.add(found)
    return same
