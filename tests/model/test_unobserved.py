"""Problems without observations."""

import numpy as np
import pytest

from bundle import InputError, SolveOptions
from bundle.model.unobserved import require_observations, require_tracks, unobserved
from tests.scenes import make_problem


def test_advice_to_triangulate_is_for_images_without_points():
    whole = make_problem(num_images=3, num_points=12)
    unseen = whole.select(observations=[]).problem
    bare = whole.select(observations=[], points=[]).problem
    assert unobserved(whole) == ""
    assert (unseen.num_points, bare.num_points) == (12, 0)
    assert "triangulat" not in unobserved(unseen)
    assert "triangulat" in unobserved(bare)
    require_observations(whole, "model")
    with pytest.raises(InputError, match=r"^model: "):
        require_observations(unseen, "model")


def test_one_point_that_two_images_see_is_enough():
    whole = make_problem(num_images=3, num_points=12)
    first = np.unique(whole.observation_point, return_index=True)[1]
    alone = whole.select(observations=first).problem
    assert (alone.num_observations, alone.num_points) == (12, 12)
    require_observations(alone, "model")
    with pytest.raises(InputError, match=r"^model: .*12 points"):
        require_tracks(alone, "model", SolveOptions())
    second = np.flatnonzero(whole.observation_point == 0)[:2]
    enough = whole.select(observations=np.union1d(first, second)).problem
    require_tracks(enough, "model", SolveOptions())
    require_tracks(alone, "model", SolveOptions(refine="poses"))
    require_tracks(alone, "model", SolveOptions(fixed_point_ids=[int(alone.point_ids[0])]))
    require_tracks(whole.select(observations=[]).problem, "model", SolveOptions())
