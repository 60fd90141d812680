"""The offset between the clocks of images and IMU, and samples that are means of intervals."""

import dataclasses
import functools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.inertial.offline import imu_adjustment
from bundle.inertial.offline.image_intervals import ImageIntervals, likely_kinds
from bundle.inertial.offline.imu_agreement import ClockOffset
from tests.inertial.offline.models import model_of, world_from_imu
from tests.inertial.offline.test_imu_adjustment import adjusted, error_of, samples_of


@functools.cache
def made(kind="instant", seed=3, step=4, **changes):
    flight = bundle.synthesize_flight(
        duration=8.0, num_tracks=60, seed=seed, imu_samples=kind, **changes
    )
    problem, stamps = model_of(flight.sequence, flight.ground_truth, step, noise=0.1)
    inner = np.flatnonzero((stamps > stamps[0] + 50_000_000) & (stamps < stamps[-1] - 50_000_000))
    return flight, problem, stamps, inner


def offset_of(flight, problem, stamps, inner, late_ns=0):
    calibration = flight.sequence.calibration
    turned = Rotation.from_quat(world_from_imu(problem, calibration.camera_from_imu)[:, :4])
    video = ImageIntervals(samples_of(flight.sequence), stamps[inner] + late_ns)
    return video.offset(between(turned[inner]), calibration.noise)


def between(turns):
    return (turns[:-1].inv() * turns[1:]).as_matrix()


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("late", [-0.03, -0.004, 0.0, 0.004, 0.03])
def test_an_offset_is_found_within_its_sigma(seed, late):
    found = offset_of(*made(seed=seed), round(1e9 * late))
    assert abs(found.seconds + late) < 4 * found.sigma
    assert found.sigma < 0.004


@pytest.mark.parametrize("late", [-2.5, -0.12, -0.09, 0.0, 1.5])
def test_an_offset_beyond_the_range_is_named(late):
    flight, problem, stamps, inner = made()
    given = flight.sequence.calibration.camera_from_imu
    turned = Rotation.from_quat(world_from_imu(problem, given)[:, :4])[inner]
    rows = np.flatnonzero(np.abs(stamps[inner] - stamps.mean() + 1e9 * late) < 3.9e9)
    shifted, samples = stamps[inner][rows] + round(1e9 * late), samples_of(flight.sequence)
    samples = samples._replace(gyro=samples.gyro + np.array([0.0, 0.3, 0.0]))
    words = ImageIntervals(samples, shifted).far_offset(between(turned[rows]))
    is_far = abs(late) > 0.1
    assert (f"differ by {-late:.2f} s: add it" if is_far else "") in words
    assert bool(words) == is_far
    order = np.random.default_rng(0).permutation(len(rows) - 1)  # no offset explains these
    for unlike in (between(turned[rows])[order], np.tile(np.eye(3), (len(order), 1, 1))):
        assert ImageIntervals(samples, shifted).far_offset(unlike) == ""


def test_a_far_offset_needs_half_of_the_images_within_the_samples():
    flight, problem, stamps, _ = made()
    given = flight.sequence.calibration.camera_from_imu
    turned = Rotation.from_quat(world_from_imu(problem, given)[:, :4])
    since = stamps - stamps[0]
    rows = np.flatnonzero((since > 2.5e9) & (since < 5.5e9))
    samples = samples_of(flight.sequence)
    for end, is_named in ((3.5, False), (5.0, True)):
        part = type(samples)(*(one[: int(200 * end)] for one in samples))
        words = ImageIntervals(part, stamps[rows] - 2_200_000_000).far_offset(between(turned[rows]))
        assert bool(words) == is_named


def test_means_of_intervals_are_late_by_half_of_one():
    step = made()[0].sequence.imu_timestamps_ns
    half = 0.5e-9 * np.median(np.diff(step))
    found = [offset_of(*made("interval", seed)) for seed in range(6)]
    values = np.array([one.seconds for one in found])
    weights = np.array([one.sigma for one in found]) ** -2
    assert values @ weights / weights.sum() == pytest.approx(-half, rel=0.3)


def test_a_constant_rate_does_not_determine_the_offset():
    flight, _, stamps, inner = made()
    rows = len(flight.sequence.gyro)
    steady = dataclasses.replace(flight.sequence, gyro=np.tile([0.1, 0.2, -0.3], (rows, 1)))
    turned = Rotation.from_rotvec(1e-9 * np.outer(stamps - stamps[0], [0.1, 0.2, -0.3]))
    noise = 1e-4 * np.random.default_rng(0).normal(size=(len(stamps), 3))
    noisy = turned * Rotation.from_rotvec(noise)
    video = ImageIntervals(samples_of(steady), stamps[inner])
    found = video.offset(between(noisy[inner]), flight.sequence.calibration.noise)
    assert not found.is_clear


