"""A batch of visual-inertial keyframes: bundle beside GTSAM, same factors.

The batch is V1_01 at 4 images per second from 4 s on, started from the states of a window that ran
over it: reprojections with Cauchy's loss, preintegrated samples, walking biases, priors on the
first position, yaw and biases. Landmarks have three numbers in both, by inverse depth here and as
points there, so that both have one cost. GTSAM's preintegration of 0.25 s differs by some 1e-8,
its covariance by some 1e-4.

Run: OPENBLAS_NUM_THREADS=1 python -m benchmarks.windows [--repeat N] [--json FILE]
"""

from __future__ import annotations

import importlib.util
import os
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import backend, measure
from benchmarks.backend import GTSAM, OURS
from bundle import _core
from bundle.inertial.vio.odometry import run_odometry
from bundle.inertial.vio.sequence_images import SequenceImages
from bundle.inertial.vio.sliding_window import SlidingWindow
from bundle.inertial.vio.window_telemetry import window_arrays
from bundle.interface.window_options import WindowOptions
from bundle.io.sequences.sequence_folder import read_track_csv
from bundle.model.rigid_motions import rotation_matrices

DATA = Path(os.environ.get("BUNDLE_DATA", Path(__file__).parents[2] / "shared" / "data")) / "vio"
SEQUENCE = DATA / "euroc_V1_01_tracks_imu_30s.csv"
SETTINGS: dict[str, Any] = {
    "marginalize": "keep",
    "frame_rate": 4.0,
    "min_parallax": 0.0,
    "min_translation": 0.0,
    "start_position_sigma": 1e-4,
    "start_yaw_sigma": 0.01,
    "start_gyro_bias_sigma": 0.1,
    "start_accel_bias_sigma": 0.2,
    "time_budget": 100.0,
    "integration": "zero_order_hold",
}
OPTIONS = {
    "max_num_iterations": 60,
    "time_budget": 100.0,
    "function_tolerance": 1e-8,
    "spectrum": False,
    "covariance": False,
    "expected_imu_cost": False,
    "fix_gauge": False,
}


def batch() -> tuple[SlidingWindow, dict[str, Any]]:
    """Return the window of all keyframes and its arrays, at states of a sliding window."""
    sequence = read_track_csv(SEQUENCE)
    rough = run_odometry(sequence, frame_rate=4.0, min_parallax=10.0, time_budget=100.0)
    options = WindowOptions(**SETTINGS)
    images = SequenceImages(sequence, options.integration)
    at, place = rough.trajectory.timestamps_ns, np.arange(len(rough.trajectory))
    rows = place[np.isin(at, images.stamps)]
    chosen = np.searchsorted(images.stamps, at[rows]).tolist()
    calibration = sequence.calibration
    window = SlidingWindow(
        calibration.camera_from_imu, calibration.noise, calibration.focal, options=options
    )
    window.start(
        at[rows],
        rough.trajectory.states[rows],
        [images.tracks(image) for image in chosen],
        images.intervals(chosen),
    )
    # The start above is solved; the comparison begins where it did.
    for frame, k in zip(window.frames, rows, strict=True):
        frame.state = rough.trajectory.states[k].copy()
    table, points = window._table()
    arrays = window_arrays(window, table, points)
    assert window.prior is not None
    arrays["priors"] = [
        window.prior.at({frame.stamp: place for place, frame in enumerate(window.frames)})
    ]
    return window, arrays


def by_bundle(arrays: dict[str, Any]) -> tuple[float, float, int]:
    start = time.process_time()
    solved = _core.solve_window(arrays, OPTIONS, None)
    took = time.process_time() - start
    return took, sum(solved["costs_after"].values()), solved["num_iterations"]


