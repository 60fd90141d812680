"""Preintegrated motions against reference intervals, toys, dense matrices, GTSAM, Monte Carlo."""

import bz2
import copy
import json
import pickle
from pathlib import Path

import gtsam
import numpy as np
import pytest

import bundle
from tests.inertial.preintegration import recursion

# On EuRoC V1_02, by the recursion on the manifold: 12 decimals, covariances 12 digits.
INTERVALS = json.loads(Path(__file__).with_name("intervals.json").read_text())
NOISE = bundle.ImuNoise(1.6968e-4, 2.0e-3, 1.9393e-5, 3.0e-3)
ZEROS = np.zeros(3)
DELTAS = ("delta_rotation", "delta_position", "delta_velocity")
BY_BIAS = {
    "d_rotation_d_gyro_bias": (0, 0),
    "d_position_d_gyro_bias": (3, 0),
    "d_velocity_d_gyro_bias": (6, 0),
    "d_position_d_accel_bias": (3, 3),
    "d_velocity_d_accel_bias": (6, 3),
}


@pytest.fixture(scope="module")
def euroc(bundle_data):
    path = bundle_data / "imu" / "euroc_V1_02" / "imu0_data.csv.bz2"
    lines = bz2.decompress(path.read_bytes()).decode().splitlines()
    rows = np.array([line.split(",") for line in lines if line[0] != "#"])
    return rows[:, 0].astype(np.int64), rows[:, 1:4].astype(float), rows[:, 4:7].astype(float)


def motion_of(euroc, name):
    times, gyro, accel = euroc
    interval = INTERVALS[name]
    rows = slice(*interval["rows"])
    motion = bundle.Preintegration(NOISE, interval["gyro_bias"], interval["accel_bias"])
    motion.integrate(gyro[rows], accel[rows], np.diff(times)[rows] * 1e-9)
    return motion


def random_samples(seed, count, rate=2.0, midpoint=False):
    rng = np.random.default_rng(seed)
    rows = count + midpoint
    gyro = rate * rng.standard_normal((rows, 3))
    accel = [0, 0, 9.81] + 3 * rng.standard_normal((rows, 3))
    return gyro, accel, rng.choice([0.004, 0.005, 0.0125], count)


def integrated(gyro, accel, dt, gyro_bias=ZEROS, accel_bias=ZEROS, noise=NOISE, rule=None):
    motion = bundle.Preintegration(noise, gyro_bias, accel_bias, rule=rule or "zero_order_hold")
    motion.integrate(gyro, accel, dt)
    return motion


@pytest.mark.parametrize("name", INTERVALS)
def test_reference_intervals(euroc, name):
    motion, interval = motion_of(euroc, name), INTERVALS[name]
    for part in (*DELTAS, *BY_BIAS):
        assert np.abs(getattr(motion, part) - interval[part]).max() < 1e-10, part
    expected = np.zeros((9, 9))
    expected[np.triu_indices(9)] = interval["covariance"]
    expected = np.triu(expected) + np.triu(expected, 1).T
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert (np.abs(motion.covariance - expected) / scale).max() < 1e-10
    assert np.trace(motion.covariance) == pytest.approx(interval["trace"], rel=1e-12)
    assert np.linalg.slogdet(motion.covariance)[1] == pytest.approx(interval["logdet"], rel=1e-10)


@pytest.mark.parametrize("name", INTERVALS)
def test_first_order_correction_errs_by_a_hundred_per_decade(euroc, name):
    motion, interval = motion_of(euroc, name), INTERVALS[name]
    errors = []
    for step, expected in zip((1e-4, 1e-3, 1e-2), interval["first_order"], strict=True):
        bias = motion.gyro_bias + step * np.eye(3)[0]
        exact = motion.repropagated(bias, motion.accel_bias)
        rotation, _, _ = motion.corrected(bias, motion.accel_bias)
        error = np.linalg.norm(recursion.log(rotation.T @ exact.delta_rotation))
        assert error == pytest.approx(expected, rel=1e-3)
        errors.append(error)
    slopes = np.divide(errors[1:], errors[:-1])
    assert slopes == pytest.approx(100, rel=0.01)  # 10 if J_R is missing


