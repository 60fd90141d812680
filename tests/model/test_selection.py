"""Selections of a problem, and the way back."""

import pickle

import numpy as np
import pytest

import bundle
from bundle.model.selection import with_frames
from tests.rig_scenes import STEREO, rig_problem
from tests.scenes import make_problem

VALUES = ("cam_from_world", "camera_params", "points", "rig_from_world", "sensor_from_rig")
ARRAYS = (
    *VALUES,
    *("image_ids", "image_camera", "camera_ids", "camera_sizes", "point_ids"),
    *("observation_image", "observation_point", "observation_xy", "observation_keypoint"),
    *("frame_ids", "frame_rig_ids", "image_frame", "image_sensor"),
    *("sensor_rig_ids", "sensor_camera_ids", "observation_sigma"),
)


def scene():
    """Return images with cameras of their own, ids with gaps, sigmas and keypoints."""
    plain = make_problem(num_images=6, num_points=40)
    rng = np.random.default_rng(3)
    seen = rng.random(plain.num_observations) < 0.7
    return bundle.Problem(
        cam_from_world=plain.cam_from_world,
        image_ids=[3, 5, 6, 9, 20, 21],
        image_names=[f"{letter}.jpg" for letter in "abcdef"],
        camera_ids=[10, 11, 12, 13, 14, 15],
        camera_models=plain.camera_models,
        camera_params=plain.camera_params,
        image_camera=[1, 0, 2, 4, 3, 5],
        points=plain.points,
        point_ids=np.arange(40) * 3 + 1,
        observation_image=plain.observation_image[seen],
        observation_point=plain.observation_point[seen],
        observation_xy=plain.observation_xy[seen],
        observation_sigma=rng.uniform(1, 2, seen.sum()),
        observation_keypoint=rng.permutation(seen.sum()),
    )


def rigs():
    """Return two rigs and images alone."""
    return rig_problem(num_frames=5, rigs=(STEREO, STEREO), num_alone=3)


def same(one, other):
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    assert one.image_names == other.image_names
    assert one.camera_models == other.camera_models


def named(problem):
    """Return the observations by the ids of what they join; ids tell nothing of indices."""
    sigma = problem.observation_sigma
    return {
        (
            int(problem.image_ids[image]),
            int(problem.camera_ids[problem.image_camera[image]]),
            int(problem.point_ids[point]),
            *problem.points[point].tolist(),
            *problem.observation_xy[row].tolist(),
            *problem.cam_from_world[image].tolist(),
            *problem.camera_params[problem.image_camera[image]].tolist(),
            1.0 if sigma is None else float(sigma[row]),
        )
        for row, (image, point) in enumerate(
            zip(problem.observation_image, problem.observation_point, strict=True)
        )
    }


def drawn(problem, rng, *, whole_frames=False):
    """Return random masks; cameras of the images are among the cameras."""
    images = rng.random(problem.num_images) < 0.4
    images = with_frames(problem, images) if whole_frames else images
    cameras = rng.random(problem.num_cameras) < 0.4
    cameras[problem.image_camera[images]] = True
    points = rng.random(problem.num_points) < 0.6
    observations = rng.random(problem.num_observations) < 0.8
    return {"images": images, "cameras": cameras, "points": points, "observations": observations}


def moved(problem, rng):
    """Return a problem at other values, rigs and their images together."""
    if problem.num_frames:
        turn = problem.rig_from_world.copy()
        turn[:, 4:] += rng.normal(size=(len(turn), 3))
        problem = problem.replace(rig_from_world=turn)
        alone = problem.image_frame < 0
    else:
        alone = np.ones(problem.num_images, bool)
    pose = problem.cam_from_world.copy()
    pose[alone, 4:] += rng.normal(size=(alone.sum(), 3))
    return problem.replace(
        cam_from_world=pose,
        camera_params=problem.camera_params * 1.01,
        points=problem.points + rng.normal(size=problem.points.shape),
    )


