"""Tracking: pixels that a lens allows, motion to a tenth of a pixel, wrong predictions."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bundle.inertial.tracking.feature_tracker import BORDER, CHECKS, FeatureTracker, usable_pixels
from bundle.interface.window_options import TrackingOptions
from bundle.model.sequence.calibration import Calibration
from tests.inertial.images.rendered_flight import FISHEYE, PINHOLE
from tests.inertial.vio.sequences import calibration

SIZE = (640, 480)


def lens(model: str, params: Any) -> Calibration:
    return calibration(camera_model=model, camera_params=params)


def picture(seed: int = 1, size: tuple[int, int] = SIZE) -> Any:
    noise = np.random.default_rng(seed).uniform(0, 255, (size[1], size[0])).astype(np.float32)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 3), None, 0, 255, cv2.NORM_MINMAX)


def shifted(image: Any, matrix: Any) -> Any:
    return cv2.warpPerspective(image, matrix, SIZE, flags=cv2.INTER_CUBIC).astype(np.uint8)


def test_a_fisheye_is_used_up_to_55_degrees() -> None:
    model, params = "OPENCV_FISHEYE", (190.0, 190.0, 256.0, 256.0, 0.0, 0.0, 0.0, 0.0)
    mask = usable_pixels(lens(model, params), (512, 512))
    y, x = np.nonzero(mask)
    angles = np.degrees(np.hypot(x - 256, y - 256) / 190)
    assert angles.max() == pytest.approx(np.degrees(np.arccos(3**-0.5)), abs=2.5)
    area = np.pi * (190 * np.arccos(3**-0.5)) ** 2
    assert (mask > 0).sum() == pytest.approx(area, rel=0.05)
    real = usable_pixels(lens(*FISHEYE), (512, 512))
    assert (real > 0).mean() == pytest.approx((mask > 0).mean(), rel=0.1)


def test_a_pinhole_is_used_up_to_its_border() -> None:
    for model, params in (PINHOLE, ("PINHOLE", (460.0, 460.0, 320.0, 240.0))):
        mask = usable_pixels(lens(model, params), SIZE)
        assert (mask > 0).sum() == (640 - 2 * BORDER) * (480 - 2 * BORDER)
        assert not mask[:BORDER].any()
        assert not mask[:, -BORDER:].any()


def test_pixels_beyond_the_fold_of_a_polynomial_are_not_used() -> None:
    # r (1 - 0.9 r^2) turns back at r = 0.609, 0.406 focal lengths from the axis.
    mask = usable_pixels(lens("OPENCV", (500.0, 500.0, 320.0, 240.0, -0.9, 0, 0, 0)), SIZE)
    y, x = np.nonzero(mask)
    assert 150 < np.hypot(x - 320, y - 240).max() < 500 * 0.406 + 8


def test_shifts_are_found_to_a_tenth_of_a_pixel() -> None:
    tracker = FeatureTracker(lens(*PINHOLE), SIZE, TrackingOptions())
    image = picture()
    first = tracker.add(image.astype(np.uint8), np.eye(3))
    move = np.array([[1.0, 0, 3.3], [0, 1, -1.7], [0, 0, 1]])
    second = tracker.add(shifted(image, move), np.eye(3))
    common, a, b = np.intersect1d(first[0], second[0], return_indices=True)
    assert len(common) > 0.8 * len(first[0]) > 50
    errors = second[1][b] - first[1][a] - [3.3, -1.7]
    assert np.abs(np.median(errors, axis=0)).max() < 0.05
    assert np.percentile(np.linalg.norm(errors, axis=1), 90) < 0.15
    assert np.all(np.diff(second[0]) > 0)
    assert set(tracker.lost) == set(CHECKS)


@pytest.mark.parametrize("is_wrong", [False, True])
def test_the_prediction_is_used_if_images_agree(is_wrong: bool) -> None:
    """The camera turns by 9 degrees, 73 pixels at the centre; a wrong IMU must not lose tracks."""
    inner = np.array([[460.0, 0, 320], [0, 460, 240], [0, 0, 1]])
    turn = Rotation.from_rotvec([0, np.radians(9), 0]).as_matrix()
    image = picture(2)
    tracker = FeatureTracker(lens("PINHOLE", (460.0, 460.0, 320.0, 240.0)), SIZE, TrackingOptions())
    first = tracker.add(image.astype(np.uint8), np.eye(3))
    moved = shifted(image, np.eye(3) if is_wrong else inner @ turn @ np.linalg.inv(inner))
    second = tracker.add(moved, turn)
    assert tracker.num_predicted == (0 if is_wrong else 1)
    assert len(np.intersect1d(first[0], second[0])) > 0.5 * len(first[0])


def test_tracks_of_another_motion_end() -> None:
    """A patch that moves against the scene is no part of it."""
    rng = np.random.default_rng(3)
    image = picture(4)
    move = np.array([[1.02, 0, -6.4], [0, 1.02, -4.8], [0, 0, 1]])  # forward
    tracker = FeatureTracker(lens(*PINHOLE), SIZE, TrackingOptions(num_features=400))
    tracker.add(image.astype(np.uint8), np.eye(3))
    now = shifted(image, move)
    now[100:200, 380:520] = np.roll(now, (6, 6), (0, 1))[100:200, 380:520]
    ids, pixels = tracker.add(now, np.eye(3))
    old = ids < 300
    inside = ((pixels > [385, 105]) & (pixels < [515, 195])).all(axis=1) & old
    assert tracker.lost["epipolar"] >= 6
    assert inside.sum() <= 4
    blank = rng.normal(100, 0.3, (480, 640)).astype(np.uint8)
    lost, _ = tracker.add(blank, np.eye(3))
    assert len(np.intersect1d(ids, lost)) < 0.1 * len(ids)