def test_toy_on_a_line():
    accel = np.zeros((4, 3))
    accel[:, 0] = 1, 1.2, 0.8, 1
    motion = integrated(np.zeros((4, 3)), accel, np.full(4, 0.01), accel_bias=[0.1, 0, 0])
    exact = {"rel": 1e-14, "abs": 1e-17}
    assert motion.delta_velocity == pytest.approx([0.036, 0, 0], **exact)
    assert motion.delta_position == pytest.approx([0.000740, 0, 0], **exact)
    for start, speed, end in ((5, 2, 5.08074), (9, -1, 8.96074)):
        state = [0, 0, 0, 1, start, 0, 0, speed, 0, 0, *ZEROS, 0.1, 0, 0]
        assert motion.predict(state, ZEROS)[4:7] == pytest.approx([end, 0, 0], **exact)
    assert motion.d_velocity_d_accel_bias == pytest.approx(-0.04 * np.eye(3), **exact)
    assert motion.d_position_d_accel_bias == pytest.approx(-0.0008 * np.eye(3), **exact)
    _, velocity, position = motion.corrected(ZEROS, [0.12, 0, 0])
    assert velocity == pytest.approx([0.0352, 0, 0], **exact)
    assert position == pytest.approx([0.000724, 0, 0], **exact)


def test_toy_of_two_turns():
    motion = integrated(np.tile([0, 0, 2.0], (2, 1)), np.zeros((2, 3)), [0.01, 0.01])
    expected = [[-0.019994667, -0.000399947, 0], [0.000399947, -0.019994667, 0], [0, 0, -0.02]]
    assert motion.d_rotation_d_gyro_bias == pytest.approx(np.array(expected), abs=5e-10)
    for change, expected_error in ((0.02, 5.3329e-10), (0.2, 5.3329e-8)):
        bias = [change, 0, 0]
        rotation, _, _ = motion.corrected(bias, ZEROS)
        again = motion.repropagated(bias, ZEROS).delta_rotation
        error = np.linalg.norm(recursion.log(rotation.T @ again))
        assert error == pytest.approx(expected_error, rel=1e-4)


@pytest.mark.parametrize("rule", ["zero_order_hold", "midpoint"])
def test_dense_matrices_say_the_same(rule):
    midpoint = rule == "midpoint"
    gyro, accel, dt = random_samples(1, 60, midpoint=midpoint)
    biases = np.array([0.3, -0.2, 0.1]), np.array([0.2, 0.5, -0.4])
    motion = integrated(gyro, accel, dt, *biases, rule=rule)
    oracle = recursion.integrate(NOISE, gyro, accel, dt, *biases, midpoint=midpoint)
    for part, value in zip(
        DELTAS, (oracle.rotation, oracle.position, oracle.velocity), strict=True
    ):
        assert np.abs(getattr(motion, part) - value).max() < 1e-13, part
    for part, (row, column) in BY_BIAS.items():
        expected = oracle.by_bias[row : row + 3, column : column + 3]
        assert np.abs(getattr(motion, part) - expected).max() < 1e-13, part
    sigmas = np.sqrt(np.diag(oracle.covariance))
    scale = np.outer(sigmas, sigmas)
    combined = motion.combined_covariance
    assert (np.abs(combined - oracle.covariance) / scale).max() < 1e-12
    without = bundle.ImuNoise(1.6968e-4, 2.0e-3, 0, 0)
    still = recursion.integrate(without, gyro, accel, dt, *biases, midpoint=midpoint)
    nine = still.covariance[:9, :9]
    assert (np.abs(motion.covariance - nine) / scale[:9, :9]).max() < 1e-12
    whitened = motion.sqrt_information @ nine @ motion.sqrt_information.T
    assert whitened == pytest.approx(np.eye(9), abs=1e-8)
    assert (np.tril(motion.sqrt_information, -1) == 0).all()


def test_midpoint_needs_fewer_samples_than_zero_order_hold():
    """An accelerating rotation, integrated finely: errors of second and of first order."""

    def motion(count, rule):
        t = np.linspace(0, 1, count + 1)
        gyro = np.c_[2 * t, np.zeros_like(t), t]
        accel = np.c_[np.sin(3 * t), np.cos(2 * t), 9.81 + t]
        last = None if rule == "midpoint" else -1
        made = integrated(gyro[:last], accel[:last], np.diff(t), rule=rule)
        return np.r_[recursion.log(made.delta_rotation), made.delta_position, made.delta_velocity]

    exact = motion(4096, "midpoint")
    for rule, factor in (("zero_order_hold", 2), ("midpoint", 4)):
        coarse, fine = (np.linalg.norm(motion(n, rule) - exact) for n in (32, 64))
        assert coarse / fine == pytest.approx(factor, rel=0.06)