@pytest.mark.parametrize("make", [scene, rigs])
@pytest.mark.parametrize("seed", range(8))
def test_a_selection_is_a_valid_problem_of_the_rows_that_were_chosen(make, seed):
    whole, rng = make(), np.random.default_rng(seed)
    masks = drawn(whole, rng)
    chosen = whole.select(**masks)
    problem = chosen.problem
    fields = {n: getattr(problem, n) for n in (*ARRAYS, "image_names", "camera_models", "format")}
    same(problem, bundle.Problem(**fields))  # which checks everything
    for name, ids in (("images", "image_ids"), ("cameras", "camera_ids"), ("points", "point_ids")):
        np.testing.assert_array_equal(getattr(chosen, name), np.flatnonzero(masks[name]))
        np.testing.assert_array_equal(getattr(problem, ids), getattr(whole, ids)[masks[name]])
    seen = masks["observations"] & masks["images"][whole.observation_image]
    seen &= masks["points"][whole.observation_point]
    np.testing.assert_array_equal(chosen.observations, np.flatnonzero(seen))
    assert named(problem) == named(
        whole.replace(
            **{
                name: getattr(whole, name)[seen]
                for name in ARRAYS
                if name.startswith("observation") and getattr(whole, name) is not None
            }
        )
    )
    frames = whole.image_frame[masks["images"]] if whole.num_frames else np.zeros(0, int)
    assert set(chosen.frames.tolist()) == set(frames[frames >= 0].tolist())
    rig_ids = set(whole.frame_rig_ids[chosen.frames].tolist())
    assert {int(whole.sensor_rig_ids[row]) for row in chosen.sensors} == rig_ids & set(
        whole.sensor_rig_ids.tolist()
    )
    assert problem.source is None
    assert (problem.observation_keypoint == -1).all()
    for name in ARRAYS:
        array = getattr(problem, name)
        assert array is None or not array.flags.writeable


@pytest.mark.parametrize("make", [scene, rigs])
def test_all_is_the_problem_itself(make):
    whole = make()
    everything = {
        name: np.ones(getattr(whole, f"num_{name}"), bool)
        for name in ("images", "cameras", "points", "observations")
    }
    for masks in ({}, everything, {name: mask.nonzero()[0] for name, mask in everything.items()}):
        chosen = whole.select(**masks)
        assert chosen.problem is whole
        assert len(chosen.frames) == whole.num_frames
        assert len(chosen.sensors) == whole.num_sensors
        same(chosen.put_back(whole, whole), whole)


def test_indices_in_any_order_are_a_mask():
    whole, rng = scene(), np.random.default_rng(1)
    masks = drawn(whole, rng)
    indices = {name: rng.permutation(np.repeat(np.flatnonzero(m), 2)) for name, m in masks.items()}
    one, other = whole.select(**masks), whole.select(**indices)
    same(one.problem, other.problem)
    np.testing.assert_array_equal(one.observations, other.observations)


def test_points_and_observations_alone_keep_source_and_keypoints(tmp_path):
    bundle.save(scene().replace(observation_sigma=None), tmp_path / "model")
    whole = bundle.load(tmp_path / "model")
    chosen = whole.select(points=np.arange(0, 40, 2)).problem
    assert vars(chosen)["source"] is vars(whole)["source"]
    assert chosen.cam_from_world is whole.cam_from_world
    assert (chosen.observation_keypoint >= 0).all()
    assert whole.select(images=[0, 1]).problem.source is None


@pytest.mark.parametrize("make", [scene, rigs])
@pytest.mark.parametrize("nothing", ["images", "points", "observations"])
def test_empty_selections(make, nothing):
    whole = make()
    for none in ([], np.zeros(getattr(whole, f"num_{nothing}"), bool)):
        chosen = whole.select(**{nothing: none})
        assert getattr(chosen.problem, f"num_{nothing}") == 0
        assert chosen.problem.num_observations == 0
        assert chosen.problem.observation_sigma is None
        assert chosen.problem.num_cameras == whole.num_cameras
        if nothing == "images":
            assert chosen.problem.num_frames == chosen.problem.num_sensors == 0
            assert chosen.problem.image_frame.shape == (0,)
        same(chosen.put_back(whole, chosen.problem), whole)


