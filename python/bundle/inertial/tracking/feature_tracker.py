"""Tracking of corners from image to image, with checks that end wrong tracks.

* New corners: the largest smaller eigenvalue of the structure tensor (Shi and Tomasi, CVPR 1994) in
  each cell of a grid without a track, if it exceeds a hundredth of that of strong cells.
* Motion: pyramidal Lucas-Kanade. It starts at the position that the gyroscope's rotation predicts,
  if the images agree with it better than with no motion (patches of the image reduced by 8).
  A wrong IMU therefore cannot spoil tracks.
* Checks, in this order. A track ends if it leaves the usable pixels or its patch is not found; if
  it does not return to its position when it is tracked back; if an older track is nearer than half
  a cell; if it is an outlier of an essential matrix (RANSAC on undistorted rays) between
  consecutive images, or since the image BACK images earlier, whose baseline is longer.
"""

from __future__ import annotations

from collections import deque
from dataclasses import field
from typing import Any

import numpy as np

from bundle.base.records import dataclass
from bundle.interface.window_options import TrackingOptions
from bundle.model.cameras import project
from bundle.model.lenses.exact_image import normalized
from bundle.model.sequence.calibration import Calibration

Array = np.ndarray[Any, Any]

CHECKS = ("not found", "backward", "crowded", "epipolar")  # checks that end tracks, in their order

WINDOW, LEVELS = (21, 21), 3  # of Lucas-Kanade
BLOCK = 5  # pixels, of the structure tensor
WEAKEST = 0.01  # of the eigenvalue of strong cells
BACK = 5  # images
CONFIDENCE, ITERATIONS = 0.999, 300
FEWEST = 12  # rays of an essential matrix
PATCH = 2  # half a patch, in pixels of the reduced image


@dataclass
class _Features:
    """Tracks of an image: ids (ascending), pixels (float32) and normalised coordinates."""

    ids: Array = field(default_factory=lambda: np.zeros(0, np.int64))
    pixels: Array = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    plane: Array = field(default_factory=lambda: np.zeros((0, 2)))

    def only(self, kept: Array) -> _Features:
        return _Features(self.ids[kept], self.pixels[kept], self.plane[kept])


