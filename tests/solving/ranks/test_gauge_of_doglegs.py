"""Rounding along a free gauge, which doglegs divide by 1e-8, is taken out of their steps."""

import numpy as np
import pytest

import bundle
from tests.rig_scenes import rig_problem
from tests.scenes import make_problem
from tests.solving.ranks.thread_crew import processes

STRATEGIES = ["dogleg", "subspace_dogleg"]


def scene():
    size = {"num_images": 8, "num_points": 80, "model": "SIMPLE_RADIAL"}
    return make_problem(**size, perturbation=0.05)


def costs_apart(problem, strategy, num_ranks=3, **options):
    options = {"trust_region_strategy_type": strategy, "gauge": "none"} | options
    alone = bundle.solve(problem, num_threads=2, **options)
    with processes(num_ranks):
        divided = bundle.solve(problem, num_threads=1, **options)
    one, other = (summary.iterations["cost"] for summary in (alone, divided))
    assert len(one) == len(other) >= 4
    return np.max(np.abs(one / other - 1))


@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize("solver", ["dense_schur", "sparse_schur"])
def test_processes_agree(solver, strategy):
    assert costs_apart(scene(), strategy, linear_solver_type=solver) < 1e-11


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_rigs_agree(strategy):
    problem = rig_problem(num_frames=12, num_points=300, perturbation=0.05)
    assert costs_apart(problem, strategy) < 1e-11


def test_an_image_that_sees_nothing_holds_nothing():
    problem = scene()
    seen = problem.observation_image != 3
    names = [f"observation_{name}" for name in ("image", "point", "xy", "keypoint")]
    unseen = problem.replace(**{name: getattr(problem, name)[seen] for name in names})
    assert costs_apart(unseen, "dogleg") < 1e-11


def test_a_point_held_on_one_process_holds_the_world_of_all():
    problem = scene()
    held = {"fixed_point_ids": (int(problem.point_ids[5]),)}
    assert costs_apart(problem, "dogleg", **held) < 1e-9


def position(problem, image):
    at = problem.projection_centers[image] + (0.3, -0.2, 0.1)
    return bundle.PositionFactor(("image", int(problem.image_ids[image])), at, np.eye(3))


HOLDS = {
    "nothing": lambda _: {},
    "rigs": lambda _: {},
    "an image": lambda problem: {"fixed_image_ids": (int(problem.image_ids[3]),)},
    "a point": lambda problem: {"fixed_point_ids": (int(problem.point_ids[5]),)},
    "a prior": lambda problem: {"factors": [position(problem, 2)]},
}


@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize("held", HOLDS)
def test_steps_are_those_of_ceres(held, strategy):
    problem = rig_problem(perturbation=0.05) if held == "rigs" else scene()
    options = HOLDS[held](problem) | {
        "trust_region_strategy_type": strategy,
        "linear_solver_type": "dense_schur",
        "max_num_iterations": 5,
        "gauge": "none",
    }
    ours, ceres = (bundle.solve(problem, backend=name, **options) for name in ("fused", "ceres"))
    np.testing.assert_allclose(ours.iterations["cost"], ceres.iterations["cost"], rtol=1e-7)
    np.testing.assert_allclose(
        ours.iterations["step_norm"], ceres.iterations["step_norm"], rtol=1e-6
    )
