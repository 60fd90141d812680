"""Connected components of images that share points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.synthetic.scene import Pairs

__all__ = ["components"]


def components(pairs: Pairs, num_images: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Label the components of the graph of images and points whose edges are the pairs.

    Every point must have a pair. Every image starts as a tree of its own; points hook the roots of
    the images that see them onto the smallest of these roots, and trees are flattened after every
    round, so that rounds are few even for long chains.

    Returns:
        The label of each image (num_images,) and of each point (num_points,): the smallest index of
        an image of the component.
    """
    parent = np.arange(num_images)
    while True:
        root = parent[pairs.image]
        smallest = np.minimum.reduceat(root, pairs.starts[:-1])
        target = np.repeat(smallest, pairs.counts)
        if np.array_equal(root, target):
            return parent, smallest
        np.minimum.at(parent, root, target)
        while not np.array_equal(parent, parent[parent]):
            parent = parent[parent]
