"""Error of the arm by the path: true poses, both bounds, and simulated noise."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.inertial.offline.image_intervals import ImageIntervals
from bundle.inertial.offline.inertial_result import ImuSamples
from bundle.inertial.offline.inertial_start import preintegrated
from bundle.inertial.offline.path_tests import POSITION_SIGMA, ArmError, _covariance, arm_error
from bundle.inertial.vio.trajectory_comparison import states_at
from bundle.model.sequence.calibration import ImuNoise


@pytest.fixture(scope="module")
def flight():
    return bundle.synthesize_flight(motion="room", duration=16.0, num_tracks=20, seed=4)


def found(flight, shift, noise=0.0, turn=True, forces=1.0, seed=0):
    """The error of an arm that is wrong by -shift, from true poses with white noise."""
    sequence, truth = flight.sequence, flight.ground_truth
    stamps = truth.timestamps_ns[20:-4:4]
    states = states_at(truth, stamps)
    imu = Rotation.from_quat(states[:, :4])
    arm = np.array(sequence.calibration.camera_from_imu)
    camera = imu * Rotation.from_quat(arm[:4]).inv()
    centers = states[:, 4:7] - camera.apply(arm[4:])
    centers += noise * np.random.default_rng(seed).normal(size=centers.shape)
    samples = ImuSamples(sequence.imu_timestamps_ns, sequence.gyro, forces * sequence.accel)
    axes = camera.as_matrix() if turn else np.tile(np.eye(3), (len(stamps), 1, 1))
    wrong = arm[4:] - np.asarray(shift)
    noise, bias = sequence.calibration.noise, np.append(states[:, 10:13].mean(axis=0), np.zeros(3))
    motions = preintegrated(ImageIntervals(samples, stamps).at(0.0), noise, bias, "midpoint")
    return arm_error(
        imu.as_matrix(), centers / 3.7, np.einsum("nij,j->ni", axes, wrong), axes, motions, noise
    )


@pytest.mark.parametrize("shift", [(0.1, 0, 0), (0, -0.03, 0.05), (0, 0, -0.4)])
def test_a_wrong_arm_is_found_along_the_axes_of_the_body(flight, shift):
    one = found(flight, shift, 1e-3)
    assert one.is_wrong
    np.testing.assert_allclose(one.shift, shift, atol=4 * np.sqrt(np.diag(one.covariance).max()))
    assert one.size[1] < 0.006
    assert one.size[0] == pytest.approx(np.linalg.norm(shift), abs=0.02)


def test_a_right_arm_and_noise_are_silent(flight):
    for noise in (0.0, 1e-3, 0.02):
        one = found(flight, (0, 0, 0), noise)
        assert not one.is_wrong
        assert one.chi2 < 16
    assert found(flight, (0, 0, 0), 0.02).size[1] > 3 * found(flight, (0, 0, 0), 1e-3).size[1]


def test_chi2_of_right_arms_is_that_of_three_numbers(flight):
    found_chi2 = [found(flight, (0, 0, 0), 0.02, seed=k).chi2 for k in range(16)]
    assert 2 < np.mean(found_chi2) < 4.5


def test_a_path_that_does_not_turn_determines_no_arm(flight):
    one = found(flight, (0, 0, 0), 1e-3, turn=False)
    assert np.diag(one.covariance).min() > 1


@pytest.mark.parametrize("forces", [0.9, 1.1])
def test_a_scale_of_the_forces_is_no_error_of_the_arm(flight, forces):
    assert not found(flight, (0, 0, 0), 1e-3, forces=forces).is_wrong


def test_both_bounds_of_a_clear_error():
    for size, sigma, is_clear in (
        (0.021, 0.003, True), (0.019, 0.001, False),
        (0.1, 0.1 / 6.7, True), (0.1, 0.1 / 6.5, False),
    ):  # fmt: skip
        one = ArmError(np.array([0, size, 0]), sigma**2 * np.eye(3))
        assert one.is_wrong == is_clear
        assert one.size == pytest.approx((size, sigma))
    assert not ArmError().is_wrong


def test_the_covariance_is_that_of_integrated_noise():
    rng = np.random.default_rng(1)
    noise, step, runs = ImuNoise(1e-4, 0.01, 1e-5, 0.02), 0.01, 4000
    steps = 300
    walk = np.cumsum(0.02 * np.sqrt(step) * rng.normal(size=(runs, steps)), axis=1)
    for factor, force in ((0, 0.01 / np.sqrt(step) * rng.normal(size=(runs, steps))), (1, walk)):
        places = np.cumsum(np.cumsum(force, axis=1), axis=1)[:, 99::100] * step**2
        times = np.array([1.0, 2.0, 3.0])
        only = ImuNoise(1e-4, (0.01, 1e-9)[factor], 1e-5, (1e-9, 0.02)[factor])
        exact = _covariance(times, only) - POSITION_SIGMA**2 * np.eye(3)
        simulated = np.cov(places.T)
        np.testing.assert_allclose(simulated, exact, rtol=0.1)
        whole = _covariance(times, noise)
        assert (whole > exact).all()
    np.testing.assert_allclose(_covariance(np.zeros(1), noise), [[POSITION_SIGMA**2]])
