"""Connected components of images that share points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.components import component_roots
from bundle.synthetic.scene import Pairs

__all__ = ["components"]


def components(pairs: Pairs, num_images: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Label the components of the graph of images and points whose edges are the pairs.

    Every point must have a pair.

    Returns:
        The label of each image (num_images,) and of each point (num_points,): the smallest index of
        an image of the component.
    """
    roots = component_roots(pairs.image, pairs.starts[:-1], num_images)
    return roots, roots[pairs.image[pairs.starts[:-1]]]
