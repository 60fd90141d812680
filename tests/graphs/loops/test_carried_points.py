"""Points carried by images, against a loop over points."""

import numpy as np
from scipy.spatial.transform import Rotation

from bundle.graphs.loops.loop_graph import carry
from bundle.graphs.loops.similarity_graph import Nodes
from bundle.model.rigid_motions import inverse_poses
from tests.scenes import make_problem

MOVED = (1, 3)


def scene_and_nodes():
    """A scene without noise, and its images' similarities before and after two of them moved."""
    problem = make_problem(num_images=5, num_points=12, track=3, noise=0.0, perturbation=0.0)
    before = Nodes(inverse_poses(problem.cam_from_world), np.ones(5))
    poses, scales = before.poses.copy(), before.scales.copy()
    turn = Rotation.from_rotvec([0.1, -0.2, 0.3])
    for image in MOVED:
        poses[image, :4] = (turn * Rotation.from_quat(poses[image, :4])).as_quat()
        poses[image, 4:] += [0.4, 0.1, -0.3]
        scales[image] = 1.2
    return problem, before, Nodes(poses, scales)


def where_it_goes(problem, before, after, image, point):
    """Return where an image takes a point, by matrices."""
    turn = Rotation.from_quat(before.poses[image, :4])
    local = turn.inv().apply(problem.points[point] - before.poses[image, 4:])
    turned = Rotation.from_quat(after.poses[image, :4]).apply(local)
    return after.scales[image] * turned + after.poses[image, 4:]


def carried(problem, before, after, fitting):
    mounts = np.tile([0, 0, 0, 1.0, 0, 0, 0], (problem.num_images, 1))
    nodes = (before, after)
    return carry(problem, np.arange(problem.num_images), mounts, nodes, fitting)


def test_points_go_to_the_mean_of_where_images_take_them_whose_pixels_fit():
    problem, before, after = scene_and_nodes()
    rng = np.random.default_rng(1)
    fitting = rng.random(problem.num_observations) < 0.6
    moved, num_carried = carried(problem, before, after, fitting)
    count = 0
    for point in range(problem.num_points):
        mine = np.flatnonzero(problem.observation_point == point)
        images = problem.observation_image[mine[fitting[mine]]]
        if not len(images):
            continue
        if not np.isin(images, MOVED).any():
            np.testing.assert_array_equal(moved.points[point], problem.points[point])
            continue
        count += 1
        goes = [where_it_goes(problem, before, after, image, point) for image in images]
        np.testing.assert_allclose(moved.points[point], np.mean(goes, axis=0), rtol=1e-12)
    assert 0 < count < problem.num_points
    assert count <= num_carried


def test_a_point_without_a_fitting_pixel_follows_the_image_with_the_least_error():
    problem, before, after = scene_and_nodes()
    xy = problem.observation_xy.copy()
    rng = np.random.default_rng(2)
    xy += rng.uniform(5, 50, (len(xy), 1)) * [1.0, 0.0]
    problem = problem.replace(observation_xy=xy)
    off = np.abs(xy - scene_and_nodes()[0].observation_xy)[:, 0]
    moved, num_carried = carried(problem, before, after, np.zeros(len(xy), bool))
    followers = 0
    for point in range(problem.num_points):
        mine = np.flatnonzero(problem.observation_point == point)
        image = problem.observation_image[mine[np.argmin(off[mine])]]
        expected = where_it_goes(problem, before, after, image, point)
        if image in MOVED:
            followers += 1
        else:
            expected = problem.points[point]
        np.testing.assert_allclose(moved.points[point], expected, rtol=1e-12)
    assert 0 < followers == num_carried < problem.num_points


def test_images_that_stay_keep_their_bits():
    problem, before, after = scene_and_nodes()
    moved, _ = carried(problem, before, after, np.ones(problem.num_observations, bool))
    stays = ~np.isin(np.arange(5), MOVED)
    np.testing.assert_array_equal(moved.cam_from_world[stays], problem.cam_from_world[stays])
    back = inverse_poses(after.poses)
    np.testing.assert_allclose(moved.cam_from_world[~stays], back[~stays], atol=1e-15)
