"""The same bits for any number of threads."""

import numpy as np
import pytest

import bundle
from tests import scenes

SCENES = {
    "own cameras": {"num_images": 20, "num_points": 3000, "track": 5, "model": "RADIAL"},
    "one camera": {"num_images": 30, "num_points": 2000, "track": 6, "shared": True},
    # So many columns that OpenBLAS' own threads are worth it.
    "many images": {"num_images": 180, "num_points": 2500, "track": 4},
}


@pytest.mark.parametrize("solver", ["dense_schur", "sparse_schur", "iterative_schur"])
@pytest.mark.parametrize("scene", SCENES)
def test_fused_gives_the_same_bits_on_any_number_of_threads(scene, solver):
    problem = scenes.make_problem(seed=1, **SCENES[scene])
    options = {"linear_solver_type": solver, "loss": "huber", "max_num_iterations": 5}
    one, two, again = (
        bundle.solve(problem, backend="fused", deterministic=True, num_threads=n, **options)
        for n in (1, 2, 2)
    )
    for other in (two, again):
        for name in ("cam_from_world", "camera_params", "points"):
            np.testing.assert_array_equal(
                getattr(other.problem, name), getattr(one.problem, name), err_msg=name
            )
        np.testing.assert_array_equal(other.iterations["cost"], one.iterations["cost"])
    assert one.summary.warnings == two.summary.warnings == ()


def test_ceres_gets_one_thread_and_says_so():
    problem = scenes.make_problem(seed=2)
    result = bundle.solve(problem, backend="ceres", deterministic=True, num_threads=2)
    assert result.summary.num_threads_used == 1
    expected = () if result.options.num_threads == 1 else ("single_thread",)
    assert result.summary.warning_kinds == expected
    alone = bundle.solve(problem, backend="ceres", num_threads=1)
    np.testing.assert_array_equal(result.problem.points, alone.problem.points)
