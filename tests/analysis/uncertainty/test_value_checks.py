"""Points far away that take over the inner constraints are named."""

import numpy as np
import pytest

from bundle.analysis.uncertainty.covariance_by_input import FAR, MOST_NAMED, note_on_far_points
from tests.scenes import make_problem

NONE = np.zeros(0, np.int32)


def with_far(count, distance):
    """A problem whose first points are so many times as far from the cameras as the others."""
    problem = make_problem(num_images=4, num_points=60)
    center = np.median(problem.projection_centers, axis=0)
    usual = np.median(np.linalg.norm(problem.points - center, axis=1))
    points = problem.points.copy()
    points[:count] = center + np.array([0.0, 0.0, distance * usual])
    return problem.replace(points=points)


@pytest.mark.parametrize("count", [1, MOST_NAMED, MOST_NAMED + 1])
def test_ids_are_named_up_to_a_number(count):
    problem = with_far(count, 10 * FAR)
    note = note_on_far_points(problem, NONE)
    named = ", ".join(str(k) for k in problem.point_ids[: min(count, MOST_NAMED)])
    assert f"(ids {named}" in note
    assert (", ...)" in note) == (count > MOST_NAMED)


def test_points_that_are_near_or_known_to_be_null_are_no_finding():
    assert note_on_far_points(with_far(3, 0.9 * FAR), NONE) == ""
    far = with_far(3, 1.1 * FAR)
    assert note_on_far_points(far, NONE)
    assert note_on_far_points(far, np.arange(3, dtype=np.int32)) == ""
