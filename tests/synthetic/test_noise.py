"""Perturbed starting values stay cameras."""

from __future__ import annotations

import numpy as np

import bundle


def test_focal_lengths_are_never_below_a_half():
    scene = bundle.synthesize(
        num_images=60, num_points=200, cameras="individual", focal_noise=0.49, seed=3
    )
    ratio = scene.problem.camera_params[:, 0] / scene.ground_truth.camera_params[:, 0]
    assert np.isclose(ratio.min(), 0.5)
    assert ratio.max() > 1