class FeatureTracker:
    """Tracker of one camera.

    Attributes:
        lost: number of tracks that each of ``CHECKS`` ended.
        num_steps: number of track steps from an image to the next.
        num_predicted: number of images whose rotation the gyroscope predicted.
    """

    def __init__(
        self, calibration: Calibration, size: tuple[int, int], options: TrackingOptions
    ) -> None:
        self._calibration, self._options = calibration, options
        self._mask = usable_pixels(calibration, size)
        area = np.count_nonzero(self._mask)
        self._cell = max(8.0, float(np.sqrt(area / options.num_features)))
        self._image: Array = np.zeros((0, 0), np.uint8)
        self._features = _Features()
        self._earlier: deque[_Features] = deque(maxlen=BACK)
        self._next_id = 0
        self.lost = dict.fromkeys(CHECKS, 0)
        self.num_steps = 0
        self.num_predicted = 0

    def add(self, image: Array, turn: Array) -> tuple[Array, Array]:
        """Track into the next image; return the ids (ascending) and pixels (n, 2) of its tracks.

        ``image``: (height, width) uint8. ``turn``: (3, 3) rotation of the camera since the previous
        image, by the gyroscope.
        """
        if len(self._features.ids):
            self._features = self._tracked(image, turn)
        self._earlier.append(self._features)
        self._image = image
        self._refill(image)
        # new corners belong to this image, too
        self._earlier[-1] = self._features
        return self._features.ids, self._features.pixels.astype(np.float64)

    def _tracked(self, image: Array, turn: Array) -> _Features:
        import cv2

        before = self._features
        self.num_steps += len(before.ids)
        settings: dict[str, Any] = {
            "winSize": WINDOW,
            "maxLevel": LEVELS,
            "criteria": (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.01),
            "flags": cv2.OPTFLOW_USE_INITIAL_FLOW,
        }
        start = self._predicted(image, before, turn)
        pixels, found, _ = cv2.calcOpticalFlowPyrLK(
            self._image, image, before.pixels, start.copy(), **settings
        )
        back, found_back, _ = cv2.calcOpticalFlowPyrLK(
            image, self._image, pixels, before.pixels.copy(), **settings
        )
        kept = self._usable(pixels) & (found.ravel() > 0)
        kept = self._end("not found", np.ones(len(kept), bool), kept)
        distance = np.linalg.norm(back - before.pixels, axis=1)
        returned = (found_back.ravel() > 0) & (distance <= self._options.max_backward_error)
        kept = self._end("backward", kept, returned)
        kept = self._end("crowded", kept, ~_is_crowded(pixels, kept, self._cell / 2))
        now = _Features(before.ids, pixels, self._plane(pixels)).only(kept)
        for earlier in (before, self._earlier[0]):
            fits = self._coplanar(earlier, now)
            now = now.only(self._end("epipolar", np.ones(len(fits), bool), fits))
        return now

    def _end(self, check: str, alive: Array, passed: Array) -> Array:
        self.lost[check] += int(np.count_nonzero(alive & ~passed))
        return alive & passed

    def _plane(self, pixels: Array) -> Array:
        calibration = self._calibration
        return normalized(
            calibration.camera_model or "", calibration.camera_params, pixels.astype(np.float64)
        )

    def _usable(self, pixels: Array) -> Array:
        height, width = self._mask.shape
        near = np.nan_to_num(np.rint(pixels), nan=-1.0).astype(np.int64)
        inside = ((near >= 0) & (near < [width, height])).all(axis=1)
        near[~inside] = 0
        usable: Array = inside & (self._mask[near[:, 1], near[:, 0]] > 0)
        return usable

    def _predicted(self, image: Array, before: _Features, turn: Array) -> Array:
        calibration = self._calibration
        rays = np.column_stack([before.plane, np.ones(len(before.plane))]) @ turn.T
        xy, valid = project(calibration.camera_model or "", calibration.camera_params, rays)
        moved = np.where(valid[:, None], xy, before.pixels).astype(np.float32)
        moved = np.where(self._usable(moved)[:, None], moved, before.pixels)
        old, new = _reduced(self._image), _reduced(image)
        sources = _patches(old, before.pixels)
        still, turned = (_patches(new, at) - sources for at in (before.pixels, moved))
        if np.abs(turned).mean() >= np.abs(still).mean():
            return before.pixels
        self.num_predicted += 1
        return moved

    def _coplanar(self, earlier: _Features, now: _Features) -> Array:
        """Return the tracks that fit an essential matrix since an earlier image."""
        import cv2

        fits = np.ones(len(now.ids), bool)
        _, a, b = np.intersect1d(earlier.ids, now.ids, assume_unique=True, return_indices=True)
        if len(a) < FEWEST:
            return fits
        one, other = earlier.plane[a], now.plane[b]
        essential, inliers = cv2.findEssentialMat(
            one,
            other,
            np.eye(3),
            method=cv2.RANSAC,
            prob=CONFIDENCE,
            threshold=self._options.max_epipolar_error / self._calibration.focal,
            maxIters=ITERATIONS,
        )
        if essential is None or essential.shape != (3, 3):
            return fits
        fits[b] = inliers.ravel() > 0
        return fits

    def _refill(self, image: Array) -> None:
        import cv2

        height, width = image.shape
        strength = cv2.cornerMinEigenVal(image, BLOCK)
        strength[self._mask == 0] = 0.0
        taken = np.ones((height, width), np.uint8)
        for x, y in np.rint(self._features.pixels).astype(int).tolist():
            cv2.circle(taken, (x, y), int(self._cell / 2), 0, -1)
        corners, values = _best_of_cells(strength, self._cell)
        strong = WEAKEST * float(np.percentile(values, 90)) if len(values) else 0.0
        free = (values > max(strong, 1e-9)) & (taken[corners[:, 1], corners[:, 0]] > 0)
        corners, values = corners[free], values[free]
        order = np.argsort(-values, kind="stable")
        corners = corners[order]
        every = np.ones(len(corners), bool)
        alone = ~_is_crowded(corners.astype(np.float64), every, self._cell / 2)
        pixels: Array = corners[alone].astype(np.float32)
        if len(pixels):
            criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.01)
            pixels = cv2.cornerSubPix(image, pixels.copy(), (3, 3), (-1, -1), criteria)
            pixels = pixels[self._usable(pixels)]
        ids = self._next_id + np.arange(len(pixels))
        self._next_id += len(pixels)
        features = self._features
        self._features = _Features(
            np.concatenate([features.ids, ids]),
            np.concatenate([features.pixels, pixels.astype(np.float32)]),
            np.concatenate([features.plane, self._plane(pixels)]),
        )


