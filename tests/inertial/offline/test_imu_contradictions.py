"""Adjustments whose IMU contradicts the images: none is usable, each has its cause."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle import InputError
from bundle.inertial.offline import imu_adjustment
from bundle.inertial.offline.imu_agreement import cauchy_cost
from tests.inertial.offline.models import model_of
from tests.inertial.offline.test_imu_adjustment import adjusted

OPTIONS = bundle.SolveOptions(refine=("poses", "points"), loss="cauchy", max_num_iterations=15)


@pytest.fixture(scope="module")
def flight():
    return bundle.synthesize_flight(duration=8.0, num_tracks=60, seed=11)


@pytest.fixture(scope="module")
def model(flight):
    problem, stamps = model_of(flight.sequence, flight.ground_truth, 4, noise=0.2)
    return bundle.solve(problem, refine=("poses", "points")).problem, stamps


def changed(sequence, **columns):
    """The sequence with other samples or calibration, by functions of the present ones."""
    calibration = columns.pop("calibration", None)
    values = {name: change(np.array(getattr(sequence, name))) for name, change in columns.items()}
    if calibration is not None:
        values["calibration"] = dataclasses.replace(sequence.calibration, **calibration)
    return dataclasses.replace(sequence, **values)


def at(row, value):
    def change(values):
        values[row] = value
        return values

    return change


def arm(sequence, turn):
    given = np.array(sequence.calibration.camera_from_imu)
    turned = Rotation.from_rotvec(np.radians(turn)) * Rotation.from_quat(given[:4])
    return {"camera_from_imu": (*turned.as_quat(), *given[4:])}


def test_right_samples_are_silent(flight, model):
    found = adjusted(flight.sequence, *model, OPTIONS)
    assert found.findings == ()
    assert found.result.summary.is_solution_usable
    agreement = found.agreement
    count = len(model[1]) - 1
    assert len(agreement.interval_chi2) == count
    assert agreement.freedom == 6 * count
    assert 0 < agreement.chi2 < 0.5 * agreement.freedom
    walks = np.asarray(found.result.factor_costs_after)[count:].sum()
    total = agreement.interval_chi2.sum() / 2
    assert found.imu_cost <= total <= found.imu_cost + walks


def test_a_turned_camera_from_imu_is_found_with_the_right_one(flight, model):
    sequence = changed(flight.sequence, calibration=arm(flight.sequence, [0, 0, 6]))
    found = adjusted(sequence, *model, OPTIONS)
    assert [one.kind for one in found.findings[:2]] == ["imu_contradiction", "camera_from_imu"]
    assert not found.result.summary.is_solution_usable
    assert found.findings[0].evidence["cause"] == "camera_from_imu"
    evidence = found.findings[1].evidence
    assert evidence["degrees"] == pytest.approx(6, abs=0.5)
    right = Rotation.from_quat(flight.sequence.calibration.camera_from_imu[:4])
    off = (right.inv() * Rotation.from_quat(evidence["quaternion"])).magnitude()
    assert np.degrees(off) < 0.7
    assert found.headline[0][0].startswith("Not usable")


def test_times_that_jitter_are_a_matter_of_clocks(flight, model):
    problem, stamps = model
    jitter = np.random.default_rng(2).normal(0, 6e6, len(stamps)).astype(np.int64)
    jitter[[0, -1]] = 0
    found = adjusted(flight.sequence, problem, stamps + jitter, OPTIONS)
    assert found.findings[0].evidence["cause"] == "imu_clocks"
    clocks = next(one for one in found.findings if one.kind == "imu_clocks")
    assert clocks.evidence["jitter"] == pytest.approx(6e-3, rel=0.3)


def test_a_spike_is_bridged_and_named(flight, model):
    sequence = changed(flight.sequence, gyro=at((800, 1), 30.0))
    found = adjusted(sequence, *model, OPTIONS)
    clean = adjusted(flight.sequence, *model, OPTIONS)
    assert found.findings[0].kind == "imu_samples"
    (fault,) = found.findings[0].evidence["faults"]
    assert (fault["kind"], fault["first_row"], fault["seconds"]) == ("spike", 800, 4.0)
    assert found.scale == pytest.approx(clean.scale, rel=2e-3)


def test_a_jump_of_the_bias_names_its_interval(flight, model):
    def jump(values):
        values[900:, 0] += 3.0
        return values

    # After 15 steps, all intervals around the jump are still bent alike.
    options = dataclasses.replace(OPTIONS, max_num_iterations=60)
    found = adjusted(changed(flight.sequence, accel=jump), *model, options)
    assert found.findings[0].kind == "imu_contradiction"
    assert found.findings[0].evidence["seconds"] == pytest.approx(4.5, abs=0.7)


def test_a_bounded_loss_does_not_hide_a_contradiction(flight, model, monkeypatch):
    """The adjustment rejects observations, and images alone do not converge."""
    options, costs = OPTIONS.replace(loss="tukey"), []
    monkeypatch.setattr(
        imu_adjustment, "cauchy_cost", lambda *x: costs.append(cauchy_cost(*x)) or costs[-1]
    )
    clean = adjusted(flight.sequence, *model, options)
    assert clean.agreement.chi2 < 0.5 * clean.agreement.freedom
    assert clean.findings == ()
    total = np.sum(clean.result.factor_costs_after) + costs[0] - costs[1]
    assert clean.agreement.chi2 == pytest.approx(2 * total)
    turned = changed(flight.sequence, calibration=arm(flight.sequence, [0, 8, 0]))
    found = adjusted(turned, *model, options)
    assert found.findings[0].kind == "imu_contradiction"


def test_samples_and_clocks_are_the_cause_where_no_start_exists(flight, model):
    problem, stamps = model
    halted = changed(flight.sequence, accel=lambda v: at(np.arange(500, 1600), v[500])(v))
    with pytest.raises(InputError, match=r"found IMU sample 500: accelerometer frozen, 1100 "):
        adjusted(halted, problem, stamps, OPTIONS)
    early = problem.select(images=stamps < stamps[0] + 5_000_000_000).problem
    late = stamps[: early.num_images] + 1_500_000_000
    short = changed(flight.sequence, accel=lambda v: at(np.arange(500, 540), v[500])(v))
    with pytest.raises(InputError, match=r"clocks of camera and IMU differ by -1\.50 s"):
        adjusted(short, early, late, OPTIONS)


@pytest.fixture(scope="module")
def tilting():
    flight = bundle.synthesize_flight(motion="room", duration=8.0, num_tracks=60, seed=11)
    return flight.sequence, *model_of(flight.sequence, flight.ground_truth, 4, noise=0.2)


@pytest.mark.parametrize("factor", [0.97, 1.03])
def test_forces_that_are_three_percent_too_large_or_too_small(tilting, factor):
    sequence, *model = tilting
    found = adjusted(changed(sequence, accel=lambda v: factor * v), *model, OPTIONS)
    assert [one.kind for one in found.findings] == ["accel_scale"]
    evidence = found.findings[0].evidence
    assert evidence["ratio"] == pytest.approx(factor, abs=0.015)
    assert 0.001 < evidence["ratio_sigma"] < 0.006
    assert evidence["movement"] == pytest.approx(0.03, abs=0.01)


@pytest.mark.parametrize("loss", ["trivial", "huber"])
def test_forces_that_are_too_large_beside_points_of_weak_depth(loss):
    """A step to the right scale, and an undamped one, throws such points behind cameras."""
    flight = bundle.synthesize_flight(
        motion="room", duration=10.0, num_tracks=60, seed=91, pixel_noise=0.5
    )
    problem, stamps = model_of(flight.sequence, flight.ground_truth, 4, noise=0.1)
    sequence = changed(flight.sequence, accel=lambda v: 1.04 * v)
    options = OPTIONS.replace(loss=loss, max_num_iterations=40)
    inner = problem.select(images=np.arange(len(stamps)) > 0).problem
    found = adjusted(sequence, inner, stamps[1:], options)
    assert [one.kind for one in found.findings] == ["accel_scale"]
    assert found.findings[0].evidence["ratio"] == pytest.approx(1.04, abs=0.01)


def test_a_bias_along_gravity_is_no_scale_of_the_forces(tilting):
    sequence, *model = tilting
    found = adjusted(changed(sequence, accel=lambda v: v + np.array([0, 0, 0.3])), *model, OPTIONS)
    assert found.findings == ()


def test_noise_of_the_calibration(flight, model):
    noise = flight.sequence.calibration.noise
    large = changed(flight.sequence, calibration={"noise": noise.scaled(30.0)})
    found = adjusted(large, *model, OPTIONS)
    assert [one.kind for one in found.findings] == ["imu_noise"]
    assert found.findings[0].evidence["ratio"] == pytest.approx(30, rel=0.1)


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"gyro": np.negative}, "gyroscope is reversed"),
        ({"accel": np.negative}, "accelerometer is reversed.*scale is -"),
        ({"gyro": lambda v: v * [1, 1, -1]}, r"gyroscope is mirrored: its axes are \+x \+y -z"),
        ({"gyro": lambda v: v[:, [1, 0, 2]] * [1, -1, 1]}, r"turned: its axes are -y \+x \+z"),
        ({"gyro": lambda v: 0.2 * v}, "rad/s"),
        (
            {"calibration": {"camera_from_imu": (*np.full(4, 0.5), 70, 0, 0)}},
            "order|axes|turned|off",
        ),
    ],
)
def test_gross_errors_are_refused(flight, model, columns, words):
    with pytest.raises(InputError, match=words) as error:
        adjusted(changed(flight.sequence, **columns), *model, OPTIONS)
    assert "\n" not in str(error.value)


def test_degrees_with_several_turns_between_images_are_no_wrong_axes():
    flight = bundle.synthesize_flight(duration=8.0, num_tracks=30, seed=2)
    problem, stamps = model_of(flight.sequence, flight.ground_truth, 4, noise=0.02)
    with pytest.raises(InputError, match="rates of another unit"):
        adjusted(changed(flight.sequence, gyro=np.degrees), problem, stamps, OPTIONS)


def test_millimetres_and_inverted_poses_are_refused(flight, model):
    given = np.array(flight.sequence.calibration.camera_from_imu)
    long = changed(
        flight.sequence, calibration={"camera_from_imu": (*given[:4], *1000 * given[4:])}
    )
    with pytest.raises(InputError, match="millimetres"):
        adjusted(long, *model, OPTIONS)
    x, y, z, w = given[:4]
    swapped = changed(flight.sequence, calibration={"camera_from_imu": (w, x, y, z, *given[4:])})
    with pytest.raises(InputError, match="order w x y z"):
        adjusted(swapped, *model, OPTIONS)


def test_outliers_of_a_quadratic_loss_are_named_instead_of_the_imu(flight, model):
    problem, stamps = model
    contradictions = []
    for step, pixels in ((25, 30.0), (25, 60.0), (15, 60.0)):
        xy = np.array(problem.observation_xy)
        xy[::step] += pixels
        wrong = problem.replace(observation_xy=xy)
        found = adjusted(flight.sequence, wrong, stamps, OPTIONS.replace(loss="trivial"))
        contradictions += [one for one in found.findings if one.kind == "imu_contradiction"]
    assert {one.evidence["cause"] for one in contradictions} == {"outliers"}
    assert {one.flags for one in contradictions} == {("--loss", "cauchy")}


def test_few_iterations_leave_a_minimum_of_the_images_to_compare_with(flight):
    problem, stamps = model_of(flight.sequence, flight.ground_truth, 4, noise=0.2)
    found = adjusted(flight.sequence, problem, stamps, OPTIONS.replace(max_num_iterations=4))
    assert np.isfinite(found.agreement.chi2)
    assert found.result.summary.termination_type == "NO_CONVERGENCE"
