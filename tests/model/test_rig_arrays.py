"""Rigs in a problem: where images are, what is refused, what an edit does."""

import copy
import pickle

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bundle import InputError, Problem
from bundle.model import rig_arrays
from tests.rig_scenes import FIVE, STEREO, rig_problem
from tests.scenes import make_problem

RIG_FIELDS = tuple(rig_arrays.ARRAYS)


def composed(problem):
    """cam_from_world of the images of rigs, by SciPy; NaN of others."""
    rows = np.full((problem.num_images, 7), np.nan)
    for image in np.flatnonzero(problem.image_frame >= 0):
        frame = problem.rig_from_world[problem.image_frame[image]].copy()
        turned, moved = Rotation.from_quat(frame[:4]), frame[4:]
        if problem.image_sensor[image] >= 0:
            arm = problem.sensor_from_rig[problem.image_sensor[image]].copy()
            on_rig = Rotation.from_quat(arm[:4])
            turned, moved = on_rig * turned, on_rig.apply(moved) + arm[4:]
        rows[image] = np.hstack([turned.as_quat(canonical=True), moved])
    return rows


def assert_placed(problem):
    expected = composed(problem)
    framed = ~np.isnan(expected[:, 0])
    found = problem.cam_from_world[framed].copy()
    found[:, :4] /= np.linalg.norm(found[:, :4], axis=1, keepdims=True)
    found[:, :4] *= np.where(np.sum(found[:, :4] * expected[framed][:, :4], axis=1) < 0, -1, 1)[
        :, None
    ]
    np.testing.assert_allclose(found, expected[framed], atol=1e-12)


def test_a_problem_without_rigs_has_empty_arrays():
    problem = make_problem()
    assert (problem.num_rigs, problem.num_frames, problem.num_sensors) == (0, 0, 0)
    assert [len(getattr(problem, name)) for name in RIG_FIELDS] == [0] * len(RIG_FIELDS)
    assert problem.rig_from_world.shape == problem.sensor_from_rig.shape == (0, 7)
    assert "rig" not in repr(problem)


def test_rows_of_minus_one_are_no_rigs():
    none = np.full(5, -1)
    problem = make_problem().replace(image_frame=none, image_sensor=none)
    assert len(problem.image_frame) == len(problem.image_sensor) == 0


@pytest.mark.parametrize("rigs", [(STEREO,), (FIVE,), (STEREO, FIVE, STEREO)])
def test_counts_and_words(rigs):
    problem = rig_problem(rigs=rigs, num_frames=2, num_alone=1)
    assert problem.num_rigs == len(rigs)
    assert problem.num_frames == 2 * len(rigs)
    assert problem.num_sensors == sum(map(len, rigs))
    assert f"{problem.num_frames} frames of {len(rigs)} rig" in repr(problem)
    assert f"{problem.num_frames} frames of {len(rigs)} rig" in str(problem._repr_html_())


def test_pickles_and_copies():
    problem = rig_problem(num_alone=1)
    for again in (pickle.loads(pickle.dumps(problem)), copy.deepcopy(problem)):
        for name in (*RIG_FIELDS, "cam_from_world"):
            np.testing.assert_array_equal(getattr(again, name), getattr(problem, name))
            assert not getattr(again, name).flags.writeable


def test_rigs_of_frames_by_default():
    problem = rig_problem(rigs=(STEREO, FIVE), missing={(1, 1, s) for s in (1, 2, 3, 4)})
    again = problem.replace(frame_rig_ids=None)  # one frame of rig 2 has its reference image only
    np.testing.assert_array_equal(again.frame_rig_ids, problem.frame_rig_ids)
    with pytest.raises(InputError, match=r"^frame_rig_ids: .* the rig of frame "):
        rig_problem(
            rigs=(STEREO, FIVE),
            missing={(1, f, s) for f in range(4) for s in (1, 2, 3, 4)},
            frame_rig_ids=None,
        )


def test_an_edit_of_a_frame_moves_its_images_and_no_others():
    problem = rig_problem(rigs=(STEREO, FIVE), num_alone=1)
    frames = problem.rig_from_world.copy()
    frames[2] = [0.1, 0.2, 0.3, 0.9, 1, 2, 3]
    edited = problem.replace(rig_from_world=frames)
    assert_placed(edited)
    moved = (edited.cam_from_world != problem.cam_from_world).any(axis=1)
    np.testing.assert_array_equal(moved, problem.image_frame == 2)


def test_an_edit_of_a_sensor_moves_its_images_and_no_others():
    problem = rig_problem(rigs=(STEREO, FIVE), num_alone=1)
    arms = problem.sensor_from_rig.copy()
    arms[3, 4:] += 1
    edited = problem.replace(sensor_from_rig=arms)
    assert_placed(edited)
    moved = (edited.cam_from_world != problem.cam_from_world).any(axis=1)
    np.testing.assert_array_equal(moved, problem.image_sensor == 3)


