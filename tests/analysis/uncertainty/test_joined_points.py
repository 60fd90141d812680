"""Analyses beside factors that join points: scale bars, planes and functions of users."""

import numpy as np
import pytest

import bundle
import bundle._core as _core
from bundle.solving.layout import lay_out
from tests.analysis.uncertainty.dense import Dense
from tests.analysis.uncertainty.random_problems import Case, known_distances
from tests.analysis.uncertainty.test_covariance import compare
from tests.analysis.uncertainty.test_reliability import check_rows, diagonal_blocks, residual_maker
from tests.scenes import make_problem


@pytest.fixture(scope="module")
def case():
    """A sparse reduced system, with joined points anywhere in its order."""
    problem = make_problem(num_images=60, num_points=150, seed=4, track=5, shared=True)
    dense, factors, rng = Dense(problem), [], np.random.default_rng(2)
    for has_image in (False, True, False):
        known_distances(problem, dense, factors, rng, has_image=has_image)
    free = [name[0] != "camera" or name[2] in (0, 3) for name in dense.names]
    rows = sum(dense.prior_sizes)
    return Case(problem, {}, factors, dense, np.eye(len(free))[:, free], rows, True)


@pytest.mark.parametrize("num_threads", [1, 2])
def test_covariances_agree_with_dense_matrices(case, num_threads):
    cov = bundle.covariance(case.problem, factors=case.factors, num_threads=num_threads)
    assert max(compare(case, case.dense.covariance(case.basis), cov).values()) < 1e-8


def test_redundancies_agree_with_dense_matrices(case):
    found = bundle.reliability(case.problem, factors=case.factors, align=False, num_threads=2)
    whole = residual_maker(case.dense.jacobian @ case.basis)
    n = case.problem.num_observations
    residual = case.dense.residual[: 2 * n].reshape(-1, 2)
    check_rows(found, diagonal_blocks(whole)[:n], residual, rtol=1e-7, atol=1e-8)
    starts = 2 * n + np.cumsum([0, *case.dense.prior_sizes])
    trace = {
        factor.name: np.diag(whole)[a:b].sum()
        for factor, a, b in zip(case.factors, starts, starts[1:], strict=False)
    }
    assert {one.name: one.redundancy for one in found.priors} == pytest.approx(trace, abs=1e-8)


def test_the_order_of_points_changes_nothing(case):
    problem = case.problem
    order = np.random.default_rng(5).permutation(problem.num_points)
    place = np.argsort(order)
    permuted = problem.replace(
        points=problem.points[order],
        point_ids=problem.point_ids[order],
        observation_point=place[problem.observation_point].astype(np.int32),
    )
    ours, theirs = (bundle.covariance(one, factors=case.factors) for one in (problem, permuted))
    np.testing.assert_allclose(theirs.pose_covariance, ours.pose_covariance, rtol=1e-8, atol=1e-14)
    np.testing.assert_allclose(
        theirs.point_covariance, ours.point_covariance[order], rtol=1e-7, atol=1e-14
    )


def test_six_directions_are_gauge_and_nothing_else_is_open(case):
    found = bundle.diagnose(case.problem, factors=case.factors)
    assert found.nullity == found.expected_nullity == 6
    assert not found.weak_modes


def test_the_predicted_decrease_is_that_of_a_newton_step(case):
    found = newton_step_of(case)
    rows, r = case.dense.jacobian @ case.basis, case.dense.residual
    step = np.linalg.lstsq(rows, -r, rcond=1e-12)[0]
    assert found["predicted_decrease"] == pytest.approx(-0.5 * step @ rows.T @ r, rel=1e-6)
    assert found["weighted_squares"] == pytest.approx(r @ r, rel=1e-12)


def newton_step_of(case):
    options = bundle.SolveOptions(gauge="none", num_threads=1)
    layout = lay_out(case.problem, options, case.factors)
    return _core.covariance(
        case.problem, layout.options.asdict(), None, layout.core_factors(), inner=True,
        sandwich=False, of_points=False, relative=[], long_sums=False, of_images=False,
    )  # fmt: skip


def test_more_dependent_numbers_than_numbers_are_refused(case):
    key = ("point", int(case.problem.point_ids[0]))
    one = bundle.FunctionFactor([key], lambda values: (values[0], [np.eye(3)]), 4)
    with pytest.raises(bundle.InputError, match=r"num_dependent: expected at most 3, found 4$"):
        bundle.covariance(case.problem, factors=[*case.factors, one])


def test_a_point_that_one_image_sees_is_named(case):
    """Its distance to another point does not determine it."""
    problem = case.problem
    keep = np.ones(problem.num_observations, bool)
    keep[np.flatnonzero(problem.observation_point == 7)[1:]] = False
    once = problem.select(observations=keep).problem
    ids = [int(problem.point_ids[k]) for k in (7, 8)]

    def distance(values):
        line = values[1] - values[0]
        length = np.linalg.norm(line)
        return [length - 1], [-line[None] / length, line[None] / length]

    factor = bundle.FunctionFactor([("point", key) for key in ids], distance)
    for analyse in (bundle.covariance, bundle.reliability):
        with pytest.raises(bundle.InputError, match="full rank"):
            analyse(once, factors=[factor])


def test_a_sandwich_beside_joined_points_is_refused(case):
    with pytest.raises(bundle.InputError, match=r"^robust: expected weights [^\n]*$"):
        bundle.covariance(case.problem, factors=case.factors, robust="sandwich")


@pytest.mark.parametrize("scale", [1, 1e10])
def test_the_unit_of_length_changes_no_direction(scale):
    """A joined point is an unknown of length `distance`, whose derivatives shrink with the unit."""
    problem = make_problem(num_images=12, num_points=60, seed=4, track=5, shared=True)
    poses = problem.cam_from_world.copy()
    poses[:, 4:] *= scale
    problem = problem.replace(points=scale * problem.points, cam_from_world=poses)

    def distance(values):
        line = (values[1] - values[0]) / scale
        direction = line / np.linalg.norm(line) / scale
        return [np.linalg.norm(line) - 1], [-direction[None], direction[None]]

    keys = [[("point", int(problem.point_ids[a + k])) for k in (0, 1)] for a in (3, 10)]
    found = bundle.diagnose(
        problem, factors=[bundle.FunctionFactor(pair, distance) for pair in keys]
    )
    assert found.nullity == found.expected_nullity == 6
    assert not found.weak_modes
