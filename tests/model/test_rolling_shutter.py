"""Rolling shutters as data: what they refuse, and what selections and copies keep."""

import copy
import pickle

import numpy as np
import pytest
from scipy.linalg import expm

import bundle
from bundle.model.shutter_motion import moved, read_positions, scaled

TWIST = np.arange(24.0).reshape(4, 6) / 100


def problem_of(**changes):
    fields = {
        "cam_from_world": np.tile([0.0, 0, 0, 1, 0, 0, 2], (4, 1)),
        "camera_models": ("SIMPLE_PINHOLE",) * 2,
        "camera_params": np.array([[500.0, 320, 240]] * 2),
        "camera_sizes": [[640, 480]] * 2,
        "image_camera": [0, 0, 0, 1],
        "points": np.zeros((3, 3)),
        "observation_image": np.repeat(np.arange(4), 3),
        "observation_point": np.tile(np.arange(3), 4),
        "observation_xy": np.full((12, 2), 100.0),
    }
    shutter = {
        "direction": ("rows", "columns"),
        "readout": [0.8, np.nan],
        "twist": TWIST,
        "frames": [0.0, 5, 10, 0],
        "neighbours": [[0, 1], [0, 2], [1, 2], [-1, -1]],
    }
    given = {key: value for key, value in changes.items() if key in shutter or key == "row_time"}
    rest = {key: value for key, value in changes.items() if key not in given}
    return bundle.Problem(**fields | rest, rolling_shutter=bundle.RollingShutter(**shutter | given))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"readout": [0.0, 0.5]}, "readout: expected shares of a frame above 0"),
        ({"readout": [1.2, 0.5]}, "found 1.2"),
        ({"readout": [0.5]}, r"readout: expected shape \(2,\), found \(1,\)"),
        ({"direction": "rows"}, "one per camera"),
        ({"direction": ("rows", "diagonal")}, "diagonal"),
        ({"direction": ("rows",), "readout": None}, "the problem's 2 cameras, found 1"),
        ({"twist": TWIST[:, :5]}, r"twist: expected shape \(num_images, 6\)"),
        ({"twist": np.full((4, 6), np.inf)}, "twist"),
        (
            {"twist": TWIST[:3], "frames": None, "neighbours": None},
            "the problem's 4 images, found 3",
        ),
        ({"neighbours": [[0, 4]] * 4}, r"indices from -1 to 3, found \[0, 4\]"),
        ({"neighbours": [[0, -1]] * 4}, r"two images or twice -1, found \[0, -1\]"),
        ({"frames": [0.0, np.inf, 1, 2]}, "frames"),
        ({"row_time": "late"}, "row_time"),
        ({"camera_sizes": [[640, 0], [640, 480]]}, "camera 0: expected the size of its images"),
        ({"camera_sizes": [[640, 480], [0, 480]]}, "camera 1: expected the size of its images"),
        ({"direction": ("rows", "global")}, "image 3: expected a zero twist"),
    ],
)
def test_bad_rolling_shutters_are_one_line(changes, words):
    with pytest.raises(bundle.InputError, match=words) as error:
        problem_of(**changes)
    assert "\n" not in str(error.value)


def test_something_else_is_no_rolling_shutter():
    with pytest.raises(bundle.InputError, match=r"bundle\.RollingShutter"):
        problem_of().replace(rolling_shutter="rows")


def test_images_of_rigs_have_no_rolling_shutter():
    problem = problem_of()
    with pytest.raises(bundle.InputError, match="whose pose several images share"):
        problem.replace(
            rig_from_world=problem.cam_from_world[:1],
            frame_ids=[1],
            frame_rig_ids=[1],
            image_frame=[0, -1, -1, -1],
            image_sensor=[-1, -1, -1, -1],
            sensor_from_rig=np.zeros((0, 7)),
            sensor_rig_ids=[],
            sensor_camera_ids=[],
        )


def test_a_selection_keeps_twists_and_closes_gaps_of_neighbours():
    whole = problem_of()
    part = whole.select(images=[0, 2, 3]).problem.rolling_shutter
    assert np.array_equal(part.twist, TWIST[[0, 2, 3]])
    assert np.array_equal(part.frames, [0, 10, 0])
    assert part.neighbours.tolist() == [[-1, -1], [-1, -1], [-1, -1]]
    part = whole.select(images=[0, 1]).problem.rolling_shutter
    assert part.neighbours.tolist() == [[0, 1], [0, 1]]
    one = whole.select(images=[3], cameras=[1]).problem.rolling_shutter
    assert one.direction == ("columns",)
    assert np.isnan(one.readout).all()


