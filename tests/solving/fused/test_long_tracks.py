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


# As many images as first have more pairs than 16 bits number in the blocks of one chunk, given how
# many unknowns an image has.
@pytest.mark.parametrize(
    ("num_images", "model", "refine"),
    [
        (362, "OPENCV", "points,focal"),  # 2 unknowns
        (416, "OPENCV", "points,focal,extra"),  # 6
        (538, "SIMPLE_RADIAL", "poses,points,focal"),  # 7
        (1336, "OPENCV", "points,focal,extra,principal-point"),  # 8
    ],
)
def test_tracks_of_many_different_images_take_the_steps_of_ceres(num_images, model, refine):
    # One camera and few free poses, so that S is small.
    problem = scenes.make_problem(num_images=num_images, num_points=12, model=model, shared=True)
    costs = [
        bundle.solve(
            problem,
            backend=backend,
            linear_solver_type="dense_schur",
            refine=refine.replace("-", "_").split(","),
            fixed_image_ids=problem.image_ids[20:],
            max_num_iterations=3,
        ).iterations["cost"]
        for backend in ("fused", "ceres")
    ]
    np.testing.assert_allclose(costs[0], costs[1], rtol=1e-8)


def test_a_track_beyond_that_is_left_to_ceres():
    problem = repeat_first_point(10_001)
    summary = bundle.solve(problem, max_num_iterations=1).summary
    assert summary.backend_used == "CERES"
    assert "at most 10000 observations per point" in summary.backend_choice
    with pytest.raises(bundle.InputError, match=r"at most 10000 .* found a point with 10001"):
        bundle.solve(problem, backend="fused")
