"""Filmed scenes: the observed row is the fixed point of the true motion."""

import numpy as np
import pytest
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

import bundle
from bundle.interface.scene_options import SceneOptions
from bundle.model.shutter_motion import moved, twists_between
from bundle.synthetic.video_scene import DroneGrid, film

SCENES = ["orbit", "drone_grid", "street"]


def options(scene: str, **changes: object) -> SceneOptions:
    fields = {"num_images": 20, "num_points": 200, "rolling_shutter": 0.7, "seed": 3}
    return SceneOptions(scene=scene, **fields | changes)


def matrix(pose: np.ndarray) -> np.ndarray:
    found = np.eye(4)
    found[:3, :3] = Rotation.from_quat(pose[:4]).as_matrix()
    found[:3, 3] = pose[4:]
    return found


def algebra(twist: np.ndarray) -> np.ndarray:
    x, y, z = twist[:3]
    found = np.zeros((4, 4))
    found[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    found[:3, 3] = twist[3:]
    return found


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("direction", ["rows", "columns"])
def test_exact_observations_satisfy_the_model_at_their_own_row(scene, direction):
    made = film(options(scene, pixel_noise=0.0), direction=direction)
    truth = made.ground_truth
    rng = np.random.default_rng(0)
    for row in rng.integers(0, truth.num_observations, 40):
        image = truth.observation_image[row]
        xy = truth.observation_xy[row]
        axis = 1 if direction == "rows" else 0
        s = xy[axis] / truth.camera_sizes[0, axis] - 0.5
        pose = expm(s * algebra(made.twists[image])) @ matrix(truth.cam_from_world[image])
        seen = (pose @ np.append(truth.points[truth.observation_point[row]], 1))[None, :3]
        pixel, _ = bundle.project(truth.camera_models[0], truth.camera_params[0], seen)
        np.testing.assert_allclose(pixel[0], xy, atol=1e-8)


def test_twists_between_poses_are_the_matrix_logarithm():
    truth = film(options("orbit")).ground_truth
    a, b = truth.cam_from_world[:-1], truth.cam_from_world[1:]
    for k, twist in enumerate(twists_between(a, b)[:5]):
        expected = logm(matrix(b[k]) @ np.linalg.inv(matrix(a[k]))).real
        np.testing.assert_allclose(algebra(twist), expected, atol=1e-12)


@pytest.mark.parametrize("size", [0.0, 1e-9, 0.0999, 0.1001, 2.0])
def test_motion_is_the_matrix_exponential(size):
    rng = np.random.default_rng(1)
    twist, point = rng.standard_normal(6), rng.standard_normal(3)
    twist[:3] *= size / np.linalg.norm(twist[:3])
    found = moved(twist[None], np.ones(1), point[None])[0]
    expected = (expm(algebra(twist)) @ np.append(point, 1))[:3]
    np.testing.assert_allclose(found, expected, atol=1e-14)


@pytest.mark.parametrize("scene", SCENES)
def test_twists_follow_from_the_neighbours_within_the_shake(scene):
    made = film(options(scene, num_images=40))
    before, after, frames = made.ties.T
    poses = made.ground_truth.cam_from_world
    by_pose = twists_between(poses[before], poses[after]) / frames[:, None]
    sigmas = (made.twists / made.readout - by_pose) / np.repeat(made.shake, 3)
    assert 0.7 < sigmas.std() < 2.0


@pytest.mark.parametrize("scene", SCENES)
def test_filmed_scenes_are_seeded_and_complete(scene):
    one, other = (bundle.synthesize(options(scene)) for _ in range(2))
    np.testing.assert_array_equal(one.problem.observation_xy, other.problem.observation_xy)
    truth = one.ground_truth
    assert truth.num_points == 200
    assert np.bincount(truth.observation_point).min() >= 2
    errors, behind = bundle.reprojection_errors(
        film(options(scene, rolling_shutter=0)).ground_truth
    )
    assert not behind.any()
    assert np.sqrt((errors**2).mean() / 2) == pytest.approx(0.5, rel=0.1)
    changed = bundle.synthesize(options(scene), seed=4)
    assert changed.problem.num_observations != one.problem.num_observations


def test_outliers_flat_ground_and_a_camera_per_image():
    choices = options("drone_grid", outlier_share=0.1, cameras="individual")
    made = film(choices, DroneGrid(np.random.default_rng(0), 20, relief=0.0), turning=False)
    assert made.is_outlier.mean() == pytest.approx(0.1, abs=0.01)
    assert np.ptp(made.ground_truth.points[:, 2]) == 0
    assert not made.twists[:, :3].any()
    assert made.ground_truth.num_cameras == 20


@pytest.mark.parametrize(
    "wrong",
    [
        {"rolling_shutter": 1.5},
        {"rolling_shutter": -0.1},
        {"scene": "photo_collection"},
        {"mean_track_length": 4.0},
    ],
)
def test_scenes_that_cannot_be_filmed_are_refused(wrong):
    with pytest.raises(bundle.InputError, match=next(iter(wrong)) + "|rolling_shutter"):
        bundle.synthesize(options(**{"scene": "orbit"} | wrong))


def test_too_few_points_are_refused():
    with pytest.raises(bundle.InputError, match="num_points"):
        bundle.synthesize(options("street", num_points=20, num_images=40))
