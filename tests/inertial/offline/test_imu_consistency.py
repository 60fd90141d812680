"""Errors of adjustments with an IMU, relative to the covariance of a factor graph."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.inertial.offline import motion_solve
from bundle.inertial.offline.imu_adjustment import adjust_with_imu
from bundle.inertial.offline.inertial_result import ImuSamples
from bundle.inertial.vio.trajectory_comparison import states_at
from tests.inertial.offline.models import model_of

SIGMA = 0.5  # px; the cost of a solve has pixels, so that the IMU's noise is divided by it
POSES = {"refine": ("poses", "points"), "max_num_iterations": 200}


def graph_of(problem, factors):
    """The problem and its factors as a factor graph, with known intrinsics."""
    graph = bundle.FactorGraph()
    for image, pose in zip(problem.image_ids.tolist(), problem.cam_from_world, strict=True):
        graph.add_variable(("image", image), pose, "se3")
    graph.add_variable("lens", problem.camera_params[0, :4])
    graph.add_factor(bundle.PriorFactor("lens", problem.camera_params[0, :4], 1e12))
    for point, place in zip(problem.point_ids.tolist(), problem.points, strict=True):
        graph.add_variable(("point", point), place)
    images = problem.image_ids[problem.observation_image].tolist()
    points = problem.point_ids[problem.observation_point].tolist()
    for image, point, xy in zip(images, points, problem.observation_xy, strict=True):
        graph.add_factor(
            bundle.ReprojectionFactor(("image", image), "lens", ("point", point), xy, "PINHOLE")
        )
    for factor in factors:
        graph.add_factor(factor)
    return graph


def true_poses(flight, stamps):
    states = states_at(flight.ground_truth, stamps)
    arm = np.array(flight.sequence.calibration.camera_from_imu)
    rotation = Rotation.from_quat(arm[:4]) * Rotation.from_quat(states[:, :4]).inv()
    return rotation, arm[4:] - rotation.apply(states[:, 4:7])


@pytest.mark.parametrize("kind", ["instant", "interval"])
def test_scale_vertical_and_shape_are_within_their_sigmas(monkeypatch, kind):
    """Samples are those at their stamps, or means of the intervals that follow."""
    solves = []

    def run(request, *others):
        solves.append((imu_solve(request, *others), request.factors))
        return solves[-1][0]

    imu_solve = motion_solve.run
    monkeypatch.setattr(motion_solve, "run", run)
    scales, tilts, squares = [], [], []
    for seed in range(4):
        flight = bundle.synthesize_flight(
            motion=("loop", "room")[seed % 2], duration=8.0, num_tracks=60, seed=seed,
            pixel_noise=SIGMA, imu_samples=kind,
        )  # fmt: skip
        sequence, calibration = flight.sequence, flight.sequence.calibration
        problem, stamps = model_of(sequence, flight.ground_truth, 4)
        alone = bundle.solve(problem, **POSES).problem
        alone = bundle.filter_observations(alone, 4.0, 2.0, 3).problem
        samples = ImuSamples(sequence.imu_timestamps_ns, sequence.gyro, sequence.accel)
        found = adjust_with_imu(
            alone, samples, stamps, calibration.camera_from_imu, calibration.noise,
            bundle.SolveOptions(**POSES), imu_noise_scale=1 / SIGMA,
        )  # fmt: skip
        assert found.result.summary.termination_type == "CONVERGENCE"
        assert found.result.summary.num_successful_steps < 30
        cost = found.result.summary.final_cost  # unless the rotations tell, both kinds are tried
        result, factors = next(one for one in solves if one[0].summary.final_cost == cost)
        assert found.imu_samples == kind
        ids, last = problem.image_ids.tolist(), len(stamps) - 1
        pair = ("image", ids[0]), ("image", ids[last])
        known = bundle.covariance(
            graph_of(result.problem, factors), gauge="inner", relative=[pair],
            of=[("image", ids[last // 2])],
        )  # fmt: skip
        assert known.num_gauge_freedoms == 4
        turned, shift = true_poses(flight, stamps)
        poses = np.array(found.result.problem.cam_from_world)
        rotation = Rotation.from_quat(poses[:, :4])
        relative, expected = (
            (turn[last] * turn[0].inv(), t[last] - (turn[last] * turn[0].inv()).apply(t[0]))
            for turn, t in ((rotation, poses[:, 4:]), (turned, shift))
        )
        back = expected[0].inv()
        error = np.r_[(back * relative[0]).as_rotvec(), back.apply(relative[1] - expected[1])]
        covariance = SIGMA**2 * known.relative(*pair)
        squares.append(error @ np.linalg.solve(covariance, error))
        along = back.apply(expected[1]) / np.linalg.norm(expected[1])
        length = np.linalg.norm(relative[1]) - np.linalg.norm(expected[1])
        scales.append(length / np.sqrt(along @ covariance[3:, 3:] @ along))
        middle = last // 2
        down = turned[middle].inv().apply(rotation[middle].apply([0, 0, -1.0]))
        sigmas = SIGMA * np.sqrt(np.diag(known.variable(("image", ids[middle]))))
        tilts += (np.array([down[1], -down[0]]) / sigmas[:2]).tolist()
    assert 0.5 < np.mean(squares) / 6 < 2
    assert np.sqrt(np.mean(np.square(scales))) < 2
    assert 0.4 < np.sqrt(np.mean(np.square(tilts))) < 1.6
