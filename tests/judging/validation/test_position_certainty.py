"""Certainty of positions, against Monte Carlo and against a point that would decide the gauge."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.judging.validation.known_positions import certainty, position_sigmas
from bundle.solving.executors import solve_prepared
from bundle.solving.prepare import prepare
from bundle.solving.request import SolveRequest
from tests.scenes import make_problem, residuals, with_observations


def fitted(problem, **options):
    prepared = prepare(
        SolveRequest(
            problem=problem, options=bundle.SolveOptions(function_tolerance=1e-12, **options)
        )
    )
    return prepared, solve_prepared(prepared, None)


def test_sigmas_of_positions_are_those_of_random_poses():
    rng = np.random.default_rng(0)
    problem = make_problem(num_images=4)
    factor = 1e-4 * rng.standard_normal((4, 6, 6))
    covariances = factor @ factor.transpose(0, 2, 1)
    steps = np.einsum("nij,knj->kni", factor, rng.standard_normal((20_000, 4, 6)))
    poses = problem.cam_from_world
    start = Rotation.from_quat(poses[:, :4])
    for row in range(4):
        turned = Rotation.from_rotvec(steps[:, row, :3]) * start[row]
        moved = -turned.inv().apply(poses[row, 4:] + steps[:, row, 3:])
        spread = np.sqrt(moved.var(axis=0).sum() / 3)
        assert position_sigmas(problem, covariances)[row] == pytest.approx(spread, rel=0.03)


def test_number_of_parameters_is_their_rank():
    shared = make_problem(num_images=6, num_points=60, shared=True)
    found = certainty(*fitted(shared))
    assert found.num_parameters == 6 * 6 + 3 * 60 + 2 - 7
    each = certainty(*fitted(make_problem(num_images=6, num_points=60)))
    assert each.num_parameters == 6 * 6 + 3 * 60 + 12 - 7
    assert each.position_sigma > found.position_sigma > 0


def test_far_points_and_wrong_matches_do_not_decide():
    rng = np.random.default_rng(1)
    problem = make_problem(num_images=6, num_points=120, shared=True, perturbation=0)
    near = certainty(*fitted(problem))
    points, xy = problem.points.copy(), problem.observation_xy.copy()
    far = problem.observation_point < 5
    points[:5] = np.array([0, 0, 1e4]) + rng.standard_normal((5, 3))
    problem = problem.replace(points=points)
    xy[far] += residuals(problem)[far] + 0.5 * rng.standard_normal((far.sum(), 2))
    found = certainty(*fitted(problem.replace(observation_xy=xy)))
    assert found.position_sigma == pytest.approx(near.position_sigma, rel=0.2)
    assert found.num_parameters == 6 * 6 + 3 * 120 + 2 - 7


def test_undetermined_fits_have_a_reason():
    problem = make_problem(num_images=3, num_points=4, track=2)
    found = certainty(*fitted(with_observations(problem, slice(0, 6))))
    assert np.isnan(found.position_sigma)
    assert found.num_parameters == 0
    assert found.note
