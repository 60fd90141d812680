"""Connected components of the graph of images and points.

Two images are connected if they observe a common point. The algorithm is that of Shiloach and
Vishkin (1982). Every image starts as its own tree. In each round, the root of every tree is linked
to the smallest root among the images with a common point. Then all paths are compressed. The
algorithm ends after about log(num_images) rounds, even for long chains.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def component_roots(
    images: NDArray[Any], starts: NDArray[np.int64], num_images: int
) -> NDArray[np.int64]:
    """Return, for each image, the smallest image index in its component, (num_images,).

    ``images``: (num_observations,) image of each observation, sorted by point. ``num_images``:
    number of images. An image without observations is its own component.
    """
    root = np.arange(num_images)
    lengths = np.diff(starts, append=len(images))
    while len(images):
        reached = np.repeat(np.minimum.reduceat(root[images], starts), lengths)
        hooked = root.copy()
        np.minimum.at(hooked, root[images], reached)
        while not np.array_equal(hooked, shorter := hooked[hooked]):
            hooked = shorter
        if np.array_equal(hooked, root):
            break
        root = hooked
    return root
