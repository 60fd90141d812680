"""bundle itself, through its Python interface.

``build`` is everything that bundle.solve does outside the backend, before and after. The trace is
shifted by all of it: unfair to us by the part after. Statistics of the reprojection error, which
nobody here computes, are made when a result is asked for them: not before `bundle refine` reports.
"""

from __future__ import annotations

import importlib
import time
from typing import Any

import numpy as np

import bundle
from benchmarks import bal
from benchmarks.runners import protocol

# Imported on first use. The imports of other packages are not timed either.
bundle.load, bundle.solve  # noqa: B018
importlib.import_module("bundle.solving.executors")


def _rotation_matrices(quaternions: Any) -> Any:
    """Return (n, 3, 3) of (n, 4) quaternions, x y z w, not necessarily of unit length."""
    x, y, z, w = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rows).transpose(2, 0, 1)


def _to_bal(problem: bundle.Problem) -> bal.Bal:
    poses = problem.cam_from_world
    turned = bal.FLIP_FRAME[:, None] * _rotation_matrices(poses[:, :4])
    cameras = np.empty((len(poses), 9))
    cameras[:, :3] = bal.rotation_vectors(turned)
    cameras[:, 3:6] = bal.FLIP_FRAME * poses[:, 4:]
    cameras[:, 6:] = problem.camera_params[problem.image_camera][:, [0, 3, 4]]
    return bal.Bal(
        camera_index=problem.observation_image.astype(np.int64),
        point_index=problem.observation_point.astype(np.int64),
        xy=bal.FLIP_IMAGE * problem.observation_xy,
        cameras=cameras,
        points=problem.points,
    )


def _verified_cost(problem: bundle.Problem, kind: str) -> float:
    if kind == "bal":
        return bal.cost(_to_bal(problem))
    from benchmarks import colmap

    return colmap.cost(problem.to_pycolmap())


def _size(problem: bundle.Problem) -> dict[str, int]:
    tracks = np.bincount(problem.observation_point)
    names = bundle.camera_models()[problem.camera_models[problem.image_camera[0]]]
    return {
        "images": problem.num_images,
        "points": problem.num_points,
        "observations": problem.num_observations,
        "image_pairs": int((tracks * (tracks - 1)).sum()) // 2,
        "cameras": len(np.unique(problem.image_camera)),
        "camera_columns": len(set(names) - {"cx", "cy"}),  # the default of all solvers
        "rigs": int(problem.num_frames > 0),
    }


def run(request: protocol.Request) -> protocol.Outcome:
    """Load and solve, timing each."""
    start = time.perf_counter()
    problem = bundle.load(request.path)
    loaded = time.perf_counter()
    load_memory = protocol.peak_memory()
    loaded_memory = protocol.restart_peak_memory()
    begun = time.perf_counter()
    result = bundle.solve(
        problem,
        backend=request.backend,
        linear_solver_type=request.solver,
        num_threads=request.threads,
        convergence="ceres",  # the rule of all solvers
        max_num_iterations=request.max_num_iterations,
        function_tolerance=request.function_tolerance,
        gradient_tolerance=request.gradient_tolerance,
        parameter_tolerance=request.parameter_tolerance,
        cheirality="zero",  # the rule that COLMAP and GTSAM have built in
    )
    solved = time.perf_counter()
    memory = protocol.peak_memory()
    summary = result.summary
    build = solved - begun - summary.total_time_in_seconds
    seconds = build + np.asarray(result.iterations["cumulative_time_in_seconds"], dtype=float)
    return protocol.Outcome(
        load=loaded - start,
        build=build,
        solve=summary.total_time_in_seconds,
        minimizer=summary.minimizer_time_in_seconds,
        num_steps=summary.num_linear_solves,
        trace=list(zip(seconds.tolist(), result.iterations["cost"].tolist(), strict=True)),
        initial_cost=summary.initial_cost,
        final_cost=summary.final_cost,
        termination=summary.termination_type,
        verified_cost=_verified_cost(result.problem, request.kind),
        peak_memory=max(memory, load_memory),
        added_memory=memory - loaded_memory if loaded_memory >= 0 else -1,
        notes=[
            summary.backend_used,
            summary.linear_solver_type_used,
            summary.schur_structure_used,
        ],
        size=_size(problem),
        versions={"bundle": bundle.__version__},
    )


if __name__ == "__main__":
    protocol.main(run)