@pytest.mark.parametrize("make", [scene, rigs])
@pytest.mark.parametrize("seed", range(4))
def test_what_is_not_selected_stays_bit_for_bit(make, seed):
    whole, rng = make(), np.random.default_rng(seed)
    chosen = whole.select(**drawn(whole, rng, whole_frames=True))
    refined = moved(chosen.problem, rng)
    again = chosen.put_back(whole, refined)
    rows = {
        "cam_from_world": chosen.images,
        "camera_params": chosen.cameras,
        "points": chosen.points,
        "rig_from_world": chosen.frames,
    }
    for name, mine in rows.items():
        others = np.setdiff1d(np.arange(len(getattr(whole, name))), mine)
        before, after = getattr(whole, name), getattr(again, name)
        np.testing.assert_array_equal(after[mine], getattr(refined, name))
        np.testing.assert_array_equal(after[others], before[others])
    for name in set(ARRAYS) - {*rows}:
        np.testing.assert_array_equal(getattr(again, name), getattr(whole, name))
    same(chosen.put_back(whole, chosen.problem), whole)


def test_a_frame_does_not_move_without_all_of_its_images():
    whole = rigs()
    chosen = whole.select(images=[int(np.argmax(whole.image_frame == 2))])
    with pytest.raises(bundle.InputError, match=r"expected sensor_from_rig \* rig_from_world"):
        chosen.put_back(whole, moved(chosen.problem, np.random.default_rng(0)))


def test_masks_say_which_values_are_put_back():
    whole, rng = scene(), np.random.default_rng(2)
    chosen = whole.select(images=[0, 2, 4], points=np.arange(10))
    refined = moved(chosen.problem, rng)
    none = np.zeros(3, bool)
    again = chosen.put_back(
        whole,
        refined,
        images=np.array([False, True, False]),
        cameras=np.zeros(6, bool),
        points=np.arange(10) < 1,
    )
    assert np.flatnonzero((again.cam_from_world != whole.cam_from_world).any(axis=1)) == [2]
    assert np.flatnonzero((again.points != whole.points).any(axis=1)) == [0]
    np.testing.assert_array_equal(again.camera_params, whole.camera_params)
    same(chosen.put_back(whole, refined, images=none, cameras=np.zeros(6, bool),
                         points=np.zeros(10, bool)), whole)  # fmt: skip


def test_a_selection_of_a_selection_is_one_of_the_whole():
    whole, rng = scene(), np.random.default_rng(4)
    chosen = whole.select(images=[0, 1, 3, 5], points=np.arange(5, 30))
    points = rng.random(25) < 0.7
    observations = rng.random(len(chosen.observations)) < 0.7
    left = chosen.restricted(observations, points)
    seen = np.zeros(whole.num_observations, bool)
    seen[chosen.observations[observations]] = True
    expected = whole.select(images=[0, 1, 3, 5], points=np.arange(5, 30)[points], observations=seen)
    same(left.problem, expected.problem)
    np.testing.assert_array_equal(left.points, expected.points)
    np.testing.assert_array_equal(left.observations, expected.observations)
    np.testing.assert_array_equal(left.images, chosen.images)


def test_a_selection_pickles_without_the_whole():
    whole = scene()
    chosen = whole.select(points=[0, 1])
    again = pickle.loads(pickle.dumps(chosen))
    same(again.problem, chosen.problem)
    assert len(pickle.dumps(chosen)) < len(pickle.dumps(whole))
    assert not any(value is whole for value in vars(chosen).values())


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ({"images": [0, 6]}, "images: expected indices from 0 to 5, found 6"),
        ({"points": [-1]}, "points: expected indices from 0 to 39, found -1"),
        ({"cameras": np.ones(5, bool)}, "cameras: expected a mask of shape"),
        ({"observations": [0.5]}, "observations: expected a mask or indices"),
        ({"points": "abc"}, "points: expected a mask or indices"),
        ({"points": [[0, 1]]}, "points: expected a mask or indices"),
        ({"cameras": [0, 1]}, "cameras: .* that of image 6 is missing"),
        ({"images": [3], "cameras": [0]}, "cameras: .* that of image 9 is missing"),
    ],
)
def test_refusals(rows, words):
    with pytest.raises(bundle.InputError, match=f"^{words}"):
        scene().select(**rows)
