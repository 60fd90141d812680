"""Points with more observations than a chunk of the fused backend is made for."""

import numpy as np
import pytest

import bundle
from tests import scenes


def repeat_first_point(times):
    """A scene whose point 0 is seen so often, by its own images again and again."""
    problem = scenes.make_problem(num_images=4, num_points=20)
    of_first = np.flatnonzero(problem.observation_point == 0)
    rows = np.concatenate([np.resize(of_first, times), np.flatnonzero(problem.observation_point)])
    names = ("image", "point", "xy", "keypoint")
    return problem.replace(
        **{f"observation_{name}": getattr(problem, f"observation_{name}")[rows] for name in names}
    )


def test_a_track_that_fills_several_chunks_takes_the_steps_of_ceres():
    fused, ceres = (
        bundle.solve(repeat_first_point(600), backend=backend, linear_solver_type="dense_schur")
        for backend in ("fused", "ceres")
    )
    np.testing.assert_allclose(fused.iterations["cost"], ceres.iterations["cost"], rtol=1e-8)


def test_a_track_beyond_that_is_left_to_ceres():
    problem = repeat_first_point(30_001)
    summary = bundle.solve(problem, max_num_iterations=1).summary
    assert summary.backend_used == "CERES"
    assert "at most 30000 observations a point" in summary.backend_choice
    with pytest.raises(bundle.InputError, match=r"at most 30000 .* found one with 30001"):
        bundle.solve(problem, backend="fused")
