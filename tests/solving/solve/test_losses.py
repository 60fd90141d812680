"""Robust losses against formulas, Triggs' correction against Ceres', the page against both."""

import runpy
from pathlib import Path

import mpmath
import numpy as np
import pytest

import bundle
from bundle.interface.options import LOSSES
from bundle.model.losses import SECOND_ORDER_TERMS, correct, evaluate_loss, second_order_block
from tests import scenes

ROOT = Path(__file__).parents[3]
SCALES = [0.2, 1.0, 4.0]
# Multiples of the scale, none where a formula has its seam.
NORMS = [1e-9, 1e-3, 0.3, 0.5, 0.99, 1.01, 2.0, 3.0, 10.0, 1e3]

# rho(s) in mpmath, from the papers: Huber 1964, Charbonnier's sqrt, Black & Anandan's Lorentzian,
# Ceres' arctan, its scale squared to be in pixels, Beaton & Tukey's biweight in Ceres 2's scaling.
FORMULAS = {
    "trivial": lambda s, _: s,
    "huber": lambda s, a: s if s <= a * a else 2 * a * mpmath.sqrt(s) - a * a,
    "soft_l1": lambda s, a: 2 * a * a * (mpmath.sqrt(1 + s / a**2) - 1),
    "cauchy": lambda s, a: a * a * mpmath.log(1 + s / a**2),
    "arctan": lambda s, a: a * a * mpmath.atan(s / a**2),
    "tukey": lambda s, a: a * a / 3 * (1 - (1 - s / a**2) ** 3 if s <= a * a else 1),
}


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("loss", LOSSES)
def test_value_and_derivatives_are_those_of_the_formula(loss, scale):
    squared = [(scale * norm) ** 2 for norm in NORMS]
    with mpmath.workdps(60):
        a = mpmath.mpf(scale)
        small = mpmath.mpf("1e-15")
        expected = [
            [mpmath.diff(lambda t: FORMULAS[loss](t, a), s, k, h=s * small) for k in range(3)]
            for s in map(mpmath.mpf, squared)
        ]
    expected = np.array(expected, float)
    # A value is a difference of numbers as large as a^2, a second derivative as large as 1 / a^2.
    floor = 1e-15 * np.array([scale**2, 1, 1 / scale**2])
    found = evaluate_loss(loss, scale, squared)
    assert (np.abs(found - expected) <= 1e-12 * np.abs(expected) + 4 * floor).all()


@pytest.mark.parametrize("loss", LOSSES)
def test_every_loss_is_the_plain_one_near_zero_and_never_curves_up(loss):
    values = evaluate_loss(loss, 2.0, np.linspace(0, 100, 2001))
    np.testing.assert_array_equal(values[0, :2], [0, 1])
    assert (values[:, 1] >= 0).all()
    assert (values[:, 2] <= 0).all()
    assert (np.diff(values[:, 1]) <= 1e-15).all()


def test_the_cost_of_a_solve_is_made_of_these_values(solve):
    problem = scenes.make_problem(seed=1)
    squared = (scenes.residuals(problem) ** 2).sum(axis=1)
    for loss in LOSSES:
        scale = 1.0 if loss == "trivial" else 3.0
        summary = solve(problem, loss=loss, loss_scale=scale, max_num_iterations=0).summary
        expected = 0.5 * evaluate_loss(loss, scale, squared)[:, 0].sum()
        assert summary.initial_cost == pytest.approx(expected, rel=1e-12)


def random_block(rng, rows, columns):
    return rng.standard_normal(rows), rng.standard_normal((rows, columns))