def test_images_join_and_leave_frames():
    problem = rig_problem(num_alone=2)
    frame, sensor = problem.image_frame.copy(), problem.image_sensor.copy()
    frame[1] = sensor[1] = -1
    left = problem.replace(image_frame=frame, image_sensor=sensor)
    np.testing.assert_array_equal(left.cam_from_world, problem.cam_from_world)
    joined = left.replace(image_frame=problem.image_frame, image_sensor=problem.image_sensor)
    assert_placed(joined)
    rigged = problem.without_rigs().replace(
        **{name: getattr(problem, name) for name in RIG_FIELDS},
    )
    assert_placed(rigged)


def test_poses_that_contradict_the_rigs_are_refused():
    problem = rig_problem()
    poses = problem.cam_from_world.copy()
    poses[3, 4] += 1e-3
    with pytest.raises(
        InputError,
        match=r"^cam_from_world: image 4: .*sensor_from_rig \* rig_from_world of frame 2",
    ):
        problem.replace(cam_from_world=poses)
    poses[3, 4] = problem.cam_from_world[3, 4] * (1 + 1e-7)
    assert problem.replace(cam_from_world=poses).num_frames == problem.num_frames


def test_without_rigs_every_image_has_its_own_pose():
    problem = rig_problem(num_alone=1)
    apart = problem.without_rigs()
    assert apart.num_frames == apart.num_sensors == len(apart.image_frame) == 0
    np.testing.assert_array_equal(apart.cam_from_world, problem.cam_from_world)


def changed(problem, name, index, value):
    array = getattr(problem, name).copy()
    array[index] = value
    return {name: array}


# Field, index, value, how the message begins.
WRONG_VALUES = [
    ("rig_from_world", (1, 5), np.nan, "frame 2: expected a finite pose"),
    ("rig_from_world", (1, slice(0, 4)), 0, "frame 2: expected a rotation"),
    ("sensor_from_rig", (0, 4), np.inf, "sensor_from_rig: rig 1, camera 2: expected a finite pose"),
    ("sensor_from_rig", (0, slice(0, 4)), 0, "sensor_from_rig: rig 1, camera 2: expected a rota"),
    ("frame_ids", 1, 1, "frame 1: expected unique ids"),
    ("image_frame", 2, 8, "image 3: expected a frame index"),
    ("image_frame", 2, -2, "image 3: expected a frame index"),
    ("image_frame", 1, -1, "image 2: expected a frame for its sensor"),
    ("image_frame", 2, 0, "image_sensor: frame 1: expected one image per sensor"),
    ("image_sensor", 1, 5, "image 2: expected a sensor index"),
    ("image_sensor", 1, 1, "image 2: expected camera 4 of its sensor, found camera 2"),
    ("image_sensor", 1, -1, "image_sensor: "),
    ("sensor_rig_ids", 0, 2, "frame_rig_ids: frame 1: expected rig 2"),
    ("frame_rig_ids", 0, 7, "frame_rig_ids: frame 1: expected rig 1"),
    ("sensor_camera_ids", 0, 3, "image 2: expected camera 3 of its sensor, found camera 2"),
]


@pytest.mark.parametrize("name, index, value, message", WRONG_VALUES)
def test_wrong_values_are_named(name, index, value, message):
    problem = rig_problem(rigs=(STEREO, STEREO))
    with pytest.raises(InputError) as error:
        problem.replace(**changed(problem, name, index, value))
    assert str(error.value).startswith(message)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", RIG_FIELDS)
def test_wrong_shapes_are_refused(name):
    problem = rig_problem()
    array = getattr(problem, name)
    for wrong in (array[:-1], np.zeros((2, 3, 4))):
        with pytest.raises(InputError, match=r"^[a-z_]+: "):
            problem.replace(**{name: wrong})


@pytest.mark.parametrize("name", sorted({*RIG_FIELDS} - {"frame_ids", "frame_rig_ids"}))
def test_what_has_no_default_is_missed(name):
    with pytest.raises(InputError, match=r"^[a-z_]+: "):
        rig_problem(**{name: None})


def test_sensors_without_frames_are_refused():
    arm = rig_problem().sensor_from_rig
    with pytest.raises(InputError, match=r"^sensor_from_rig: expected no sensors"):
        make_problem(
            sensor_from_rig=arm, sensor_rig_ids=[1], sensor_camera_ids=[2], image_sensor=[-1] * 5
        )


def test_the_reference_camera_is_no_other_sensor():
    problem = rig_problem()
    cameras = problem.image_camera.copy()
    cameras[:] = 1
    with pytest.raises(InputError, match=r"^sensor_camera_ids: rig 1: expected another camera"):
        problem.replace(image_camera=cameras)


def test_the_order_of_arguments_is_free():
    problem = rig_problem(num_alone=1, first_ids=(7, 2**32 - 40, 2**31 + 5, 9))
    again = Problem(
        **{
            name: getattr(problem, name)
            for name in problem.__dataclass_fields__
            if name != "source"
        }
    )
    np.testing.assert_array_equal(again.cam_from_world, problem.cam_from_world)
