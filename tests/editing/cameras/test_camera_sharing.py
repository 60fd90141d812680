"""Cameras that become one, and cameras that images get for themselves."""

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle import InputError
from tests.io.colmap_models import fields, synthesize
from tests.rig_scenes import rig_problem
from tests.scenes import make_problem, scene


def loaded(problem, folder):
    """Save and let pycolmap read it."""
    assert bundle.save(problem, folder) == ()
    found = pycolmap.Reconstruction(folder)
    assert found.is_valid()
    for frame in found.frames.values():
        (image_id,) = frame.image_ids
        rig = found.rig(frame.rig_id)
        assert rig.ref_sensor_id.id == found.image(image_id.id).camera_id
    assert {rig.ref_sensor_id.id for rig in found.rigs.values()} <= set(found.cameras)
    return found


def test_the_mean_counts_observations():
    problem = make_problem(num_images=3, model="SIMPLE_RADIAL")
    keep = (problem.observation_image != 2) | (problem.observation_point < 10)
    names = ("observation_image", "observation_point", "observation_xy", "observation_keypoint")
    problem = problem.replace(**{name: getattr(problem, name)[keep] for name in names})
    shared = bundle.share_cameras(problem)
    weights = np.array([40, 40, 10])
    np.testing.assert_allclose(
        shared.camera_params[0], weights @ problem.camera_params / 90, rtol=1e-14
    )
    assert shared.camera_ids.tolist() == [1]
    assert shared.image_camera.tolist() == [0, 0, 0]
    np.testing.assert_array_equal(shared.cam_from_world, problem.cam_from_world)


def test_some_cameras_are_shared_whatever_their_order():
    ids = [9, 2**31 + 5, 4, 7]
    problem = make_problem(num_images=4, camera_ids=ids)
    shared = bundle.share_cameras(problem, [2**31 + 5, 7])
    assert shared.camera_ids.tolist() == [9, 4, 7]
    assert shared.camera_ids[shared.image_camera].tolist() == [9, 7, 4, 7]
    np.testing.assert_array_equal(shared.camera_params[:2], problem.camera_params[[0, 2]])
    np.testing.assert_allclose(
        shared.camera_params[2], problem.camera_params[[1, 3]].mean(axis=0), rtol=1e-14
    )


def test_cameras_without_observations_count_alike():
    problem = make_problem(num_images=2)
    none = {"observation_image": [], "observation_point": [], "observation_xy": np.empty((0, 2))}
    shared = bundle.share_cameras(problem.replace(**none, observation_keypoint=[]))
    np.testing.assert_allclose(shared.camera_params[0], problem.camera_params.mean(axis=0))


def test_equal_parameters_stay_bit_for_bit():
    problem = make_problem(num_images=3, model="OPENCV")
    same = np.tile(problem.camera_params[0] * np.pi, (3, 1))
    keep = (problem.observation_image != 2) | (problem.observation_point < 7)
    names = ("observation_image", "observation_point", "observation_xy", "observation_keypoint")
    uneven = problem.replace(**{name: getattr(problem, name)[keep] for name in names})
    shared = bundle.share_cameras(uneven.replace(camera_params=same))
    np.testing.assert_array_equal(shared.camera_params, same[:1])


def test_split_and_shared_again_is_as_before(tmp_path):
    source = synthesize(31)
    problem = bundle.Problem.from_pycolmap(source)
    split = bundle.split_cameras(problem)
    assert split.camera_ids.tolist() == list(range(1, 11))
    np.testing.assert_array_equal(
        split.camera_params[split.image_camera], problem.camera_params[problem.image_camera]
    )
    found = loaded(split, tmp_path / "split")
    assert len({image.camera_id for image in found.images.values()}) == 10
    assert fields(found)["points"] == fields(source)["points"]
    assert (len(found.rigs), len(found.frames)) == (10, 10)
    for image_id, image in source.images.items():
        other = found.image(image_id)
        assert other.name == image.name
        assert other.frame_id == image.frame_id
        np.testing.assert_array_equal(
            other.cam_from_world().matrix(), image.cam_from_world().matrix()
        )
        assert [(p.x(), p.y(), p.point3D_id) for p in other.points2D] == [
            (p.x(), p.y(), p.point3D_id) for p in image.points2D
        ]

    again = bundle.load(tmp_path / "split")
    first = [again.camera_ids[c] for c in again.image_camera[problem.image_camera == 0]]
    second = [again.camera_ids[c] for c in again.image_camera[problem.image_camera == 1]]
    back = bundle.share_cameras(bundle.share_cameras(again, first), second)
    np.testing.assert_array_equal(back.camera_ids, problem.camera_ids)
    np.testing.assert_array_equal(back.camera_params, problem.camera_params)
    assert fields(loaded(back, tmp_path / "back")) == fields(source)


def test_all_cameras_of_a_model_become_one_in_its_files(tmp_path):
    problem = bundle.Problem.from_pycolmap(synthesize(32))
    found = loaded(bundle.share_cameras(problem), tmp_path / "one")
    assert set(found.cameras) == {1}
    assert {image.camera_id for image in found.images.values()} == {1}
    assert found.num_reg_images() == 10


def test_bal_has_a_camera_for_each_image_already():
    problem = scene()
    assert bundle.split_cameras(problem) is problem