@pytest.mark.parametrize("rows, columns", [(1, 1), (2, 6), (2, 9), (3, 4), (5, 2)])
@pytest.mark.parametrize(
    "rho",
    [
        (1.0, 1.0, 0.0),
        (1.0, 0.3, -0.2),  # as every loss of ours beyond its bend
        (1.0, 0.3, -5.0),  # indefinite
        (1.0, 0.3, 0.2),  # curves up: the second-order term is used
        (1.0, 1e-3, 10.0),
        (0.0, 0.0, 0.0),  # Tukey's, far out
    ],
)
def test_the_clamped_correction_is_the_one_ceres_makes(rho, rows, columns):
    residual, jacobian = random_block(np.random.default_rng(rows), rows, columns)
    ours = correct(rho, residual, jacobian, "clamped")
    theirs = correct(rho, residual, jacobian, "ceres")
    np.testing.assert_allclose(ours.residual, theirs.residual, rtol=1e-13)
    np.testing.assert_allclose(ours.jacobian, theirs.jacobian, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("norm", [0.0, 0.4, 1.7, 30.0])
def test_the_clamped_correction_of_each_loss_is_the_one_ceres_makes(loss, norm):
    residual, jacobian = random_block(np.random.default_rng(7), 2, 6)
    residual *= norm / np.linalg.norm(residual)
    rho = evaluate_loss(loss, 1.0, [residual @ residual])[0]
    ours = correct(rho, residual, jacobian, "clamped")
    theirs = correct(rho, residual, jacobian, "ceres")
    np.testing.assert_allclose(ours.residual, theirs.residual, rtol=1e-14)
    np.testing.assert_allclose(ours.jacobian, theirs.jacobian, rtol=1e-14)
    np.testing.assert_allclose(ours.jacobian, np.sqrt(rho[1]) * jacobian, rtol=1e-14)


@pytest.mark.parametrize("second", [0.4, 0.0, -0.05])
@pytest.mark.parametrize("rows, columns", [(1, 1), (2, 6), (4, 3)])
def test_the_full_correction_has_gradient_and_block_of_the_cost(second, rows, columns):
    residual, jacobian = random_block(np.random.default_rng(columns), rows, columns)
    residual /= np.linalg.norm(residual)
    rho = (1.0, 0.5, second)
    found = correct(rho, residual, jacobian, "full")
    gradient = rho[1] * jacobian.T @ residual
    np.testing.assert_allclose(found.jacobian.T @ found.residual, gradient, rtol=1e-12, atol=1e-14)
    middle = rho[1] * np.eye(rows) + 2 * rho[2] * np.outer(residual, residual)
    block = second_order_block(rho, residual, jacobian)
    np.testing.assert_allclose(block, jacobian.T @ middle @ jacobian, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(found.jacobian.T @ found.jacobian, block, rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize("term", SECOND_ORDER_TERMS)
def test_a_correction_keeps_the_gradient(term):
    residual, jacobian = random_block(np.random.default_rng(3), 2, 6)
    rho = evaluate_loss("cauchy", 2 * np.linalg.norm(residual), [residual @ residual])[0]
    found = correct(rho, residual, jacobian, term)
    np.testing.assert_allclose(
        found.jacobian.T @ found.residual, rho[1] * jacobian.T @ residual, rtol=1e-12
    )


def test_the_block_of_a_cauchy_kernel_goes_indefinite():
    expected = {0.5: 1.92, 1.0: 0.0, 2.0: -0.48, 3.0: -0.32, 10.0: -396 / 10201}
    for norm, value in expected.items():
        rho = evaluate_loss("cauchy", 1.0, [norm**2])[0]
        block = second_order_block(rho, [norm], [[2.0]])[0, 0]
        assert block == pytest.approx(value, abs=1e-14)
        assert (correct(rho, [norm], [[2.0]], "full") is None) == (value <= 0)
        clamped = correct(rho, [norm], [[2.0]], "ceres").jacobian[0, 0] ** 2
        assert clamped == pytest.approx(4 / (1 + norm**2), rel=1e-14)
        if norm == 3:
            assert clamped == pytest.approx(0.4, rel=1e-14)


def test_the_page_is_what_its_generator_gives():
    page = runpy.run_path(str(ROOT / "tools" / "robust_kernels.py"))["page"]()
    assert (ROOT / "docs" / "robust_kernels.md").read_text(encoding="utf-8") == page


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: evaluate_loss("hubert", 1.0, [1.0]), "loss: expected one of trivial, .*'hubert'"),
        (lambda: evaluate_loss("huber", 0.0, [1.0]), "scale: expected more than 0, found 0"),
        (
            lambda: evaluate_loss("huber", 1.0, [-1.0]),
            "squared_norms: expected numbers of 0 or more, found -1",
        ),
        (lambda: evaluate_loss("huber", 1.0, 1.0), r"squared_norms: expected shape \(N,\)"),
        (lambda: correct((1, 1), [1.0], [[1.0]]), r"rho: expected shape \(3,\), found \(2,\)"),
        (lambda: correct((1, 0, 1), [1.0], [[1.0]]), "rho: expected rho' above 0, found 0"),
        (lambda: correct((1, 1, 0), [1.0], [[1.0]], "half"), "second_order_term: expected one of"),
        (lambda: correct((1, 1, 0), [[1.0]], [[1.0]]), r"residual: expected shape \(m,\)"),
        (lambda: correct((1, 1, 0), [1.0, 2.0], [[1.0]]), r"jacobian: expected shape \(2, n\)"),
        (lambda: second_order_block((1, 1, 0), [], [[1.0]]), r"jacobian: expected shape \(0, n\)"),
    ],
)
def test_wrong_arguments_are_named(call, message):
    with pytest.raises(bundle.InputError, match=message):
        call()
