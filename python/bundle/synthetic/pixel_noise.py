"""Noise and outliers of measured positions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.interface.scene_options import SceneOptions

Array = NDArray[np.float64]


def measure(
    rng: np.random.Generator, xy: Array, sizes: NDArray[np.int64], options: SceneOptions
) -> tuple[Array, NDArray[np.bool_]]:
    """Return measured positions (M, 2) in pixels, and the mask of outliers (M,).

    If noise would move an observation out of the image, its sign is reversed. This preserves its
    magnitude.

    Args:
        rng: source of noise and outliers.
        xy: (M, 2) exact positions.
        sizes: (M, 2) width and height of the image of each observation.
        options: amount of noise and outliers.
    """
    noise = options.pixel_noise * rng.standard_normal(xy.shape)
    measured = xy + noise
    measured = np.where((measured < 0) | (measured > sizes), xy - noise, measured)
    outliers = rng.permutation(len(xy))[: round(options.outlier_share * len(xy))]
    measured[outliers] = rng.random((len(outliers), 2)) * sizes[outliers]
    is_outlier = np.zeros(len(xy), dtype=np.bool_)
    is_outlier[outliers] = True
    return measured, is_outlier