def test_a_camera_of_thousands_of_images():
    count = 3000
    problem = bundle.Problem(
        cam_from_world=np.tile([0.0, 0, 0, 1, 0, 0, 0], (count, 1)),
        camera_models=["PINHOLE", "OPENCV"],
        camera_params=[[500, 500, 0, 0, 0, 0, 0, 0], [600, 600, 0, 0, 0.1, 0, 0, 0]],
        camera_ids=[3, 2**32 - 3],
        image_camera=[1] * count,
        points=np.ones((1, 3)),
        observation_image=[0],
        observation_point=[0],
        observation_xy=[[0.0, 0]],
    )
    split = bundle.split_cameras(problem)
    assert split.num_cameras == count + 1  # one without an image stays
    assert len(np.unique(split.camera_ids)) == count + 1
    assert split.camera_ids.max() == 2**32 - 3  # no room above it
    assert split.image_camera[0] == 1
    assert len(np.unique(split.image_camera)) == count
    np.testing.assert_array_equal(split.camera_params[2:], problem.camera_params[[1] * (count - 1)])


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"camera_models": ["RADIAL", "OPENCV", "RADIAL"]}, "camera 2: .*model of camera 1"),
        ({"camera_sizes": [[8, 6], [8, 6], [8, 7]]}, "camera 3: .*size of camera 1 .*8 x 7"),
        ({"camera_sizes": [[8, 6], [0, 0], [8, 6]]}, "camera 2: .*size of camera 1 .*0 x 0"),
    ],
)
def test_cameras_that_differ(changes, found):
    params = np.hstack([make_problem(num_images=3, model="RADIAL").camera_params, np.zeros((3, 3))])
    problem = make_problem(num_images=3, model="RADIAL", camera_params=params, **changes)
    with pytest.raises(InputError, match=found):
        bundle.share_cameras(problem)


def test_spheres_of_one_size_are_shared():
    problem = make_problem(num_images=2, model="EQUIRECTANGULAR")
    with pytest.raises(InputError, match=r"camera 1: .*same w and h"):
        bundle.share_cameras(problem)
    params = problem.camera_params[[0, 0]]
    shared = bundle.share_cameras(problem.replace(camera_params=params))
    np.testing.assert_array_equal(shared.camera_params, params[:1])


def test_sensors_of_rigs_keep_their_cameras():
    problem = rig_problem()
    with pytest.raises(InputError, match=r"image \d+: .*frame"):
        bundle.split_cameras(problem)
    with pytest.raises(InputError, match=r"image \d+: .*frame"):
        bundle.share_cameras(problem)
    changed = bundle.change_camera_model(problem, "FULL_OPENCV")
    assert set(changed.problem.camera_models) == {"FULL_OPENCV"}
    np.testing.assert_array_equal(changed.problem.sensor_from_rig, problem.sensor_from_rig)


def test_misuse():
    problem = make_problem(num_images=3)
    with pytest.raises(InputError, match="camera_ids: camera 5 is not in the problem"):
        bundle.share_cameras(problem, [1, 5])
    with pytest.raises(InputError, match="at least two cameras to share, found 1"):
        bundle.share_cameras(problem, [2, 2])
    with pytest.raises(InputError, match="at least two cameras to share, found 1"):
        bundle.share_cameras(make_problem(shared=True))


def test_images_keep_their_scale_at_their_median_depth():
    problem = make_problem(num_images=3, model="SIMPLE_RADIAL")
    params = problem.camera_params.copy()
    params[:, 0] = [800.0, 1000.0, 1200.0]
    params[:, 3] = 0.0
    given = problem.replace(camera_params=params)
    shared = bundle.share_cameras(given, keep_scale=True)
    assert shared.camera_params[0, 0] == 1000.0
    for image, focal in enumerate(params[:, 0]):
        seen = problem.points[problem.observation_point[problem.observation_image == image]]
        depths = [
            np.median(Rotation.from_quat(pose[:4].copy()).apply(seen)[:, 2] + pose[6])
            for pose in (given.cam_from_world[image], shared.cam_from_world[image])
        ]
        assert focal / depths[0] == pytest.approx(1000.0 / depths[1], rel=1e-12)
    moved = shared.cam_from_world - given.cam_from_world
    assert np.flatnonzero(moved.any(axis=0)).tolist() == [6]
    assert not moved[1].any()
    np.testing.assert_array_equal(shared.points, given.points)


def test_images_without_points_in_front_stay_where_they_are():
    problem = make_problem(num_images=3, model="SIMPLE_RADIAL")
    params, poses = problem.camera_params.copy(), problem.cam_from_world.copy()
    params[:, 0] = [800.0, 1000.0, 1200.0]
    poses[2, 6] = -1e3  # all points are behind
    rows = problem.observation_image != 0
    names = ("observation_image", "observation_point", "observation_xy", "observation_keypoint")
    given = problem.replace(
        camera_params=params, cam_from_world=poses,
        **{name: getattr(problem, name)[rows] for name in names},
    )  # fmt: skip
    shared = bundle.share_cameras(given, keep_scale=True)
    assert shared.camera_params[0, 0] == pytest.approx(1100.0)
    np.testing.assert_array_equal(shared.cam_from_world[[0, 2]], poses[[0, 2]])
    assert shared.cam_from_world[1, 6] != poses[1, 6]
