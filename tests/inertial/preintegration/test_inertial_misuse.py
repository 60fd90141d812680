"""Samples, noise and keys that are wrong: one line says which."""

import numpy as np
import pytest

import bundle
from bundle import InputError
from bundle.inertial.preintegration.preintegration import HEALTHY, UNOBSERVABLE

NOISE = bundle.ImuNoise(1.7e-4, 2e-3, 2e-5, 3e-3)
GYRO, ACCEL, DT = np.full((4, 3), 0.1), np.tile([0, 0, 9.81], (4, 1)), np.full(4, 0.01)
NAN_ROW = np.where(np.arange(12).reshape(4, 3) == 7, np.nan, 1.0)
STATE = [0, 0, 0, 1, *np.zeros(12)]


def refused(function, *words):
    with pytest.raises(InputError) as caught:
        function()
    text = str(caught.value)
    assert len(text.splitlines()) == 1
    for word in words:
        assert word in text, text


@pytest.mark.parametrize(
    ("samples", "words"),
    [
        ((NAN_ROW, ACCEL, DT), ("gyro[2, 1]", "nan")),
        ((GYRO, NAN_ROW, DT), ("accel[2, 1]", "nan")),
        ((GYRO, np.full((4, 3), np.inf), DT), ("accel[0, 0]", "inf")),
        ((GYRO, ACCEL, [0.01, 0, 0.01, 0.01]), ("dt[1]", "above 0")),
        ((GYRO, ACCEL, [0.01, 0.01, 0.01, -0.01]), ("dt[3]", "-0.01")),
        ((GYRO, ACCEL, [np.nan, 0.01, 0.01, 0.01]), ("dt[0]", "nan")),
        ((GYRO, ACCEL, 0.01), ("dt", "(n,)", "()")),
        ((GYRO, ACCEL, DT[:, None]), ("dt", "(4, 1)")),
        ((GYRO, ACCEL, DT[:3]), ("gyro", "(3, 3)", "(4, 3)")),
        ((GYRO.T, ACCEL, DT), ("gyro", "(4, 3)", "(3, 4)")),
        ((GYRO, ACCEL[:3], DT), ("accel", "(3, 3)")),
        ((GYRO[0], ACCEL[0], DT), ("gyro", "(3,)")),
        (("abc", ACCEL, DT), ("gyro", "numbers")),
        ((GYRO, 1j * ACCEL, DT), ("accel", "numbers")),
    ],
)
def test_samples(samples, words):
    motion = bundle.Preintegration(NOISE)
    refused(lambda: motion.integrate(*samples), *words)
    assert motion.duration == 0
    refused(lambda: bundle.propagate(STATE, *samples), *words)


def test_nanoseconds_between_samples():
    motion = bundle.Preintegration(NOISE)
    refused(lambda: motion.integrate(GYRO, ACCEL, 1e9 * DT), "dt", "found 1e+07; nanoseconds?")
    assert motion.duration == 0
    motion.integrate(GYRO, ACCEL, 1000 * DT)  # ten seconds
    assert motion.duration == pytest.approx(40)


def test_midpoint_has_a_sample_at_each_end():
    motion = bundle.Preintegration(NOISE, rule="midpoint")
    refused(lambda: motion.integrate(GYRO, ACCEL, DT), "gyro", "(5, 3)", "(4, 3)")
    motion.integrate(GYRO, ACCEL, DT[:3])
    refused(lambda: motion.append(bundle.Preintegration(NOISE)), "rule")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: bundle.ImuNoise(0, 1, 1, 1), ("gyro_noise_density", "more than 0")),
        (lambda: bundle.ImuNoise(1, -1, 1, 1), ("accel_noise_density",)),
        (lambda: bundle.ImuNoise(1, 1, -1, 1), ("gyro_bias_random_walk", "at least 0")),
        (lambda: bundle.ImuNoise(1, 1, 1, np.nan), ("accel_bias_random_walk",)),
        (lambda: bundle.ImuNoise(1, 1, 1, 1, -1), ("integration_covariance",)),
        (lambda: bundle.ImuNoise("a", 1, 1, 1), ("gyro_noise_density", "'a'")),
        (lambda: NOISE.scaled(0), ("scale", "more than 0")),
        (lambda: bundle.Preintegration((1, 1, 1, 1)), ("noise", "ImuNoise")),
        (lambda: bundle.Preintegration(NOISE, [1, 2]), ("gyro_bias", "(3,)")),
        (lambda: bundle.Preintegration(NOISE, [0, 0, 0], [0, np.inf, 0]), ("accel_bias", "inf")),
        (lambda: bundle.Preintegration(NOISE, rule="euler"), ("rule", "midpoint")),
        (lambda: bundle.Preintegration(NOISE).append(3), ("append", "Preintegration")),
        (lambda: bundle.Preintegration(NOISE).corrected([1], [1]), ("gyro_bias",)),
        (lambda: bundle.Preintegration(NOISE).predict(STATE[:15]), ("state", "(16,)")),
        (lambda: bundle.Preintegration(NOISE).needs_repropagation(1), ("gyro_bias",)),
        (
            lambda: bundle.Preintegration(NOISE).needs_repropagation([0, 0, 0], accel_bias_sigma=0),
            ("accel_bias_sigma",),
        ),
        (lambda: bundle.Preintegration(NOISE).sqrt_information, ("0 samples", "positive")),
        (lambda: bundle.propagate(STATE, GYRO, ACCEL, DT, rule="x"), ("rule",)),
        (lambda: bundle.propagate(STATE, GYRO, ACCEL, DT, gravity=9.81), ("gravity", "(3,)")),
        (lambda: bundle.excitation(ACCEL[:1]), ("accel", "2 or more")),
        (lambda: bundle.excitation(ACCEL.T), ("accel",)),
        (lambda: bundle.excitation(NAN_ROW), ("accel[2]", "nan")),
    ],
)
def test_arguments(make, words):
    refused(make, *words)


