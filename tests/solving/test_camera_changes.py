"""Changes of the cameras by a solve."""

import numpy as np
import pytest

import bundle
from bundle.solving.parameter_changes import camera_changes
from tests.reports.terminal import fakes
from tests.scenes import make_problem


def test_the_largest_movers_come_first_and_what_is_held_is_missing():
    problem = make_problem(model="OPENCV", num_images=4, num_points=10)
    params = problem.camera_params.copy()
    focal = params[:, :2].mean(axis=1)
    params[1, 0] += 0.02 * focal[1]
    params[2, 4] += 0.05  # k1
    params[3, 2] -= 0.03 * focal[3]  # cx
    solved = fakes.result(problem.replace(camera_params=params), initial_problem=problem)
    found = camera_changes(solved)
    assert [change.camera_id for change in found] == [3, 4, 2]
    assert [change.movement for change in found] == pytest.approx([0.05, 0.03, 0.02])
    assert list(found[0].after) == ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"]
    assert found[1].before["cx"] == problem.camera_params[3, 2]
    assert found[1].after["cx"] == params[3, 2]


def test_a_real_solve(backend):
    problem = make_problem(num_images=4, num_points=40)
    solved = bundle.solve(problem, backend=backend, fixed_camera_ids=[2])
    found = {change.camera_id: change for change in camera_changes(solved)}
    assert sorted(found) == [1, 3, 4]
    for index, camera in enumerate(problem.camera_ids):
        if camera in found:
            values = list(found[camera].after.values())
            np.testing.assert_array_equal(values, solved.problem.camera_params[index][:4])