@pytest.mark.parametrize(
    ("instant", "interval", "expected"),
    [
        ((-2.67, 0.63), (-0.15, 0.63), ("interval",)),
        ((0.1, 0.4), (2.6, 0.4), ("instant",)),
        ((-1.1, 0.8), (1.4, 0.8), ("instant", "interval")),
        ((15.0, 0.4), (17.5, 0.4), ("instant",)),
        ((0.0, np.inf), (0.0, np.inf), ("instant", "interval")),
    ],
)
def test_rotations_tell_the_kind_of_samples_or_leave_both(instant, interval, expected):
    assert likely_kinds(ClockOffset(*instant), ClockOffset(*interval)) == expected


@pytest.mark.parametrize("kind", ["instant", "interval"])
def test_the_given_kind_is_used(kind):
    flight, problem, stamps, _ = made("instant", seed=1, step=8)
    found = adjusted(flight.sequence, problem, stamps, imu_noise_scale=1.0, imu_samples=kind)
    assert found.imu_samples == kind == found.asdict()["imu_samples"]
    with pytest.raises(bundle.InputError, match="imu_samples"):
        adjusted(flight.sequence, problem, stamps, imu_samples="mean")


def test_a_wrong_clock_is_corrected_and_stated():
    flight, problem, stamps, inner = made(seed=0)
    problem = problem.select(images=np.isin(np.arange(len(stamps)), inner)).problem
    stamps = stamps[inner]
    right = adjusted(flight.sequence, problem, stamps, imu_noise_scale=1.0)
    late = adjusted(flight.sequence, problem, stamps + 15_000_000, imu_noise_scale=1.0)
    assert late.clock.is_clear
    assert late.clock.seconds == pytest.approx(-0.015 + right.clock.seconds, abs=0.002)
    error = error_of(late, late.result.problem, stamps, flight.sequence, flight.ground_truth)
    assert error.scale == pytest.approx(1, abs=0.03)
    assert f"{1e3 * late.clock.seconds:.2g}" in late.sentence
    assert late.asdict()["clock_offset_used"]


@functools.cache
def without_positions():
    flight, problem, stamps, _ = made(seed=2)
    return adjusted(flight.sequence, problem, stamps, imu_noise_scale=1.0).result.problem


@pytest.mark.parametrize("are_few", [False, True])
def test_positions_place_the_result_in_their_frame(are_few):
    """With positions and an IMU, heading and place are those of the positions."""
    flight, problem, stamps, _ = made(seed=2)
    reference = without_positions()
    turn = Rotation.from_euler("z", 2.1)
    places = turn.apply(reference.projection_centers) + np.array([1e3, -2e3, 50.0])
    chosen = (0, problem.num_images // 2) if are_few else range(problem.num_images)
    noise = 0.02 * np.random.default_rng(0).normal(size=places.shape)
    priors = tuple(
        bundle.PositionPrior(problem.image_names[k], places[k] + noise[k], 0.02) for k in chosen
    )
    found = adjusted(flight.sequence, problem, stamps, imu_noise_scale=1.0, priors=priors)
    result = found.result
    assert result.summary.is_solution_usable
    sizes = np.linalg.norm(result.problem.projection_centers - places, axis=1)
    assert np.median(sizes) < (0.3 if are_few else 0.03)
    down = Rotation.from_quat(result.problem.cam_from_world[:, :4]).apply([0, 0, -1.0])
    expected = Rotation.from_quat(reference.cam_from_world[:, :4]).apply([0, 0, -1.0])
    assert np.degrees(np.linalg.norm(down - expected, axis=1)).max() < 0.5
    np.testing.assert_allclose(
        found.similarity.apply(problem.projection_centers).mean(axis=0), places.mean(axis=0), atol=2
    )


@pytest.mark.parametrize(
    ("late", "price", "is_used"),
    [(-4, 8.0, True), (-2, 8.0, True), (-2, 1e3, False), (0, 0, False)],
)
def test_the_joint_cost_decides_on_an_offset_that_rotations_leave_in_doubt(
    late, price, is_used, monkeypatch
):
    """An offset is used if it lowers the joint cost by more than the price."""
    flight, problem, stamps, inner = made(seed=0)
    problem = problem.select(images=np.isin(np.arange(len(stamps)), inner)).problem
    monkeypatch.setattr(imu_adjustment, "CLEAR", price)
    stamps = stamps[inner] + 1_000_000 * late
    found = adjusted(flight.sequence, problem, stamps, imu_noise_scale=1.0, imu_samples="instant")
    assert found.clock.lowers_cost == found.clock.is_clear == is_used
    assert abs(found.clock.seconds) < 5 * found.clock.sigma
    if is_used:
        assert 1e3 * found.clock.seconds == pytest.approx(-late, abs=3e3 * found.clock.sigma)
        assert [one.kind for one in found.findings] == ["imu_clocks"]


def test_an_offset_is_doubtful_between_two_and_five_sigmas():
    sizes = (1.9, -2.1, 4.9, 5.1)
    assert [ClockOffset(s, 1.0).is_doubtful for s in sizes] == [False, True, True, False]
    assert not ClockOffset(3.0, 1.0, lowers_cost=True).is_doubtful
    assert not ClockOffset().is_doubtful
