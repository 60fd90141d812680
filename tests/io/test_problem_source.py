"""A problem that was pickled has the same source, also what COLMAP's files would not hold."""

import copy
import pickle
from collections.abc import Callable

import numpy as np
import pycolmap
import pytest

from bundle import Problem
from bundle.model.pycolmap.problem_source import beside_the_problem
from tests.io.colmap_models import bal_like, errors_of, fields, synthesize


def a_source() -> pycolmap.Reconstruction:
    """An image has no pose; a camera knows its focal length."""
    source = synthesize(31)
    source.deregister_frame(source.image(4).frame_id)
    source.camera(2).has_prior_focal_length = True
    source.update_point_3d_errors()
    return source


def pickled(problem: Problem) -> Problem:
    result: Problem = pickle.loads(pickle.dumps(problem))
    return result


@pytest.mark.parametrize("again", [pickled, copy.deepcopy])
def test_a_source_comes_along(again: Callable[[Problem], Problem]) -> None:
    problem = Problem.from_pycolmap(a_source())
    result = again(problem)
    assert result.source is not problem.source
    assert fields(result.source) == fields(problem.source)
    assert errors_of(result.source) == errors_of(problem.source)
    assert {i: c.has_prior_focal_length for i, c in result.source.cameras.items()} == {
        1: False,
        2: True,
    }
    assert fields(result.to_pycolmap()) == fields(problem.to_pycolmap())


def test_an_edit_of_a_pickled_problem_is_written() -> None:
    problem = pickled(Problem.from_pycolmap(a_source()))
    kept = problem.observation_point != 7
    names = ("observation_image", "observation_point", "observation_xy", "observation_keypoint")
    edited = problem.replace(**{name: getattr(problem, name)[kept] for name in names})
    result = edited.to_pycolmap()
    assert result.compute_num_observations() == kept.sum()
    assert result.is_valid()


def test_what_a_source_has_beside_its_problem() -> None:
    assert beside_the_problem(bal_like().source) == []
    source = synthesize(32)
    assert beside_the_problem(source) == ["point colours", "rigs", "frames"]
    for point in source.points3D.values():
        point.color = np.zeros(3, np.uint8)
    assert beside_the_problem(source) == ["rigs", "frames"]
    assert beside_the_problem(a_source())[-1] == "images without a pose"
