"""AIC and BIC, and the dispersion of a loss."""

from types import SimpleNamespace

import numpy as np
import pytest

from bundle import SolveOptions
from bundle.judging.validation.candidate_fits import dispersion, information_criteria
from bundle.judging.validation.judgement import _criteria
from bundle.judging.validation.known_positions import Certainty


def test_dispersion_of_the_trivial_loss_is_the_variance():
    lengths = np.hypot(*(0.6 * np.random.default_rng(0).standard_normal((2, 20_000))))
    assert dispersion(lengths, 30_000, SolveOptions()) == pytest.approx(np.sum(lengths**2) / 30_000)
    lengths[3] = np.nan
    assert dispersion(lengths, 39_998, SolveOptions()) == pytest.approx(0.36, rel=0.03)
    assert np.isnan(dispersion(lengths[3:4], 2, SolveOptions()))
    assert np.isnan(dispersion(lengths, 0, SolveOptions()))


def test_criteria_of_a_validation_divide_by_the_degrees_of_freedom():
    """The noise is that of the fit with the most parameters: 90 / (60 - 45) = 6."""

    def fit(square, loss="trivial", error=""):
        residuals = np.full((30, 2), np.sqrt(square / 60))
        summary = SimpleNamespace(num_residuals=60, final_cost=square / 2)
        return SimpleNamespace(
            candidate=SimpleNamespace(loss=loss), error=error, residuals=residuals,
            full=SimpleNamespace(summary=summary),
        )  # fmt: skip

    fitting = SimpleNamespace(
        problem=SimpleNamespace(observation_sigma=None), options=SolveOptions()
    )
    fits = [fit(120.0), fit(90.0), fit(1.0, error="failed"), fit(1.0)]
    known = [Certainty(0.1, count) for count in (40, 45, 50, 0)]
    found = np.array(_criteria(fits, known, fitting))
    # 2 C / s^2 is 20 and 15.
    assert found[:2, 0] == pytest.approx([0.0, 5.0])
    assert found[:2, 1] == pytest.approx([0.0, 5.0 * np.log(60) - 5.0])
    assert np.isnan(found[2:]).all()


@pytest.mark.parametrize("loss", ["trivial", "cauchy", "huber"])
def test_extra_parameters_lower_the_cost_by_the_dispersion(loss):
    """Fit a constant that is zero to robust residuals: 2 C / s^2 falls by 1 per parameter."""
    from scipy.optimize import minimize

    from bundle.model.losses import evaluate_loss

    options, rng, drops = SolveOptions(loss=loss, loss_scale=1.0), np.random.default_rng(1), []
    pooled = []
    for _ in range(300):
        r = 0.8 * rng.standard_normal((150, 2))

        def cost(shift, r=r):
            squares = ((r - shift) ** 2).sum(axis=1)
            return evaluate_loss(loss, 1.0, squares)[:, 0].sum() / 2

        drops.append(cost(np.zeros(2)) - minimize(cost, np.zeros(2)).fun)
        pooled.append(np.hypot(*r.T))
    variance = dispersion(np.concatenate(pooled), 300 * 300, options)
    assert 2 * np.mean(drops) / variance == pytest.approx(2.0, rel=0.15)  # two parameters


@pytest.mark.parametrize("loss", ["trivial", "cauchy", "huber"])
def test_dispersion_holds_for_as_many_parameters_as_half_the_residuals(loss):
    """20 columns without effect lower 2 C / s^2 by 20, although 40 others absorb noise."""
    from scipy.optimize import minimize

    from bundle.model.losses import evaluate_loss

    options, rng = SolveOptions(loss=loss, loss_scale=1.0), np.random.default_rng(2)
    drops, variances = [], []
    for _ in range(12):
        noise, columns = 0.5 * rng.standard_normal(120), rng.standard_normal((120, 60))

        def cost(values, noise=noise, columns=columns):
            residual = noise - columns[:, : len(values)] @ values
            squares = (residual.reshape(-1, 2) ** 2).sum(axis=1)
            rho = evaluate_loss(loss, 1.0, squares)
            weighted = np.repeat(rho[:, 1], 2) * residual
            return rho[:, 0].sum() / 2, -columns[:, : len(values)].T @ weighted

        small, large = (minimize(cost, np.zeros(count), jac=True) for count in (40, 60))
        drops.append(small.fun - large.fun)
        left = (noise - columns @ large.x).reshape(-1, 2)
        variances.append(dispersion(np.hypot(*left.T), 60, options))
    assert 2 * np.mean(drops) / np.mean(variances) == pytest.approx(20.0, rel=0.25)


def test_criteria_by_hand():
    aic, bic = information_criteria(50.0, 0.5, 7, 400)
    assert aic == 200 + 14
    assert bic == pytest.approx(200 + 7 * np.log(400))
    assert np.isnan(information_criteria(50.0, float("nan"), 7, 400)).all()