def test_refined_twists_are_put_back():
    whole = problem_of()
    part = whole.select(images=[1, 2])
    shutter = part.problem.rolling_shutter
    refined = part.problem.replace(
        rolling_shutter=shutter.replace(twist=shutter.twist + 1, readout=[0.7, np.nan])
    )
    back = part.put_back(whole, refined).rolling_shutter
    assert np.array_equal(back.twist, TWIST + np.array([0, 1, 1, 0])[:, None])
    assert back.readout[0] == 0.7


def test_copies_stay_immutable():
    problem = problem_of()
    for twin in (pickle.loads(pickle.dumps(problem)), copy.deepcopy(problem)):
        shutter = twin.rolling_shutter
        assert np.array_equal(shutter.twist, TWIST)
        assert shutter.axis.tolist() == [1, 2]
        with pytest.raises(ValueError, match="read-only"):
            shutter.twist[0] = 1


def test_images_with_a_rolling_shutter_and_neighbours_are_tied():
    neighbours = [[0, 1], [0, 2], [-1, -1], [2, 3]]
    twist = np.where([[True], [True], [True], [False]], TWIST, 0.0)
    problem = problem_of(direction=("rows", "global"), twist=twist, neighbours=neighbours)
    assert problem.rolling_shutter.tied(problem).tolist() == [True, True, False, False]
    alone = problem_of(neighbours=None)
    assert not alone.rolling_shutter.tied(alone).any()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, ""),
        ({"neighbours": None}, "found 0 images with both"),
        ({"frames": None}, "found 0 images with both"),
        ({"neighbours": [[-1, -1]] * 4}, "found 0 images with both"),
        ({"neighbours": [[0, 1], [0, 2], [2, 1], [-1, -1]]}, "image 2: .* found -5 frames"),
        ({"frames": [0.0, 5, 5, 0]}, "image 2: .* found 0 frames"),
        ({"frames": [0.0, 5, np.nan, 0]}, "image 1: .* found nan frames"),
        ({"readout": [np.nan, 0.5]}, "camera 0: expected a readout"),
        ({"readout": [0.5, np.nan]}, ""),  # no image of camera 1 is tied
    ],
)
def test_ties_need_times_in_order_and_readouts(changes, words):
    problem = problem_of(**changes)
    if not words:
        problem.rolling_shutter.check_tied(problem)
        return
    with pytest.raises(bundle.InputError, match=words):
        problem.rolling_shutter.check_tied(problem)


@pytest.mark.parametrize("direction", [0, 1])
def test_rows_beyond_two_heights_from_the_centre_are_not_read(direction):
    problem = problem_of()
    size, centre = np.array([640.0, 480]), np.array([320.0, 240])
    points = np.ones((4, 3))
    points[:, direction] = np.array([-2.01, -1.99, 1.99, 2.01]) * size[direction] / 500
    image = np.zeros(4, np.int32)
    along = np.full(4, direction)
    xy, times = read_positions(problem, image, points, np.zeros((4, 6)), along)
    np.testing.assert_allclose(times, [np.nan, -1.99, 1.99, np.nan], rtol=1e-12)
    np.testing.assert_allclose(xy[1:3], centre + 500 * points[1:3, :2], rtol=1e-12)
    assert np.isnan(xy[[0, 3]]).all()


@pytest.mark.parametrize("angle", [0.0, 0.0999, 0.1001, 3.1, 7.0])
def test_points_move_by_the_exponential_of_a_twist(angle):
    """The series of (h - sin h) / h^3 ends at h = 0.1."""
    twist, point = np.array([2.0, -1, 2, 5, 6, 7]) / 3, np.array([0.3, -0.4, 2])
    twist[:3] *= 2 * angle  # at the time 1/2
    x, y, z = twist[:3]
    matrix = np.array([[0, -z, y, 0], [z, 0, -x, 0], [-y, x, 0, 0], [0.0] * 4])
    matrix[:3, 3] = twist[3:]
    expected = (expm(0.5 * matrix) @ np.append(point, 1))[:3]
    found = moved(twist[None], np.array([0.5]), point[None])[0]
    np.testing.assert_allclose(found, expected, rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize("scale", [3.0, np.array([0.5, 1, 2, 4])])
def test_longer_units_lengthen_the_shifts_of_twists(scale):
    shutter = problem_of().rolling_shutter
    found = scaled(shutter, scale)
    np.testing.assert_array_equal(found.twist[:, :3], TWIST[:, :3])
    np.testing.assert_allclose(found.twist[:, 3:], TWIST[:, 3:] * np.reshape(scale, (-1, 1)))
    assert found.neighbours.tolist() == shutter.neighbours.tolist()
    assert scaled(None, scale) is None
