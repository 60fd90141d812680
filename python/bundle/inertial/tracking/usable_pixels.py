"""Pixels in which features are tracked: where the lens can be inverted and does not stretch much.

Observations are used on the plane z = 1, with one standard deviation s / f. A pixel step there is

    d(x, y) / d(u, v)  =  S / f

with singular values of S of 1 on the axis of a pinhole camera. For f theta lenses, S grows as
1 / cos^2 theta away from the axis, and beyond 90 degrees the plane does not exist. Pixels whose S
exceeds MOST_STRETCH (55 degrees from the axis for f theta) are not used. Neither are pixels that do
not project to themselves: there a polynomial of distortion has turned back.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bundle.model.cameras import project
from bundle.model.pycolmap.lens import normalized
from bundle.model.sequence.calibration import Calibration

Array = np.ndarray[Any, Any]

MOST_STRETCH = 3.0
STEP = 8  # pixels between samples of the lens
BORDER = 8  # pixels along the border of an image, which are not used
MOST_ERROR = 0.5  # pixels, of the inverse of the lens


def usable_pixels(calibration: Calibration, size: tuple[int, int]) -> Array:
    """Return a mask (height, width) of 0 and 255.

    Args:
        calibration: calibration with a camera model.
        size: width and height.
    """
    import cv2

    model, params = calibration.camera_model or "", calibration.camera_params
    width, height = size
    x, y = np.arange(0, width + STEP, STEP), np.arange(0, height + STEP, STEP)
    grid = np.stack(np.meshgrid(x, y), -1).astype(np.float64)
    shape = grid.shape[:2]
    plane = normalized(model, params, grid.reshape(-1, 2))
    rays = np.column_stack([plane, np.ones(len(plane))])
    is_finite = np.asarray(np.isfinite(rays).all(axis=1))
    back, valid = project(model, params, np.where(is_finite[:, None], rays, [0.0, 0.0, 1.0]))
    error = np.linalg.norm(back - grid.reshape(-1, 2), axis=1)
    good = is_finite & valid & (error < MOST_ERROR)
    plane = np.where(good[:, None], plane, np.nan).reshape(*shape, 2)
    slopes = [np.gradient(plane, STEP, axis=axis) for axis in (1, 0)]
    jacobian = calibration.focal * np.stack(slopes, -1)
    is_known = np.asarray(np.isfinite(jacobian).all(axis=(2, 3)))
    stretch = np.linalg.norm(np.where(is_known[..., None, None], jacobian, 0.0), 2, axis=(2, 3))
    usable = (is_known & (stretch <= MOST_STRETCH)).astype(np.uint8)
    large = cv2.resize(usable, (shape[1] * STEP, shape[0] * STEP), interpolation=cv2.INTER_NEAREST)
    shift = STEP // 2  # cell k of the resized mask is centred on sample k
    large = np.pad(large, ((0, shift), (0, shift)), mode="edge")[shift:, shift:]
    mask = 255 * np.asarray(large[:height, :width], np.uint8)
    inside = np.zeros_like(mask)
    inside[BORDER : height - BORDER, BORDER : width - BORDER] = 1
    found: Array = mask * inside
    return found
