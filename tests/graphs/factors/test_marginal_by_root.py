"""Information by square roots where normal equations lose their digits, or a refusal."""

import numpy as np
import pytest

import bundle
from tests.graphs.factors.test_square_root import linear, with_condition


def chain(num, *, seed=0, weak=1.0):
    """Positions and velocities driven by noise, a prior on the first: ill-conditioned when long."""
    rng = np.random.default_rng(seed)
    graph = bundle.FactorGraph()
    graph.add_variable(0, rng.normal(size=2))
    graph.add_factor(bundle.PriorFactor(0, [0.0, 0.0], np.diag([1e8, 1e8])))
    step = np.array([[1.0, 1.0], [0, 1]])
    root = np.linalg.cholesky(np.linalg.inv(np.array([[1 / 3, 1 / 2], [1 / 2, 1]]) * 1e-4)).T * weak
    for k in range(1, num):
        graph.add_variable(k, rng.normal(size=2))
        graph.add_factor(
            bundle.FunctionFactor(
                [k - 1, k], lambda v: (root @ (v[1] - step @ v[0]), [-root @ step, root])
            )
        )
    spread = np.eye(2) * 1e-8
    noise = np.linalg.inv(root.T @ root)
    for _ in range(1, num):
        spread = step @ spread @ step.T + noise
    return graph, spread


@pytest.mark.parametrize("num", [3, 30, 300, 1000])
def test_the_end_of_a_chain_is_as_uncertain_as_its_recursion_says(num):
    graph, spread = chain(num)
    for keys in ([num - 1], [num - 1, 0]):
        matrix, eta = graph.information(keys)
        assert np.linalg.eigvalsh(matrix)[0] > 0 and (matrix == matrix.T).all()
        assert eta.shape == (2 * len(keys),)
        if len(keys) == 1:
            np.testing.assert_allclose(np.linalg.inv(matrix), spread, rtol=1e-6)


def dense_marginal(rows, residual, kept):
    """R^T R and its vector by a dense QR factorisation, eliminated columns first."""
    others = np.setdiff1d(np.arange(rows.shape[1]), kept)
    stacked = np.hstack([rows[:, others], rows[:, kept], -residual[:, None]])
    root = np.linalg.qr(stacked, mode="r")[len(others) : len(others) + len(kept)]
    return root[:, len(others) : -1].T @ root[:, len(others) : -1], (
        root[:, len(others) : -1].T @ root[:, -1]
    )


@pytest.mark.parametrize("kappa", [1e2, 1e5, 1e7, 1e9])
def test_blocks_of_any_condition(kappa):
    """One variable is split off another by rows that are ill-conditioned together."""
    for seed in range(3):
        jacobian, truth = with_condition(kappa, seed, rows=20, columns=8)
        graph = bundle.FactorGraph()
        graph.add_variable("a", np.zeros(5))
        graph.add_variable("b", np.zeros(3))
        right = jacobian @ truth
        graph.add_factor(
            bundle.FunctionFactor(
                ["b", "a"],
                lambda v, j=jacobian, r=right: (
                    j[:, :5] @ v[1] + j[:, 5:] @ v[0] - r,
                    [j[:, 5:], j[:, :5]],
                ),
            )
        )
        matrix, eta = graph.information(["b"])
        expected, vector = dense_marginal(jacobian, -right, np.arange(5, 8))
        scale = np.sqrt(np.diag(expected))
        np.testing.assert_allclose(
            matrix / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-14 * kappa
        )
        np.testing.assert_allclose(eta / scale, vector / scale, atol=1e-14 * kappa)
        assert np.linalg.eigvalsh(matrix)[0] > 0
        found = np.linalg.solve(matrix, eta)
        np.testing.assert_allclose(found, truth[5:], atol=1e-13 * kappa)


def test_the_order_of_the_keys_is_kept_and_held_ones_count_as_free():
    graph, _ = chain(40)
    graph.add_variable("h", [0.5], fixed=True)
    graph.add_variable("g", [0.1])
    graph.add_factor(
        bundle.FunctionFactor(
            ["h", 39, "g"],
            lambda v: (
                np.array([v[0][0] - v[1][1], 1e5 * (v[2][0] - v[1][0])]),
                [
                    np.array([[1.0], [0]]),
                    np.array([[0, -1.0], [-1e5, 0]]),
                    np.array([[0.0], [1e5]]),
                ],
            ),
        )
    )
    one, eta = graph.information(["h", 20, 39])
    other, other_eta = graph.information([39, "h", 20])
    order = [3, 4, 0, 1, 2]
    scale = np.sqrt(np.diag(other))
    gap = (one[np.ix_(order, order)] - other) / np.outer(scale, scale)
    np.testing.assert_allclose(gap, 0, atol=1e-9)
    np.testing.assert_allclose(eta[order] / scale, other_eta / scale, atol=1e-7)
    assert one[0, 0] == pytest.approx(1.0, rel=1e-9)  # its one row, all else eliminated but 39


def test_what_is_not_determined_is_refused_by_name():
    graph, _ = chain(200)
    graph.add_variable("loose", [1.0, 2.0])
    graph.add_factor(
        bundle.LinearPrior(np.diag([1.0, 0.0]), [0, 0], {"loose": [1.0, 2.0]}, ["loose"])
    )
    with pytest.raises(bundle.InputError, match="'loose': expected factors that determine"):
        graph.information([3])
    with pytest.raises(bundle.InputError, match="'loose': expected factors that determine"):
        graph.information([199])
    matrix, _ = graph.information(["loose"])
    np.testing.assert_allclose(matrix, np.diag([1.0, 0.0]), atol=1e-15)


def test_a_graph_without_a_gauge_has_a_free_direction_and_no_negative_one():
    rng = np.random.default_rng(0)
    graph = bundle.FactorGraph()
    for k in range(60):
        graph.add_variable(k, [*rng.normal(size=2), 0.1 * k], "se2")
    for k in range(59):
        graph.add_factor(bundle.BetweenFactor(k, k + 1, rng.normal(size=3), 100.0))
    graph.add_factor(bundle.BetweenFactor(59, 0, rng.normal(size=3), 100.0))
    matrix, _ = graph.information([0, 30])
    values = np.linalg.eigvalsh(matrix)
    assert (values[:3] > -1e-13 * values[-1]).all() and (values[:3] < 1e-9 * values[-1]).all()
    assert values[3] > 1e-6 * values[-1]


def test_a_prior_of_one_variable_stays_as_it_was():
    jacobian, truth = with_condition(1e3, 0)
    matrix, _ = linear(jacobian, jacobian @ truth).information()
    np.testing.assert_allclose(matrix, jacobian.T @ jacobian, rtol=1e-12, atol=1e-15)
