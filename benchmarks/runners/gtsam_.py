"""GTSAM: projection factors on Bundler cameras, Levenberg-Marquardt, points eliminated first.

Of GTSAM 4.3's optimisers (LevenbergMarquardtOptimizer, SfmLevenbergMarquardtOptimizer in both
elimination modes, multifrontal Cholesky and the new multifrontal solver) the one used here has the
shortest step on 16-22106.
"""

from __future__ import annotations

import tempfile
import time
from importlib import metadata
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import P

from benchmarks import bal
from benchmarks.runners import protocol


def _initial(scene: Any) -> gtsam.Values:
    """Return the cameras under keys 0, 1, ... and the points under P(0), P(1), ..."""
    values = gtsam.Values()
    for index in range(scene.numberCameras()):
        values.insert(index, scene.camera(index))
    for index in range(scene.numberTracks()):
        values.insert(P(index), scene.track(index).point3())
    return values


def _optimizer(scene: Any, values: gtsam.Values, log: Path) -> Any:
    ordering = gtsam.Ordering()
    for index in range(scene.numberTracks()):
        ordering.push_back(P(index))
    for index in range(scene.numberCameras()):
        ordering.push_back(index)
    parameters = gtsam.LevenbergMarquardtParams.CeresDefaults()
    parameters.setLinearSolverType("MULTIFRONTAL_CHOLESKY")
    parameters.setOrdering(ordering)
    parameters.setLogFile(str(log))
    return gtsam.LevenbergMarquardtOptimizer(scene.generalSfmFactors(), values, parameters)


def _to_bal(values: gtsam.Values, problem: bal.Bal) -> bal.Bal:
    """Return the problem with the refined numbers; GTSAM's cameras look along +z."""
    cameras = np.empty_like(problem.cameras)
    rotations = np.empty((len(cameras), 3, 3))
    for index in range(len(cameras)):
        camera = values.atPinholeCameraCal3Bundler(index)
        camera_from_world = camera.pose().inverse()
        rotations[index] = bal.FLIP_FRAME[:, None] * camera_from_world.rotation().matrix()
        cameras[index, 3:6] = bal.FLIP_FRAME * camera_from_world.translation()
        calibration = camera.calibration()
        cameras[index, 6:] = calibration.fx(), calibration.k1(), calibration.k2()
    cameras[:, :3] = bal.rotation_vectors(rotations)
    points = np.array([values.atPoint3(P(index)) for index in range(len(problem.points))])
    return bal.Bal(problem.camera_index, problem.point_index, problem.xy, cameras, points)


def _iterate(optimizer: Any, request: protocol.Request, since: float) -> list[tuple[float, float]]:
    """Run accepted steps until Ceres' function tolerance or the iteration limit stops them."""
    trace = [(time.perf_counter() - since, float(optimizer.error()))]
    for _ in range(request.max_num_iterations):
        optimizer.iterate()
        trace.append((time.perf_counter() - since, float(optimizer.error())))
        if abs(trace[-2][1] - trace[-1][1]) <= request.function_tolerance * trace[-2][1]:
            break
    return trace


def run(request: protocol.Request) -> protocol.Outcome:
    """Load, build and solve, timing each; the trace has one entry an accepted step."""
    if request.kind != "bal":
        raise protocol.NotApplicableError("Cal3Bundler has no shared or OPENCV camera")
    with tempfile.TemporaryDirectory() as folder:
        plain, log = Path(folder) / "problem.txt", Path(folder) / "log"
        plain.write_bytes(bal.open_text(request.path))  # GTSAM reads plain text only: not timed
        start = time.perf_counter()
        scene = gtsam.SfmData.FromBalFile(str(plain))
        loaded = time.perf_counter()
        optimizer = _optimizer(scene, _initial(scene), log)
        built = time.perf_counter()
        trace = _iterate(optimizer, request, loaded)
        solved = time.perf_counter()
        # The log has a line for the start and one a rejected step.
        rejected = len(log.read_text().split()) - 1
    memory = protocol.peak_memory()
    return protocol.Outcome(
        load=loaded - start,
        build=built - loaded,
        solve=solved - built,
        minimizer=solved - built,
        num_steps=optimizer.iterations() + rejected,
        trace=trace,
        initial_cost=trace[0][1],
        final_cost=trace[-1][1],
        termination="CONVERGENCE" if len(trace) <= request.max_num_iterations else "NO_CONVERGENCE",
        verified_cost=bal.cost(_to_bal(optimizer.values(), bal.read(request.path))),
        peak_memory=memory,
        notes=["MULTIFRONTAL_CHOLESKY", "points first"],
        versions={"gtsam": metadata.version("gtsam")},
    )


if __name__ == "__main__":
    protocol.main(run)
