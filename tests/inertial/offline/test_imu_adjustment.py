"""Adjustment with an IMU: scale, vertical and accuracy, Jacobians, V1_01, bad input."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle import InputError
from bundle.inertial.offline.imu_adjustment import adjust_with_imu
from bundle.inertial.offline.inertial_result import ImuSamples
from bundle.inertial.preintegration.imu_factors import ImageImuFactor
from bundle.inertial.vio.trajectory_comparison import compare_trajectories
from bundle.io.sequences.sequence_folder import read_track_csv
from bundle.io.sequences.trajectory_files import Trajectory, load_trajectory
from tests.inertial.offline.models import model_of, world_from_imu

POSES = {"refine": ("poses", "points"), "loss": "cauchy", "max_num_iterations": 60}


@pytest.fixture(scope="module")
def flight():
    return bundle.synthesize_flight(duration=8.0, num_tracks=120, seed=3)


def samples_of(sequence):
    return ImuSamples(sequence.imu_timestamps_ns, sequence.gyro, sequence.accel)


def adjusted(sequence, problem, stamps, options=None, **settings):
    calibration = sequence.calibration
    options = bundle.SolveOptions(**POSES) if options is None else options
    return adjust_with_imu(
        problem, samples_of(sequence), stamps, calibration.camera_from_imu, calibration.noise,
        options, **settings,
    )  # fmt: skip


def error_of(found, problem, stamps, sequence, truth):
    poses = world_from_imu(problem, sequence.calibration.camera_from_imu)
    order = np.argsort(stamps)
    states = np.hstack([poses, np.zeros((len(poses), 9))])[order]
    assert found is None or len(found.timestamps_ns) == len(poses)
    return compare_trajectories(Trajectory(stamps[order], states), truth)


def test_scale_vertical_and_path_of_a_flight(flight):
    problem, stamps = model_of(flight.sequence, flight.ground_truth, 4)
    found = adjusted(flight.sequence, problem, stamps, imu_noise_scale=1.0)
    error = error_of(found, found.result.problem, stamps, flight.sequence, flight.ground_truth)
    assert error.scale == pytest.approx(1, abs=0.03)
    assert error.ate_yaw < 0.05
    assert error.rotation_rms < 0.5
    assert found.result.problem.num_points == problem.num_points
    assert found.result.problem.point_ids.tolist() == problem.point_ids.tolist()
    assert found.similarity.scale == pytest.approx(3.7, rel=0.5)  # the start is rough


def test_v1_01_is_accurate_to_a_centimetre(bundle_data):
    sequence = read_track_csv(bundle_data / "vio" / "euroc_V1_01_tracks_imu_30s.csv")
    truth = load_trajectory(bundle_data / "vio" / "euroc_V1_01_ground_truth.csv")
    problem, stamps = model_of(sequence, truth, 5)
    alone = bundle.solve(problem, **POSES)
    found = adjusted(sequence, alone.problem, stamps)
    error = error_of(found, found.result.problem, stamps, sequence, truth)
    assert error.ate < 0.012
    assert error.scale == pytest.approx(1, abs=0.01)


def test_jacobians_are_right(flight):
    rng = np.random.default_rng(2)
    motion = bundle.Preintegration(flight.sequence.calibration.noise)
    motion.integrate(rng.normal(size=(20, 3)), rng.normal(size=(20, 3)), np.full(20, 0.005))
    graph = bundle.FactorGraph()
    for name in ("a", "b"):
        quaternion = Rotation.random(random_state=len(name) + ord(name)).as_quat()
        graph.add_variable(name, [*quaternion, *rng.normal(size=3)], "se3")
        graph.add_variable(f"v{name}", rng.normal(size=3))
    graph.add_variable("gyro", 0.01 * rng.normal(size=3))
    graph.add_variable("accel", 0.1 * rng.normal(size=3))
    arm = [*Rotation.random(random_state=9).as_quat(), 0.1, -0.2, 0.3]
    graph.add_factor(ImageImuFactor("a", "va", "gyro", "accel", "b", "vb", motion, arm))
    assert graph.check_gradients().ok


def test_images_in_any_order_and_with_an_offset_of_the_clock(flight):
    problem, stamps = model_of(flight.sequence, flight.ground_truth, 8)
    order = np.random.default_rng(4).permutation(problem.num_images)
    place = np.argsort(order)
    names = ("cam_from_world", "image_ids", "image_camera")
    changes = {name: getattr(problem, name)[order] for name in names}
    changes["image_names"] = [problem.image_names[k] for k in order.tolist()]
    changes["observation_image"] = place[problem.observation_image]
    mixed = problem.replace(**changes)
    options = bundle.SolveOptions(refine=("poses", "points"), max_num_iterations=20)
    one = adjusted(flight.sequence, problem, stamps, options)
    other = adjusted(flight.sequence, mixed, stamps[order], options)
    assert other.result.summary.final_cost == pytest.approx(one.result.summary.final_cost, rel=1e-5)
    np.testing.assert_allclose(other.velocities, one.velocities[order], atol=1e-3)


def test_what_cannot_be_adjusted_is_refused(flight):
    sequence = flight.sequence
    problem, stamps = model_of(sequence, flight.ground_truth, 8)
    still = dataclasses.replace(sequence, accel=np.tile([0, 0, 9.81], (len(sequence.accel), 1)))
    cases = [
        (lambda: adjusted(sequence, problem, stamps + 10**12), "outside"),
        (lambda: adjusted(sequence, problem, stamps - 10**12), "outside"),
        (lambda: adjusted(sequence, problem, np.r_[stamps[:-1], stamps[-1] + 10**11]), "outside"),
        (lambda: adjusted(sequence, problem, np.r_[stamps[1], stamps[1:]]), "twice"),
        (lambda: adjusted(sequence, problem, stamps, imu_noise_scale=0.0), "imu_noise_scale"),
        (lambda: adjusted(still, problem, stamps), "scale"),
    ]
    for settings, word in (
        ({"backend": "fused"}, "ceres"),
        ({"fixed_image_ids": (1,)}, "fixed"),
        ({"refine": ("points",)}, "poses"),
    ):
        options = bundle.SolveOptions(**settings)
        cases.append((lambda o=options: adjusted(sequence, problem, stamps, o), word))
    for call, word in cases:
        with pytest.raises(InputError, match=word) as error:
            call()
        assert "\n" not in str(error.value)