def _best_of_cells(strength: Array, cell: float) -> tuple[Array, Array]:
    """Return the pixel x, y (n, 2) of the largest value in each cell, and the values (n,)."""
    height, width = strength.shape
    rows, columns = max(1, round(height / cell)), max(1, round(width / cell))
    h, w = height // rows, width // columns
    cells = strength[: rows * h, : columns * w].reshape(rows, h, columns, w).swapaxes(1, 2)
    flat = cells.reshape(rows, columns, h * w)
    best = np.argmax(flat, axis=2)
    y = best // w + h * np.arange(rows)[:, None]
    x = best % w + w * np.arange(columns)
    values = np.take_along_axis(flat, best[..., None], 2)[..., 0]
    return np.stack([x, y], -1).reshape(-1, 2), values.ravel()


def _is_crowded(pixels: Array, alive: Array, distance: float) -> Array:
    """Return True for pixels nearer than a distance to a living pixel before them."""
    difference = pixels[:, None] - pixels[None]
    near = (difference**2).sum(axis=2) < distance**2
    crowded: Array = np.tril(near & alive[None], -1).any(axis=1)
    return crowded


def _reduced(image: Any) -> Array:
    import cv2

    size = max(1, image.shape[1] // 8), max(1, image.shape[0] // 8)
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.float32)


def _patches(small: Array, pixels: Array) -> Array:
    import cv2

    steps = np.arange(-PATCH, PATCH + 1, dtype=np.float32)
    x = (pixels[:, :1] + 0.5) / 8 - 0.5 + np.tile(steps, len(steps))
    y = (pixels[:, 1:] + 0.5) / 8 - 0.5 + np.repeat(steps, len(steps))
    at = x.astype(np.float32), y.astype(np.float32)
    return cv2.remap(small, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


# Pixels in which features are tracked: where the lens can be inverted and does not stretch much.
#
# Observations are used on the plane z = 1, with one standard deviation s / f. A pixel step there is
#
#     d(x, y) / d(u, v)  =  S / f
#
# with singular values of S of 1 on the axis of a pinhole camera. For f theta lenses, S grows as 1 /
# cos^2 theta away from the axis, and beyond 90 degrees the plane does not exist. Pixels whose S
# exceeds MOST_STRETCH (55 degrees from the axis for f theta) are not used. Pixels that do not
# project to themselves are not usable either: there the distortion folds back.


MOST_STRETCH = 3.0
STEP = 8  # pixels between samples of the lens
BORDER = 8  # pixels along the border of an image, which are not used
MOST_ERROR = 0.5  # pixels, of the inverse of the lens


def usable_pixels(calibration: Calibration, size: tuple[int, int]) -> Array:
    """Return a mask (height, width) of 0 and 255."""
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
