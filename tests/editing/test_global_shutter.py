"""Observations moved to a global shutter, and rolling shutters under edits of a model."""

import numpy as np
import pytest

import bundle
from bundle.georeference.similarity import Similarity, moved
from bundle.model.rigid_motions import quaternion_rotate
from bundle.model.shutter_motion import read_positions
from bundle.synthetic.video_scene import film
from tests.model.test_rolling_shutter import problem_of


def scene_of(kind="orbit", direction="rows", **changes):
    fields = {"num_images": 8, "num_points": 150, "rolling_shutter": 0.8, "seed": 2}
    options = bundle.SceneOptions(scene=kind, **fields | changes)
    return film(options, direction=direction).ground_truth


def rolling_residuals(problem):
    """Return predicted minus measured positions under the rolling shutter, at the fixed point."""
    image = problem.observation_image
    pose = problem.cam_from_world[image]
    points = problem.points[problem.observation_point]
    local = quaternion_rotate(pose[:, :4], points) + pose[:, 4:]
    shutter = problem.rolling_shutter
    coordinate = 2 - shutter.axis[problem.image_camera][image].astype(int)
    found = read_positions(problem, image, local, shutter.twist[image], coordinate)[0]
    return found - problem.observation_xy


@pytest.mark.parametrize("kind", ["orbit", "drone_grid", "street"])
@pytest.mark.parametrize("direction", ["rows", "columns"])
def test_residuals_stay(kind, direction):
    problem = scene_of(kind, direction)
    found = bundle.to_global_shutter(problem)
    assert found.problem.rolling_shutter is None
    assert found.num_moved == problem.num_observations and found.num_left == 0
    errors, _ = bundle.reprojection_errors(found.problem)
    expected = np.hypot(*rolling_residuals(problem).T)
    np.testing.assert_allclose(errors, expected, atol=1e-9)
    assert np.sqrt((errors**2).mean() / 2) == pytest.approx(0.5, rel=0.15)
    assert 1 < found.largest < 100 and 0 < found.motion < 0.2


def test_exact_observations_become_exact_projections_of_one_pose():
    problem = scene_of(pixel_noise=0.0)
    errors, _ = bundle.reprojection_errors(bundle.to_global_shutter(problem).problem)
    assert errors.max() < 1e-9


def test_cameras_with_a_global_shutter_stay():
    problem = scene_of(cameras="individual")
    shutter = problem.rolling_shutter
    twist = shutter.twist.copy()
    twist[3] = 0
    direction = ["rows"] * 8
    direction[3] = "global"
    problem = problem.replace(rolling_shutter=shutter.replace(direction=direction, twist=twist))
    found = bundle.to_global_shutter(problem)
    of_global = problem.observation_image == 3
    assert found.num_moved == (~of_global).sum()
    np.testing.assert_array_equal(
        found.problem.observation_xy[of_global], problem.observation_xy[of_global]
    )


def test_zero_twists_move_nothing():
    problem = scene_of()
    shutter = problem.rolling_shutter.replace(twist=np.zeros((8, 6)))
    found = bundle.to_global_shutter(problem.replace(rolling_shutter=shutter))
    np.testing.assert_array_equal(found.problem.observation_xy, problem.observation_xy)
    assert found.motion == found.median == 0


def test_observed_rows_are_those_of_the_measurement():
    problem = scene_of(pixel_noise=0.0)
    shutter = problem.rolling_shutter.replace(row_time="observed")
    found = bundle.to_global_shutter(problem.replace(rolling_shutter=shutter))
    errors, _ = bundle.reprojection_errors(found.problem)
    assert errors.max() < 1e-8  # without noise both are the same row
    noisy = scene_of()
    observed = noisy.replace(rolling_shutter=noisy.rolling_shutter.replace(row_time="observed"))
    assert np.abs(bundle.to_global_shutter(observed).shift).max() > 0
    assert (bundle.to_global_shutter(observed).shift != bundle.to_global_shutter(noisy).shift).any()


def test_points_without_a_projection_stay_where_they_are():
    problem = scene_of()
    points = problem.points.copy()
    points[0] = problem.projection_centers[0]
    found = bundle.to_global_shutter(problem.replace(points=points))
    assert 0 < found.num_left < 9
    assert np.isfinite(found.problem.observation_xy).all()


def test_the_motion_is_that_from_the_first_to_the_last_row():
    """500 px times 0.02 at the depth 2 are 5 px: of 480 rows in three images, 640 columns."""
    problem = problem_of(twist=np.tile([0.0, 0, 0, 0.02, 0, 0], (4, 1)))
    found = bundle.to_global_shutter(problem)
    shares = np.array([5 / 480, 5 / 480, 5 / 480, 5 / 640])
    assert found.num_moved == 12
    assert found.motion == pytest.approx(np.sqrt((shares**2).mean()), rel=1e-9)


def test_global_shutters_are_refused():
    problem = scene_of()
    direction = ("global",) * len(problem.camera_models)
    twist = np.zeros((problem.num_images, 6))
    for shutter in (None, bundle.RollingShutter(direction=direction, twist=twist)):
        with pytest.raises(bundle.InputError, match="global shutters only"):
            bundle.to_global_shutter(problem.replace(rolling_shutter=shutter))


def test_residuals_stay_under_a_similarity():
    problem = scene_of()
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    other = moved(problem, Similarity(2.5, turn, np.array([1.0, 2, 3])))
    np.testing.assert_allclose(rolling_residuals(other), rolling_residuals(problem), atol=1e-8)


def test_shared_and_split_cameras_keep_their_shutters():
    problem = scene_of(cameras="individual")
    shared = bundle.share_cameras(problem)
    assert shared.rolling_shutter.direction == ("rows",)
    split = bundle.split_cameras(shared)
    assert split.rolling_shutter.direction == ("rows",) * 8
    np.testing.assert_array_equal(split.rolling_shutter.readout, 0.8)
    readout = problem.rolling_shutter.readout.copy()
    readout[1] = 0.5
    other = problem.replace(rolling_shutter=problem.rolling_shutter.replace(readout=readout))
    with pytest.raises(bundle.InputError, match=r"camera 2: expected the shutter .* readout 0\.8"):
        bundle.share_cameras(other)
