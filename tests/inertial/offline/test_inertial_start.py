"""Start of an adjustment with an IMU on an exact path: values, segments, sigmas, prior."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle import InputError
from bundle.inertial.offline import imu_adjustment as adjustment
from bundle.inertial.offline.image_intervals import ImageIntervals, likely_kinds, read_image_times
from bundle.inertial.offline.imu_agreement import MOST, ClockOffset, clock_offset, noise_scale_of
from bundle.inertial.offline.inertial_result import ImuSamples
from bundle.inertial.offline.inertial_start import (
    ACCEL_BIAS_SIGMA,
    POSITION_SIGMA,
    gyro_bias,
    preintegrated,
    segments,
    solve_inertial_start,
)
from bundle.inertial.vio.window_frame import ImuInterval
from bundle.model.sequence.calibration import ImuNoise
from tests.scenes import make_problem

NOISE = ImuNoise(1.7e-4, 2e-3, 2e-5, 3e-3)
BIAS = np.array([0.02, -0.01, 0.03, 0.1, -0.2, 0.15])
SCALE = 2.7


def path(count=25, every=40, dt=0.005, seed=0, bias=BIAS):
    """Images, arms and intervals of a motion that the zero-order hold integrates exactly."""
    rng = np.random.default_rng(seed)
    turn = Rotation.random(random_state=seed)
    position, velocity = np.zeros(3), np.array([0.3, -0.2, 0.1])
    gravity = Rotation.from_rotvec([0.4, 0.2, 0]).apply([0, 0, -9.81])
    rotations, places, velocities, intervals = [turn.as_matrix()], [position], [velocity], []
    for _ in range(count - 1):
        rate = 0.8 * rng.normal(size=3)
        force = turn.inv().apply(-gravity) + 2.0 * rng.normal(size=3)
        for _ in range(every):
            acceleration = turn.apply(force) + gravity
            position = position + velocity * dt + 0.5 * acceleration * dt**2
            velocity = velocity + acceleration * dt
            turn = turn * Rotation.from_rotvec(rate * dt)
        rotations.append(turn.as_matrix())
        places.append(position)
        velocities.append(velocity)
        intervals.append(
            ImuInterval(
                np.tile(rate + bias[:3], (every, 1)), np.tile(force + bias[3:], (every, 1)),
                np.full(every, dt),
            )
        )  # fmt: skip
    rotations = np.array(rotations)
    arms = rotations @ np.array([0.3, -0.1, 0.2])
    centers = (np.array(places) - arms) / SCALE
    return rotations, centers, arms, intervals, gravity, np.array(velocities)


def start_of(given, **changes):
    rotations, centers, arms, intervals, _, _ = given
    centers = changes.get("centers", centers)
    return solve_inertial_start(rotations, centers, arms, intervals, NOISE, 9.81, "zero_order_hold")


def test_an_exact_path_gives_exact_values():
    given = path(bias=np.r_[BIAS[:3], 0, 0, 0])
    found = start_of(given)
    np.testing.assert_allclose(found.gyro_bias, BIAS[:3], atol=1e-9)
    assert found.scale == pytest.approx(SCALE, rel=1e-6)
    np.testing.assert_allclose(found.gravity, given[4], atol=1e-5)
    np.testing.assert_allclose(found.accel_bias, 0, atol=1e-5)
    np.testing.assert_allclose(found.velocities, given[5], atol=1e-5)
    assert found.rms < 1e-7


def test_a_bias_of_the_forces_is_found_under_its_prior():
    """The prior of 0.2 m/s^2 against 0.02 m pulls a bias of 0.27 by a hundredth."""
    given = path()
    found = start_of(given)
    np.testing.assert_allclose(found.accel_bias, BIAS[3:], atol=5e-3)
    assert np.abs(found.accel_bias - BIAS[3:]).max() > 1e-6
    np.testing.assert_allclose(found.velocities, given[5], atol=0.02)
    assert (ACCEL_BIAS_SIGMA, POSITION_SIGMA) == (0.2, 0.02)


def test_errors_of_the_scale_have_its_sigma():
    given = path(bias=np.r_[BIAS[:3], 0, 0, 0])
    errors = []
    for seed in range(60):
        noise = 0.02 / SCALE * np.random.default_rng(seed).normal(size=given[1].shape)
        found = start_of(given, centers=given[1] + noise)
        errors.append((found.scale / SCALE - 1) / found.scale_sigma)
        assert found.rms == pytest.approx(0.017, rel=0.35)
    assert 0.8 < np.std(errors) < 1.5


def test_a_wild_rotation_does_not_move_the_bias():
    rotations, _, _, intervals, _, _ = path()
    between = np.swapaxes(rotations[:-1], 1, 2) @ rotations[1:]
    between[5] = between[5] @ Rotation.from_rotvec([0.5, 0.2, -0.3]).as_matrix()
    found = gyro_bias(between, intervals, NOISE, "zero_order_hold")
    np.testing.assert_allclose(found, BIAS[:3], atol=1e-6)
    motions = preintegrated(intervals, NOISE, BIAS, "zero_order_hold")
    np.testing.assert_allclose(motions[3].gyro_bias, BIAS[:3])


@pytest.mark.parametrize(
    ("times", "ends"),
    [
        (np.arange(5), [(0, 5)]),
        (np.arange(4), [(0, 4)]),
        (np.arange(9), [(0, 5), (4, 9)]),
        (np.arange(11), [(0, 5), (4, 11)]),
        (2.0 * np.arange(9), [(0, 5), (4, 9)]),
        (0.99 * np.arange(9), [(0, 9)]),
        (np.arange(0, 8.1, 0.5), [(0, 9), (8, 17)]),
    ],
)
def test_segments_have_four_seconds_and_five_images(times, ends):
    assert [(part[0], part[-1] + 1) for part in segments(np.asarray(times, float))] == ends


def turning(offset=0.0, count=60, noise=0.0, wild=False, step=0.2):
    """Rotations of images that are late, and motions of w(t) = (sin t, cos 1.7 t, sin 2.3 t)."""
    times = step * np.arange(count)

    def rate(t):
        return np.stack([np.sin(t), np.cos(1.7 * t), np.sin(2.3 * t)], axis=-1)

    def motions_at(shift, bias):
        found = []
        for t in times[:-1] + shift:
            motion = bundle.Preintegration(NOISE, gyro_bias=bias)
            steps = t + step / 50 * (np.arange(50) + 0.5)
            motion.integrate(rate(steps), np.zeros((50, 3)), np.full(50, step / 50))
            found.append(motion)
        return found

    rng = np.random.default_rng(1)
    true = np.array([motion.delta_rotation for motion in motions_at(offset, np.zeros(3))])
    errors = noise * rng.normal(size=(count - 1, 3))
    if wild:
        errors[::9] += 0.3
    between = true @ Rotation.from_rotvec(errors).as_matrix()
    return between, motions_at, lambda shift: rate(times + shift)


def test_clock_offsets_are_exact_without_noise_up_to_a_tenth_of_a_second():
    for offset in (0.0, 0.03, -0.06, 0.098):
        found = clock_offset(*turning(offset))
        assert found.seconds == pytest.approx(offset, abs=1e-6)
    assert clock_offset(*turning(0.102)) == ClockOffset()
    assert MOST == 0.1


def test_wild_rotations_do_not_move_a_clock_offset():
    found = clock_offset(*turning(0.02, wild=True))
    assert found.seconds == pytest.approx(0.02, abs=1e-3)


def test_heavy_tails_let_steps_converge_slowly():
    """Weights follow the residuals: here each step is a third of the last one."""
    between, motions_at, rates_at = turning(0.03)
    errors = 0.01 * np.random.default_rng(5).standard_t(1.2, size=(len(between), 3))
    turned = between @ Rotation.from_rotvec(errors).as_matrix()
    found = clock_offset(turned, motions_at, rates_at)
    assert 0.005 < found.sigma < 0.01
    assert found.seconds == pytest.approx(0.03, abs=2 * found.sigma)


def test_the_sigma_of_a_clock_offset_is_that_of_its_errors():
    errors = []
    for seed in range(30):
        between, motions_at, rates_at = turning(0.01, noise=0.0)
        noise = 2e-3 * np.random.default_rng(seed).normal(size=(len(between), 3))
        noisy = between @ Rotation.from_rotvec(noise).as_matrix()
        found = clock_offset(noisy, motions_at, rates_at)
        errors.append((found.seconds - 0.01) / found.sigma)
    assert 0.8 < np.std(errors) < 1.6


def test_the_derivative_by_the_offset_is_that_of_the_motions():
    """Images a second apart turn by a radian; the sigma follows from numerical derivatives."""
    between, motions_at, rates_at = turning(0.02, noise=1e-4, step=1.0)
    found = clock_offset(between, motions_at, rates_at)
    assert found.seconds == pytest.approx(0.02, abs=1e-3)

    def errors(offset, bias):
        deltas = np.array([one.delta_rotation for one in motions_at(offset, bias)])
        turned = Rotation.from_matrix(np.swapaxes(deltas, 1, 2) @ between)
        return turned.as_rotvec()

    step = 1e-5
    steps = [(0.0, step * axis) for axis in np.eye(3)] + [(step, np.zeros(3))]
    columns = [
        (errors(found.seconds + s, b) - errors(found.seconds - s, -b)) / (2 * step)
        for s, b in steps
    ]
    rows = np.stack(columns, axis=2)
    lengths = np.linalg.norm(errors(found.seconds, np.zeros(3)), axis=1)
    weights = 1 / (1 + (lengths / (2 * np.median(lengths))) ** 2)
    normal = np.einsum("n,nji,njk->ik", weights, rows, rows)
    variance = (weights * lengths**2).sum() / (3 * weights.sum())
    sigma = np.sqrt(variance * np.linalg.inv(normal)[3, 3])
    assert found.sigma == pytest.approx(sigma, rel=0.035)


def test_an_offset_is_clear_from_five_sigmas_on():
    assert [ClockOffset(s, 1e-3).is_clear for s in (4.9e-3, -5.1e-3)] == [False, True]
    assert not ClockOffset().is_clear


def test_the_kind_is_told_from_a_likelihood_of_eight():
    """Squares of offsets in sigmas that differ by 16."""
    one = ClockOffset(0.0, 1.0)
    assert likely_kinds(one, ClockOffset(3.99, 1.0)) == ("instant", "interval")
    assert likely_kinds(one, ClockOffset(4.01, 1.0)) == ("instant",)
    assert likely_kinds(ClockOffset(4.01, 1.0), one) == ("interval",)
    far, clear = ClockOffset(4.0, 1.0), ClockOffset(6.0, 1.0)
    assert likely_kinds(clear, far) == ("interval",)
    assert likely_kinds(clear, ClockOffset(7.0, 1.0)) == ("instant",)


def recording(count=400):
    stamps = 10**18 + 5_000_000 * np.arange(count)
    rates = np.column_stack([1e-9 * (stamps - stamps[0])] * 3)
    return ImuSamples(stamps, rates, np.tile([0, 0, 9.81], (count, 1)) + rates)


def test_images_may_be_at_the_ends_and_an_offset_may_lead_beyond():
    samples = recording()
    stamps = samples.timestamps_ns[[0, 200, 399]]
    video = ImageIntervals(samples, stamps)
    durations = [interval.dt.sum() for interval in video.at(0.0)]
    assert durations == pytest.approx([1.0, 0.995])
    for offset in (0.0999, -0.0999):
        assert [one.dt.sum() for one in video.at(offset)] == pytest.approx([1.0, 0.995])
    before = video.at(-0.05)[0]  # the first sample holds
    np.testing.assert_allclose(before.gyro[0], samples.gyro[0], atol=1e-12)
    for moved, word in ((stamps + 1, "1 image is outside"), (stamps - 1, "1 image is outside")):
        with pytest.raises(InputError, match=word):
            ImageIntervals(samples, moved)
    with pytest.raises(
        InputError, match=r"all images are outside: stamps in another unit\? Multiplied by 1000"
    ):
        ImageIntervals(samples, stamps // 1000)


def test_noise_of_the_imu_by_the_rate_of_images():
    def scale(seconds, given=None):
        return noise_scale_of((1e9 * seconds * np.arange(9)).astype(np.int64), given)

    assert scale(0.25) == pytest.approx(5.0)
    assert scale(1.0) == pytest.approx(10.0)
    assert scale(0.05) == pytest.approx(np.sqrt(5))
    assert scale(0.01) == pytest.approx(1.0)
    assert scale(0.005) == 1.0
    assert scale(1.0, 0.5) == 0.5


def test_at_least_five_images():
    bodies = SimpleNamespace(kind="image", __len__=None)
    for count, is_right in ((4, False), (5, True)):
        bodies = np.zeros(count).view(type("Bodies", (np.ndarray,), {"kind": "image"}))
        if is_right:
            options = adjustment._checked(bodies, bundle.SolveOptions())
            assert (options.backend, options.gauge) == ("ceres", "none")
            assert options.linear_solver_type == "sparse_schur"
        else:
            with pytest.raises(InputError, match="at least 5 images"):
                adjustment._checked(bodies, bundle.SolveOptions())


class Solved(adjustment._Adjusted):
    """Adjustment whose solves only count."""

    def motions(self, case):
        return [case.motion]

    def solved(self, case, motions):  # noqa: ARG002
        return self._replace(results=[*self.results, case.result])


def summary_of(*, usable=True, interrupted=False):
    return SimpleNamespace(
        summary=SimpleNamespace(final_cost=3.0, is_solution_usable=usable, interrupted=interrupted)
    )


@pytest.mark.parametrize(
    ("moves", "result", "count"),
    [
        (True, summary_of(), 3),
        (False, summary_of(), 1),
        (True, summary_of(usable=False), 1),
        (True, summary_of(interrupted=True), 1),
    ],
)
def test_solves_follow_until_the_biases_stay(moves, result, count):
    motion = SimpleNamespace(needs_repropagation=lambda _: moves)
    state = SimpleNamespace(biases=np.zeros((2, 6)))
    found = Solved(None, None, None, None, state, [])
    settled = found.settled(SimpleNamespace(motion=motion, result=result))
    assert len(settled.results) == count
    assert settled.cost == (3.0 if result.summary.is_solution_usable else np.inf)


def test_lines_of_times(tmp_path):
    problem = make_problem(num_images=2)
    path = tmp_path / "times.txt"
    first, second = problem.image_names

    def times(*lines):
        path.write_text("\n".join(lines))
        return read_image_times(path, problem).tolist()

    big = 2**63 - 1
    assert times("# a comment", "name,time", f"{first},-5", "", f"{second}\t{big}") == [-5, big]
    assert times(f'"{first}" 7', f"other name {8}", f"{second} 9") == [7, 9]
    for lines, word in (
        ((f"{first} 1", "name time", f"{second} 3"), "line 2: expected the name"),
        ((f"{first} 1", f"{second} {2**63}"), "line 2: expected the name"),
        ((f"{first} 1", f"{first} 3"), "again"),
        ((f"{first} 1.5", f"{second} 3"), "line 1"),
        (("# only",), "found 0"),
        ((f"{first} 1",), "1 image such as"),
        ((f"{first} 5", f"{second} 4"), "at least 5 ns, the time in line 1"),
    ):
        with pytest.raises(InputError, match=word):
            times(*lines)