@pytest.mark.parametrize("rule", ["zero_order_hold", "midpoint"])
def test_propagation_and_prediction_are_the_same_steps(rule):
    gyro, accel, dt = random_samples(2, 40, midpoint=rule == "midpoint")
    rng = np.random.default_rng(3)
    state = rng.standard_normal(16)
    state[:4] /= np.linalg.norm(state[:4])
    gravity = rng.standard_normal(3)
    motion = integrated(gyro, accel, dt, state[10:13], state[13:], rule=rule)
    states = bundle.propagate(state, gyro, accel, dt, gravity=gravity, rule=rule)
    assert states.shape == (40, 16)
    predicted = motion.predict(state, gravity)
    assert np.abs(states[-1, 4:] - predicted[4:]).max() < 1e-13
    assert abs(abs(states[-1, :4] @ predicted[:4]) - 1) < 1e-14
    half = bundle.propagate(states[19], gyro[20:], accel[20:], dt[20:], gravity=gravity, rule=rule)
    assert half == pytest.approx(states[20:], abs=1e-14)


def test_gtsam_on_the_manifold_says_the_same():
    gyro, accel, dt = random_samples(4, 100, rate=1.0)
    gyro_bias, accel_bias = np.array([0.02, -0.01, 0.03]), np.array([0.1, 0.2, -0.1])
    params = gtsam.PreintegrationParams.MakeSharedU(9.81)
    params.setAccelerometerCovariance(np.eye(3) * NOISE.accel_noise_density**2)
    params.setGyroscopeCovariance(np.eye(3) * NOISE.gyro_noise_density**2)
    params.setIntegrationCovariance(np.eye(3) * NOISE.integration_covariance)
    theirs = gtsam.PreintegratedImuMeasurementsManifold(
        params, gtsam.imuBias.ConstantBias(accel_bias, gyro_bias)
    )
    for w, a, step in zip(gyro, accel, dt, strict=True):
        theirs.integrateMeasurement(a, w, step)
    ours = integrated(gyro, accel, dt, gyro_bias, accel_bias)
    assert np.abs(ours.delta_rotation - theirs.deltaRij().matrix()).max() < 1e-13
    assert np.abs(ours.delta_velocity - theirs.deltaVij()).max() < 1e-12
    assert np.abs(ours.delta_position - theirs.deltaPij()).max() < 1e-12
    # Theirs is of errors in the frame at the end.
    to_end = np.eye(9)
    to_end[3:6, 3:6] = to_end[6:9, 6:9] = ours.delta_rotation.T
    expected = theirs.preintMeasCov()
    error = np.linalg.norm(to_end @ ours.covariance @ to_end.T - expected)
    assert error < 1e-3 * np.linalg.norm(expected)


def test_gtsams_combined_covariance_has_the_same_structure():
    """Over a short interval, where its tangent space and ours differ by little."""
    gyro, accel, dt = random_samples(5, 20, rate=0.05)
    params = gtsam.PreintegrationCombinedParams.MakeSharedU(9.81)
    params.setAccelerometerCovariance(np.eye(3) * NOISE.accel_noise_density**2)
    params.setGyroscopeCovariance(np.eye(3) * NOISE.gyro_noise_density**2)
    params.setIntegrationCovariance(np.eye(3) * NOISE.integration_covariance)
    params.setBiasAccCovariance(np.eye(3) * NOISE.accel_bias_random_walk**2)
    params.setBiasOmegaCovariance(np.eye(3) * NOISE.gyro_bias_random_walk**2)
    theirs = gtsam.PreintegratedCombinedMeasurements(
        params, gtsam.imuBias.ConstantBias(ZEROS, ZEROS)
    )
    for w, a, step in zip(gyro, accel, dt, strict=True):
        theirs.integrateMeasurement(a, w, step)
    ours = integrated(gyro, accel, dt).combined_covariance
    order = [*range(9), 12, 13, 14, 9, 10, 11]
    signs = np.r_[np.ones(9), -np.ones(6)]  # of b_i - b_j
    ours = (ours * np.outer(signs, signs))[np.ix_(order, order)]
    expected = theirs.preintMeasCov()
    sigmas = np.sqrt(np.diag(expected))
    assert (np.abs(ours - expected) / np.outer(sigmas, sigmas)).max() < 5e-3


