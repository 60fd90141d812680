"""Agreement of images and IMU: chi2 and its bounds, clocks of single images, noise of samples."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from bundle.base.tails import chi2_bound
from bundle.inertial.offline.imu_agreement import (
    Agreement,
    ClockErrors,
    cauchy_cost,
    noise_ratios,
    quietest_ratio,
)
from bundle.model.residuals import residuals
from bundle.model.sequence.calibration import ImuNoise
from tests.scenes import make_problem


def costs_of(intervals):
    """Costs of factors, of which half an interval's chi2 is its motion's, the rest its walks'."""
    half = np.asarray(intervals, float) / 2
    return np.r_[half / 2, half / 4, 1e3, half / 4, 1e3]


def agreement(intervals, chi2_=0.0, alone=(0.0, 1.0), scale=1.0):
    cost = chi2_ / 2 + alone[0]
    return Agreement.of(costs_of(intervals), len(intervals), cost, alone, scale)


@pytest.mark.parametrize("degrees", [1, 6, 15, 900])
def test_the_bound_is_the_quantile(degrees):
    for probability in (1e-3, 1e-5):
        exact = chi2.isf(probability, degrees)
        assert chi2_bound(degrees, probability) == pytest.approx(exact, rel=0.03)


def test_an_interval_has_its_motion_and_its_random_walks():
    values = np.arange(1.0, 8)
    found = agreement(values)
    np.testing.assert_allclose(found.interval_chi2, values)
    assert found.freedom == 42


def test_the_whole_is_contradicted_beyond_its_bound():
    bound = chi2.isf(1e-3, 600)
    quiet = np.full(100, 5.0)
    assert not agreement(quiet, 0.99 * bound).is_contradicted
    found = agreement(quiet, 1.01 * bound)
    assert found.is_contradicted
    assert found.chi2 == pytest.approx(1.01 * bound)
    assert found.bound == pytest.approx(bound, rel=0.01)
    # outliers of a quadratic loss, a variance below 1
    assert agreement(quiet, 3.9 * bound, (7.0, 4.0)).chi2 == pytest.approx(3.9 * bound / 4)
    small = agreement(quiet, 1.01 * bound, (7.0, 0.1))
    assert small.is_contradicted
    assert small.chi2 == pytest.approx(1.01 * bound)


def test_the_cost_under_the_cauchy_loss_has_all_observations():
    """Those behind a camera count as 100 px."""
    problem = make_problem()
    points, image = np.array(problem.points), problem.observation_image
    camera = problem.cam_from_world[image[problem.observation_point == 0][0]]
    points[0] = Rotation.from_quat(camera[:4]).inv().apply(-camera[4:] - [0.0, 0.0, 1.0])
    sigma = np.linspace(0.5, 2, problem.num_observations)
    problem = problem.replace(points=points, observation_sigma=sigma)
    pose = problem.cam_from_world[image]
    depth = Rotation.from_quat(pose[:, :4]).apply(points[problem.observation_point])[:, 2]
    behind = depth + pose[:, 6] < 0
    errors = np.where(behind, 100.0, np.linalg.norm(residuals(problem).xy, axis=1)) / sigma
    assert behind.any() and not behind.all()
    assert cauchy_cost(problem, 2.0) == pytest.approx((4 * np.log1p(errors**2 / 4)).sum() / 2)


@pytest.mark.parametrize(("median", "scale", "variance"), [
    (chi2.median(6), 1.0, 1.0), (10 * chi2.median(6), 5.0, 1.0), (chi2.median(6) / 4, 5.0, 0.25),
    (chi2.median(6) / 100, 5.0, 0.04), (chi2.median(6) / 100, 0.5, 1.0),
])  # fmt: skip
def test_the_variance_factor_is_that_of_the_median(median, scale, variance):
    assert agreement(np.full(9, median), scale=scale).variance == pytest.approx(variance, rel=1e-6)


def test_wrong_intervals_are_beyond_the_quantile_of_the_largest():
    for scale, factor in ((1.0, 1.0), (5.0, 0.25)):
        values = np.full(50, factor * chi2.median(6))
        bound = factor * chi2.isf(1e-3 / 50, 15)
        values[[3, 8, 20]] = 0.97 * bound, 1.03 * bound, 2 * bound
        assert agreement(values, scale=scale).wrong_intervals == [20, 8]


