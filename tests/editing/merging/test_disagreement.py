"""Distances of points in the images that see either."""

import numpy as np
from scipy.spatial.transform import Rotation

from bundle.editing.merge_models import disagreements
from tests.editing.merging.halves import whole
from tests.scenes import project


def pixels(problem, image, point):
    turned = Rotation.from_quat(problem.cam_from_world[image, :4]).apply(point.copy())
    in_camera = (turned + problem.cam_from_world[image, 4:])[None]
    return project("SIMPLE_RADIAL", problem.camera_params[0], in_camera)[0]


def test_it_is_the_median_over_the_images_of_both_tracks():
    a = whole(perturbation=1e-2)
    b = a.replace(points=a.points + np.random.default_rng(3).normal(0, 0.05, a.points.shape))
    pairs = np.array([[0, 0], [5, 5], [7, 3]])
    expected = []
    for first, second in pairs:
        images = [
            *a.observation_image[a.observation_point == first],
            *b.observation_image[b.observation_point == second],
        ]
        apart = [
            np.linalg.norm(pixels(a, i, a.points[first]) - pixels(a, i, b.points[second]))
            for i in images
        ]
        expected.append(sorted(apart)[(len(apart) - 1) // 2])
    np.testing.assert_allclose(disagreements(a, b, pairs), expected, rtol=1e-9)


def test_points_behind_the_cameras_are_infinitely_far():
    a = whole()
    points = a.points.copy()
    points[4] = -50 * np.array([0, 0, 1.0])
    found = disagreements(a, a.replace(points=points), np.array([[4, 4], [5, 5]]))
    assert found.tolist() == [np.inf, 0]