def test_factors_refuse_what_does_not_fit():
    motion = bundle.Preintegration(NOISE)
    motion.integrate(GYRO, ACCEL, DT)
    keys = ["x0", "v0", "b0", "x1", "v1"]
    refused(lambda: bundle.ImuFactor("x", "v", "b", "x", "w", motion), "twice")
    refused(lambda: bundle.ImuFactor(*keys, motion, gravity_key="v0"), "twice")
    refused(lambda: bundle.ImuFactor(*keys, "motion"), "motion", "Preintegration")
    refused(lambda: bundle.ImuFactor(*keys, motion, gravity=-9.81), "gravity", "(3,)")
    refused(lambda: bundle.BiasWalkFactor("b", "b", NOISE, 1), "twice")
    refused(lambda: bundle.BiasWalkFactor("a", "b", NOISE, 0), "duration", "more than 0")
    still = bundle.ImuNoise(1, 1, 0, 1)
    refused(lambda: bundle.BiasWalkFactor("a", "b", still, 1), "gyro_bias_random_walk")
    graph = bundle.FactorGraph()
    for key in ("x0", "x1"):
        graph.add_variable(key, STATE[:7], "se3")
    for key in ("v0", "v1"):
        graph.add_variable(key, np.zeros(3))
    graph.add_variable("b0", np.zeros(6))
    graph.add_variable("plane", np.zeros(3), "se2")
    graph.add_factor(bundle.ImuFactor(*keys, motion))
    empty = bundle.Preintegration(NOISE)
    refused(lambda: graph.add_factor(bundle.ImuFactor(*keys, empty)), "0 samples")
    wrong = bundle.ImuFactor("x0", "b0", "v0", "x1", "v1", motion)
    refused(lambda: graph.add_factor(wrong), "ImuFactor")
    turned = bundle.ImuFactor(*keys, motion, gravity_key="plane")
    refused(lambda: graph.add_factor(turned), "ImuFactor")


def test_samples_that_cannot_be_what_they_are_taken_for():
    bundle.check_imu_samples(GYRO, ACCEL, gyro_range=10, accel_range=80)
    bundle.check_imu_samples(GYRO[:0], ACCEL[:0])
    refused(lambda: bundle.check_imu_samples(GYRO, ACCEL / 9.81), "accel", "m/s^2", "g")
    refused(lambda: bundle.check_imu_samples(np.degrees(10 * GYRO), ACCEL), "gyro", "degrees")
    clipped = ACCEL.copy()
    clipped[2, 1] = -39.24
    check = bundle.check_imu_samples
    refused(lambda: check(GYRO, clipped, accel_range=39.24), "accel[2, 1]", "saturated")
    refused(lambda: check(clipped, ACCEL, gyro_range=39.24), "gyro[2, 1]", "saturated")
    refused(lambda: check(GYRO, NAN_ROW), "accel[2]", "nan")
    refused(lambda: check(GYRO[:3], ACCEL), "accel: expected shape (3, 3)")
    refused(lambda: check(GYRO[0], ACCEL), "gyro", "(n, 3)")


def test_excitation_has_three_verdicts():
    rng = np.random.default_rng(0)
    rest = np.tile([3.0, 4.0, 8.0], (100, 1))
    for spread, verdict in ((0.01, "unobservable"), (0.2, "marginal"), (2, "healthy")):
        accel = rest * (1 + spread * rng.choice([-1, 1], (100, 1)) / np.linalg.norm(rest[0]))
        found = bundle.excitation(accel)
        assert found.verdict == verdict
        assert found.spread == pytest.approx(np.linalg.norm(accel, axis=1).std())
        assert found.num_samples == 100
        assert verdict in repr(found)
    assert (HEALTHY, UNOBSERVABLE) == (0.5, 0.05)


def test_noise_is_scaled_where_it_is_noise():
    scaled = NOISE.scaled(10)
    assert scaled.accel_bias_random_walk == pytest.approx(3e-2)
    assert scaled.gyro_noise_density == pytest.approx(1.7e-3)
    assert scaled.integration_covariance == NOISE.integration_covariance
    assert "0.00017" in repr(NOISE)
