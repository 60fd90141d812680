"""Perturbed starting values stay cameras."""

from __future__ import annotations

import numpy as np

import bundle
from bundle.interface.scene_options import SceneOptions
from bundle.synthetic.observations import measure


def test_focal_lengths_are_never_below_a_half():
    scene = bundle.synthesize(
        num_images=60, num_points=200, cameras="individual", focal_noise=0.49, seed=3
    )
    ratio = scene.problem.camera_params[:, 0] / scene.ground_truth.camera_params[:, 0]
    assert np.isclose(ratio.min(), 0.5)
    assert ratio.max() > 1


def test_noise_does_not_lead_out_of_the_image():
    xy = np.repeat([[0.0, 0.0], [640.0, 480.0]], 50, axis=0)  # on its corners
    sizes = np.tile([640, 480], (100, 1))
    options = SceneOptions(pixel_noise=1.0, outlier_share=0.0)
    measured, _ = measure(np.random.default_rng(0), xy, sizes, options)
    assert ((measured > 0) & (measured < sizes)).all()
    assert 0 < np.abs(measured - xy).max() < 5