def test_covariance_is_that_of_noisy_samples():
    """Monte Carlo with walking biases: whitened errors have the identity for covariance."""
    noise = bundle.ImuNoise(3e-3, 2e-2, 3e-2, 2e-1, 1e-12)
    count, runs, dt = 25, 1500, 0.01
    gyro, accel, _ = random_samples(6, count)
    rng = np.random.default_rng(7)
    truth = integrated(gyro, accel, np.full(count, dt))
    draws = rng.standard_normal((4, runs, count, 3))
    walks = [
        density * np.sqrt(dt) * np.cumsum(draw, axis=1)
        for density, draw in (
            (noise.gyro_bias_random_walk, draws[0]),
            (noise.accel_bias_random_walk, draws[1]),
        )
    ]
    white = [
        density / np.sqrt(dt) * draw
        for density, draw in (
            (noise.gyro_noise_density, draws[2]),
            (noise.accel_noise_density, draws[3]),
        )
    ]
    errors = []
    for run in range(runs):  # the bias of a sample is the walk's before it
        bias = [np.vstack([ZEROS, walk[run, :-1]]) for walk in walks]
        motion = integrated(
            gyro + white[0][run] + bias[0],
            accel + white[1][run] + bias[1],
            np.full(count, dt),
            noise=noise,
        )
        errors.append(
            [
                *recursion.log(motion.delta_rotation.T @ truth.delta_rotation),
                *(truth.delta_position - motion.delta_position),
                *(truth.delta_velocity - motion.delta_velocity),
                *walks[0][run, -1],
                *walks[1][run, -1],
            ]
        )
    combined = integrated(gyro, accel, np.full(count, dt), noise=noise).combined_covariance
    # Velocity and position are nearly one error each over a constant force: solve, do not divide.
    root = np.linalg.cholesky(combined)
    whitened = np.linalg.solve(root, np.array(errors).T)
    sample = np.cov(whitened)
    assert np.abs(sample - np.eye(15)).max() < 0.15  # 1500 runs: sigma .037 on the diagonal
    assert np.square(whitened).sum(axis=0).mean() == pytest.approx(15, abs=0.6)


@pytest.mark.parametrize(
    "copied", [copy.copy, copy.deepcopy, lambda m: pickle.loads(pickle.dumps(m))]
)
def test_copies_have_their_own_samples(copied):
    gyro, accel, dt = random_samples(8, 10, midpoint=True)
    motion = integrated(gyro, accel, dt, [0.1, 0, 0], [0, 0.2, 0], rule="midpoint")
    twin = copied(motion)
    assert repr(twin) == repr(motion)
    assert twin.noise == motion.noise
    assert (twin.covariance == motion.covariance).all()
    assert (twin.accel_bias == motion.accel_bias).all()
    twin.append(motion)
    assert len(twin.samples) == 20
    assert len(motion.samples) == 10
    twin.append(twin)
    assert len(twin.samples) == 40
    assert twin.duration == pytest.approx(4 * motion.duration)


def test_samples_are_integrated_in_any_portions():
    gyro, accel, dt = random_samples(9, 30)
    whole = integrated(gyro, accel, dt)
    parts = bundle.Preintegration(NOISE)
    for start, stop in ((0, 1), (1, 1), (1, 20), (20, 30)):
        parts.integrate(
            gyro[start:stop].astype(np.longdouble),
            np.asfortranarray(accel[start:stop]),
            dt[start:stop],
        )
    assert (parts.covariance == whole.covariance).all()
    assert (parts.delta_position == whole.delta_position).all()
    halves = [integrated(gyro[s], accel[s], dt[s]) for s in (slice(0, 12), slice(12, 30))]
    halves[0].append(halves[1])
    assert (halves[0].covariance == whole.covariance).all()
