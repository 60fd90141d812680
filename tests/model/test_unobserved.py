"""Problems without observations."""

import pytest

from bundle import InputError
from bundle.model.unobserved import require_observations, unobserved
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