def gtsam_problem(window: SlidingWindow, arrays: dict[str, Any]) -> tuple[Any, Any]:
    """Return GTSAM's graph and values of the same factors."""
    import gtsam
    from gtsam.symbol_shorthand import B, L, V, X

    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    states, noise = arrays["states"], window.noise
    rotations = rotation_matrices(states[:, :4])
    for k, state in enumerate(states):
        values.insert(X(k), gtsam.Pose3(gtsam.Rot3(rotations[k]), state[4:7]))
        values.insert(V(k), state[7:10])
        values.insert(B(k), gtsam.imuBias.ConstantBias(state[13:16], state[10:13]))
    camera = arrays["camera_from_imu"]
    turn = rotation_matrices(np.asarray(camera)[None, :4])[0]
    body_from_camera = gtsam.Pose3(gtsam.Rot3(turn.T), -turn.T @ np.asarray(camera[4:]))
    robust = gtsam.noiseModel.Robust.Create(
        gtsam.noiseModel.mEstimator.Cauchy.Create(1.0),
        gtsam.noiseModel.Isotropic.Sigma(2, arrays["sigma"]),
    )
    lens = gtsam.Cal3_S2(1, 1, 0, 0, 0)

    def see(frame: int, landmark: int, xy: Any) -> None:
        graph.add(
            gtsam.GenericProjectionFactorCal3_S2(
                np.asarray(xy), robust, X(frame), L(landmark), lens, body_from_camera
            )
        )

    for landmark, (x, y, inverse) in enumerate(arrays["points"]):
        anchor = int(arrays["anchor_states"][landmark])
        ray = np.array([x, y, 1.0]) / max(inverse, 1e-3)
        values.insert(
            L(landmark), values.atPose3(X(anchor)).compose(body_from_camera).transformFrom(ray)
        )
        see(anchor, landmark, arrays["anchor_xy"][landmark])
    rows = zip(arrays["landmarks"], arrays["observers"], arrays["xy"], strict=True)
    for landmark, frame, xy in rows:
        see(int(frame), int(landmark), xy)
    params = gtsam.PreintegrationParams.MakeSharedU(9.81)
    params.setAccelerometerCovariance(np.eye(3) * noise.accel_noise_density**2)
    params.setGyroscopeCovariance(np.eye(3) * noise.gyro_noise_density**2)
    params.setIntegrationCovariance(np.eye(3) * noise.integration_covariance)
    for k, frame in enumerate(window.frames[1:]):
        interval, state = frame.interval, states[k]
        assert interval is not None
        motion = gtsam.PreintegratedImuMeasurements(
            params, gtsam.imuBias.ConstantBias(state[13:16], state[10:13])
        )
        for gyro, accel, dt in zip(interval.gyro, interval.accel, interval.dt, strict=True):
            motion.integrateMeasurement(accel, gyro, dt)
        graph.add(gtsam.ImuFactor(X(k), V(k), X(k + 1), V(k + 1), B(k), motion))
        root = np.sqrt(float(interval.dt.sum()))
        walk = [noise.accel_bias_random_walk * root] * 3 + [noise.gyro_bias_random_walk * root] * 3
        graph.add(
            gtsam.BetweenFactorConstantBias(
                B(k), B(k + 1), gtsam.imuBias.ConstantBias(),
                gtsam.noiseModel.Diagonal.Sigmas(np.array(walk)),
            )
        )  # fmt: skip
    options = window.options
    up = rotations[0].T[:, 2]
    information = np.zeros((6, 6))
    information[:3, :3] = np.outer(up, up) / np.radians(options.start_yaw_sigma) ** 2
    information[3:, 3:] = np.eye(3) / options.start_position_sigma**2
    information[:3, :3] += 1e-9 * np.eye(3)
    graph.add(
        gtsam.PriorFactorPose3(
            X(0), values.atPose3(X(0)), gtsam.noiseModel.Gaussian.Information(information)
        )
    )
    sigmas = [options.start_accel_bias_sigma] * 3 + [options.start_gyro_bias_sigma] * 3
    graph.add(
        gtsam.PriorFactorConstantBias(
            B(0), values.atConstantBias(B(0)), gtsam.noiseModel.Diagonal.Sigmas(np.array(sigmas))
        )
    )
    return graph, values


def by_gtsam(graph: Any, values: Any) -> tuple[float, float, int]:
    import gtsam

    params = gtsam.LevenbergMarquardtParams()
    params.setMaxIterations(60)
    params.setRelativeErrorTol(1e-8)
    start = time.process_time()
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, params)
    result = optimizer.optimize()
    took = time.process_time() - start
    return took, graph.error(result), optimizer.iterations()


def measured(repeat: int) -> dict[str, Any]:
    """Return the size of the batch, and the runs by whose they are: seconds, cost, steps."""
    if not SEQUENCE.exists():
        return {}
    window, arrays = batch()
    runs: dict[str, list[tuple[float, float, int]]] = {OURS: [], GTSAM: []}
    for _ in range(repeat):
        runs[OURS].append(by_bundle(arrays))
    if importlib.util.find_spec("gtsam") is not None:
        graph, values = gtsam_problem(window, arrays)
        for _ in range(repeat):
            runs[GTSAM].append(by_gtsam(graph, values))
    return {
        "keyframes": len(arrays["states"]),
        "landmarks": len(arrays["points"]),
        "observations": len(arrays["xy"]) + len(arrays["points"]),
        "runs": {
            who: [dict(zip(("seconds", "cost", "steps"), run, strict=True)) for run in mine]
            for who, mine in runs.items()
        },
    }


if __name__ == "__main__":
    measure.run_alone(__doc__, measured, backend.windows_table)
