"""AIC and BIC, and the dispersion of a loss."""

import numpy as np
import pytest

from bundle import SolveOptions
from bundle.judging.validation.prediction import dispersion, information_criteria


def test_dispersion_of_the_trivial_loss_is_the_variance():
    lengths = np.hypot(*(0.6 * np.random.default_rng(0).standard_normal((2, 20_000))))
    assert dispersion(lengths, SolveOptions()) == pytest.approx(np.mean(lengths**2) / 2)
    lengths[3] = np.nan
    assert dispersion(lengths, SolveOptions()) == pytest.approx(0.36, rel=0.03)
    assert np.isnan(dispersion(lengths[3:4], SolveOptions()))


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
    variance = dispersion(np.concatenate(pooled), options)
    assert 2 * np.mean(drops) / variance == pytest.approx(2.0, rel=0.15)  # two parameters


def test_criteria_by_hand():
    aic, bic = information_criteria(50.0, 0.5, 7, 400)
    assert aic == 200 + 14
    assert bic == pytest.approx(200 + 7 * np.log(400))
    assert np.isnan(information_criteria(50.0, float("nan"), 7, 400)).all()
