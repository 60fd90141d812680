"""Inverse projection by COLMAP's camera models: from pixels to the plane z = 1 of the camera.

``bundle.model.cameras`` has the projections. COLMAP inverts most models by Newton's method
(src/colmap/sensor/models.h, CamFromImg). Without pycolmap, ``bundle.model.lenses.pixel_rays``
inverts the model. It has machine precision but is slower.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bundle.base.optional_packages import has_pycolmap
from bundle.model.lenses.pixel_rays import pixel_rays


def normalized(model: str, params: Sequence[float], xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return undistorted coordinates (N, 2) on the plane z = 1 of the camera.

    Args:
        params: parameters of the model in COLMAP's order, without padding.
        xy: (N, 2) pixels.
    """
    if not has_pycolmap():
        directions, seen = pixel_rays(model, np.array(params, np.float64), xy)
        plane: NDArray[np.float64] = directions[:, :2] / directions[:, 2:]
        return np.where(seen[:, None], plane, np.nan)
    import pycolmap

    # The size of the image has no effect.
    lens = pycolmap.Camera(model=model, width=1, height=1, params=list(params))
    rays: NDArray[np.float64] = np.asarray(lens.cam_from_img(xy), np.float64)
    return rays


def pixel_directions(
    model: str, params: Sequence[float], xy: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the directions (N, 3) of pixels in the frame of the camera, with z = 1.

    Args: see :func:`normalized`.
    """
    return np.column_stack([normalized(model, params, xy), np.ones(len(xy))])
