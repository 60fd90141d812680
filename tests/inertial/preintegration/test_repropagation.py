"""The closed form of what a first-order correction leaves, and the verdict that follows from it."""

import itertools
import math

import numpy as np
import pytest

import bundle
from bundle.inertial.preintegration.preintegration import first_order_error
from tests.inertial.preintegration import recursion

NOISE = bundle.ImuNoise(1.7e-4, 2e-3, 2e-5, 3e-3)
ZEROS = np.zeros(3)

CASES = list(itertools.product((0.25, 0.5, 1, 2, 5), (5, 30, 90, 180, 360), (1e-3, 3e-3, 1e-2)))


def turning(duration, rate, samples=1000):
    motion = bundle.Preintegration(NOISE)
    gyro = np.tile([0, 0, rate], (samples, 1))
    motion.integrate(gyro, np.zeros((samples, 3)), np.full(samples, duration / samples))
    return motion


@pytest.mark.parametrize(("duration", "degrees", "change"), CASES)
def test_closed_form_of_a_constant_rate(duration, degrees, change):
    motion = turning(duration, math.radians(degrees))
    bias = [0.6 * change, 0.8 * change, 0]
    first, _, _ = motion.corrected(bias, ZEROS)
    exact = motion.repropagated(bias, ZEROS).delta_rotation
    error = np.linalg.norm(recursion.log(first.T @ exact))
    predicted = first_order_error(math.radians(degrees) * duration, change, duration)
    assert error == pytest.approx(predicted, rel=0.01)


def test_there_are_75_cases():
    assert len(CASES) == 75


def test_series_meets_the_formula():
    for angle in (0.0999999, 0.1):
        formula = (angle - math.sin(angle)) / (2 * angle**2)
        assert first_order_error(angle, 1, 1) == pytest.approx(formula, rel=1e-11)
    assert first_order_error(0, 1, 1) == 0
    assert first_order_error(math.pi, 1, 1) == pytest.approx(1 / (2 * math.pi))


@pytest.mark.parametrize(
    ("duration", "degrees", "change"),
    [(0.25, 90, 0.709), (1, 90, 0.094), (2, 90, 0.040), (5, 30, 0.016)],
)
def test_verdict_turns_where_the_tilt_is_the_accelerometers_bias(duration, degrees, change):
    motion = turning(duration, math.radians(degrees))
    below, above = (motion.needs_repropagation([0, f * change, 0]) for f in (0.97, 1.03))
    assert not below
    assert above
    assert below.limit == above.limit == pytest.approx(1.02e-3, rel=1e-3)
    assert below.tilt < below.limit < above.tilt
    assert "within" in below.reason
    assert "above" in above.reason
    assert not motion.needs_repropagation([0, 1.03 * change, 0], accel_bias_sigma=0.02)


def test_long_turns_count_as_the_least_favourable_angle():
    verdict = turning(5, math.radians(90)).needs_repropagation([0.03, 0, 0])
    assert verdict.tilt == pytest.approx(0.15**2 / (2 * math.pi))
    assert verdict.turned == pytest.approx(math.radians(450))
    assert repr(verdict).startswith("Repropagation: needed")


def test_nothing_integrated_needs_nothing():
    assert not bundle.Preintegration(NOISE).needs_repropagation([1, 1, 1])
