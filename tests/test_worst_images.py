"""The worst images, against sums over a loop."""

import numpy as np
import pytest

from bundle.reprojection import reprojection_errors
from bundle.worst_images import worst_images
from tests.scenes import make_problem, scene


def test_the_images_of_largest_rmse_are_named():
    problem = make_problem(num_images=7, num_points=20)
    errors, _ = reprojection_errors(problem)
    expected = {}
    for i, name in enumerate(problem.image_names):
        own = errors[problem.observation_image == i]
        expected[name] = (len(own), np.sqrt((own**2).mean()), own.max())
    found = worst_images(problem, most=4)
    names = sorted(expected, key=lambda name: -expected[name][1])[:4]
    assert [image.name for image in found] == names
    for image in found:
        got = (image.num_observations, image.rmse, image.max)
        assert got == pytest.approx(expected[image.name])
        assert problem.image_ids[problem.image_names.index(image.name)] == image.image_id


def test_only_observations_that_count():
    """Image 0 is turned round: all behind it. It counts for BAL, and for COLMAP it does not."""
    problem = scene(kind="colmap")
    poses = problem.cam_from_world.copy()
    poses[0, 6] = -6.0
    turned = problem.replace(cam_from_world=poses)
    assert turned.image_ids[0] not in {image.image_id for image in worst_images(turned)}
    assert worst_images(turned, "algebraic")[0].image_id == turned.image_ids[0]
    assert len(worst_images(turned)) == 3
