"""The problem: shapes, values, sharing of memory."""

import dataclasses

import numpy as np
import pytest

from bundle import InputError, Problem
from bundle.problem import _DTYPES
from tests import scenes


def arrays(problem):
    return {name: getattr(problem, name) for name in _DTYPES}


def test_arrays_are_read_only_and_not_copied():
    points = np.random.default_rng(0).standard_normal((40, 3))
    problem = scenes.make_problem(points=points)
    assert np.shares_memory(problem.points, points)
    assert points.flags.writeable
    for name, array in arrays(problem).items():
        assert not array.flags.writeable, name
        assert array.flags.c_contiguous, name


def test_replace_shares_what_it_does_not_replace():
    problem = scenes.make_problem()
    other = problem.replace(points=problem.points + 1)
    assert np.shares_memory(other.observation_xy, problem.observation_xy)
    with pytest.raises(dataclasses.FrozenInstanceError):
        problem.points = other.points


def changed(name, index, value):
    def change(problem):
        array = getattr(problem, name).copy()
        array[index] = value
        return problem.replace(**{name: array})

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (changed("points", (3, 1), np.nan), "point 4: expected finite coordinates, found nan"),
        (changed("points", (3, 1), -np.inf), "point 4: expected finite coordinates, found -inf"),
        (changed("cam_from_world", (1, 5), np.inf), "image 2: expected a finite pose, found inf"),
        (
            changed("cam_from_world", (1, slice(0, 4)), 0),
            "image 2: expected a rotation, found a quaternion of norm 0",
        ),
        (
            changed("camera_params", (2, 0), 0),
            "camera 3: expected a positive focal length f, found 0",
        ),
        (
            changed("camera_params", (2, 0), -5),
            "camera 3: expected a positive focal length f, found -5",
        ),
        (changed("camera_params", (2, 3), np.nan), "camera 3: expected a finite k, found nan"),
        (
            changed("observation_xy", (7, 0), np.nan),
            r"observation 7 \(image 3, point 2\): expected finite pixels, found nan .*",
        ),
        (
            changed("observation_image", 7, 5),
            "observation 7: expected an image index below 5, found 5",
        ),
        (
            changed("observation_image", 7, -1),
            "observation 7: expected an image index below 5, found -1",
        ),
        (
            changed("observation_point", 7, 40),
            "observation 7: expected a point index below 40, found 40",
        ),
        (changed("image_camera", 0, 9), "image 1: expected a camera index below 5, found 9"),
        (changed("image_ids", 0, 3), "image 3: expected every id once, found twice"),
        (changed("point_ids", 9, 1), "point 1: expected every id once, found twice"),
        (changed("camera_ids", 1, 5), "camera 5: expected every id once, found twice"),
    ],
)
def test_bad_values_are_named(change, message):
    with pytest.raises(InputError, match=f"^{message}$"):
        change(scenes.make_problem())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"points": np.zeros((40, 2))}, r"points: expected shape \(N, 3\), found \(40, 2\)"),
        ({"points": np.zeros(3)}, r"points: expected shape \(N, 3\), found \(3,\)"),
        ({"point_ids": [1]}, r"point_ids: expected shape \(40,\), found \(1,\)"),
        ({"image_names": ["a"]}, "image_names: expected 5 names, found 1"),
        ({"camera_models": []}, "camera_models: expected 5 names, found 0"),
        (
            {"camera_params": np.ones((5, 3))},
            "camera 1: expected 4 parameters of SIMPLE_RADIAL, found 3",
        ),
        ({"cam_from_world": "text"}, "cam_from_world: expected numbers"),
        ({"observation_image": [0.5] * 200}, "observation_image: expected whole numbers"),
    ],
)
def test_bad_shapes_are_named(changes, message):
    with pytest.raises(InputError, match=message):
        scenes.make_problem(**changes)


def test_an_empty_problem_is_a_problem():
    problem = scenes.make_problem(num_points=0)
    assert (problem.num_points, problem.num_observations) == (0, 0)
    empty = Problem(
        cam_from_world=np.empty((0, 7)),
        image_ids=[],
        image_names=[],
        image_camera=[],
        camera_ids=[],
        camera_models=[],
        camera_params=np.empty((0, 0)),
        camera_sizes=np.empty((0, 2)),
        points=np.empty((0, 3)),
        point_ids=[],
        observation_image=[],
        observation_point=[],
        observation_xy=np.empty((0, 2)),
        observation_keypoint=[],
    )
    assert repr(empty) == "Problem(memory: 0 images, 0 cameras, 0 points, 0 observations)"