def rotations(count=150, seed=1):
    rng = np.random.default_rng(seed)
    rates = rng.normal(size=(count, 3))
    deltas = Rotation.from_rotvec(0.1 * rng.normal(size=(count - 1, 3))).as_matrix()
    return rates, deltas, 0.2 * np.arange(count)


def errors_of(shifts, rates, deltas):
    moved = rates * shifts[:, None]
    return moved[1:] - np.einsum("nji,nj->ni", deltas, moved[:-1])


def test_a_drift_of_clocks_is_found_with_its_sigma():
    rates, deltas, times = rotations()
    found = ClockErrors.of(errors_of(1e-3 * (times - 9), rates, deltas), rates, deltas, times)
    assert abs(found.drift - 1e-3) < 2e-4  # the offset is not a drift
    centred = 1e-3 * (times - times.mean())
    exact = ClockErrors.of(errors_of(centred, rates, deltas), rates, deltas, times)
    assert exact.drift == pytest.approx(1e-3)
    assert exact.drift_sigma < 1e-12
    z = []
    for seed in range(40):
        noise = 1e-3 * np.random.default_rng(seed).normal(size=(149, 3))
        one = ClockErrors.of(noise, rates, deltas, times)
        z.append(one.drift / one.drift_sigma)
        assert one.share < 0.5 and one.jitter < 1e-3
    assert 0.75 < np.std(z) < 1.3


def test_jitter_of_times_is_found_beside_noise():
    rates, deltas, times = rotations()
    rng = np.random.default_rng(3)
    shifts = 5e-3 * rng.normal(size=len(times))
    errors = errors_of(shifts, rates, deltas)
    found = ClockErrors.of(errors, rates, deltas, times)
    assert found.jitter == pytest.approx(5e-3, rel=0.2)
    assert found.share > 0.9
    noisy = errors + 0.02 * rng.normal(size=errors.shape)
    found = ClockErrors.of(noisy, rates, deltas, times)
    assert found.jitter == pytest.approx(5e-3, rel=0.5)
    assert found.share < 0.3
    assert ClockErrors.of(0 * errors, rates, deltas, times) == ClockErrors()
    assert ClockErrors.of(errors, 0 * rates, deltas, times) == ClockErrors()


@pytest.mark.parametrize(("size", "least"), [(0.0, 0.0), (5e-3, 4e-3)])
def test_wrong_poses_of_single_images_are_no_jitter(size, least):
    rates, deltas, times = rotations()
    rng = np.random.default_rng(3)
    errors = errors_of(size * rng.normal(size=len(times)), rates, deltas)
    errors += 1e-3 * rng.normal(size=errors.shape)
    expected = ClockErrors.of(errors, rates, deltas, times)
    shifts = np.zeros(len(times))
    shifts[[20, 90]] = 0.1  # as if their times were wrong
    found = ClockErrors.of(errors + errors_of(shifts, rates, deltas), rates, deltas, times)
    assert (found.share > 0.5) == (expected.share > 0.5) == (size > 0)
    assert least <= found.jitter < max(1.5 * expected.jitter, 1.5e-3)


def test_noise_of_samples():
    rng = np.random.default_rng(0)
    stamps = 5_000_000 * np.arange(4000)
    slow = np.sin(stamps * 1e-9)[:, None]
    density = np.array([1.7e-4, 2e-3])
    gyro, accel = (
        slow + one / np.sqrt(0.005) * rng.normal(size=(4000, 3)) for one in density.tolist()
    )
    noise = ImuNoise(3 * density[0], density[1] / 2, 1e-5, 1e-3)
    ratios = noise_ratios(stamps, gyro, accel, noise)
    assert ratios == pytest.approx((3, 0.5), rel=0.05)
    quiet = gyro.copy(), accel.copy()
    for values in quiet:  # a fifth is quiet
        values[800:] += 9 * (values[800:] - slow[800:])
    assert quietest_ratio(stamps, *quiet, noise) == pytest.approx(2, rel=0.1)
    still = np.zeros((4000, 3))
    assert noise_ratios(stamps, still, still, noise) == (0.0, 0.0)
