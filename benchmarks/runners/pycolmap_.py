"""pycolmap's Ceres bundle adjuster, called as its users call it.

pycolmap hands out no list of iterations, but Ceres' own progress table on standard output has them:
the runner turns it on and reads it (see ceres_log). Costs there have seven digits, times three.
"""

from __future__ import annotations

import dataclasses
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from benchmarks import bal, colmap
from benchmarks.runners import ceres_log, protocol

SOLVER_TYPES = {
    "dense-schur": "DENSE_SCHUR",
    "sparse-schur": "SPARSE_SCHUR",
    "iterative-schur": "ITERATIVE_SCHUR",
}


def to_reconstruction(problem: bal.Bal) -> pycolmap.Reconstruction:
    """Return the BAL problem with one RADIAL camera an image, ids from 1."""
    reconstruction = pycolmap.Reconstruction()
    rotations = bal.FLIP_FRAME[:, None] * bal.rotation_matrices(problem.cameras[:, :3])
    translations = bal.FLIP_FRAME * problem.cameras[:, 3:6]
    pixels = bal.FLIP_IMAGE * problem.xy
    by_image = np.argsort(problem.camera_index, kind="stable")
    starts = np.searchsorted(problem.camera_index[by_image], np.arange(len(rotations) + 1))
    keypoint = np.empty(len(pixels), dtype=np.int64)
    for index, (_, _, _, _, _, _, focal, k1, k2) in enumerate(problem.cameras.tolist()):
        mine = by_image[starts[index] : starts[index + 1]]
        keypoint[mine] = np.arange(len(mine))
        camera = pycolmap.Camera(
            camera_id=index + 1, model="RADIAL", width=1, height=1, params=[focal, 0, 0, k1, k2]
        )
        reconstruction.add_camera_with_trivial_rig(camera)
        image = pycolmap.Image(
            name=str(index), keypoints=pixels[mine], camera_id=index + 1, image_id=index + 1
        )
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rotations[index]), translations[index])
        reconstruction.add_image_with_trivial_frame(image, pose)
    elements = list(
        map(pycolmap.TrackElement, (problem.camera_index + 1).tolist(), keypoint.tolist())
    )
    by_point = np.argsort(problem.point_index, kind="stable").tolist()
    ends = np.cumsum(np.bincount(problem.point_index, minlength=len(problem.points))).tolist()
    begin = 0
    for point, end in zip(problem.points, ends, strict=True):
        track = pycolmap.Track([elements[row] for row in by_point[begin:end]])
        reconstruction.add_point3D(point, track)
        begin = end
    return reconstruction


def to_bal(reconstruction: pycolmap.Reconstruction, problem: bal.Bal) -> bal.Bal:
    """Return the problem with the refined numbers of what ``to_reconstruction`` made of it."""
    ids = range(1, len(problem.cameras) + 1)
    poses = [reconstruction.images[id_].cam_from_world() for id_ in ids]
    turned = bal.FLIP_FRAME[:, None] * np.array([pose.rotation.matrix() for pose in poses])
    cameras = np.empty_like(problem.cameras)
    cameras[:, :3] = bal.rotation_vectors(turned)
    cameras[:, 3:6] = bal.FLIP_FRAME * np.array([pose.translation for pose in poses])
    cameras[:, 6:] = [reconstruction.cameras[id_].params[[0, 3, 4]] for id_ in ids]
    points = reconstruction.points3D
    refined = np.array([points[index + 1].xyz for index in range(len(problem.points))])
    return dataclasses.replace(problem, cameras=cameras, points=refined)


def options(request: protocol.Request) -> pycolmap.BundleAdjustmentOptions:
    """Return pycolmap's defaults with everybody's stopping rule and threads."""
    chosen = pycolmap.BundleAdjustmentOptions()
    chosen.print_summary = False
    chosen.refine_focal_length = True
    chosen.refine_extra_params = True
    chosen.refine_principal_point = False
    # Below this number of residuals COLMAP drops to one thread.
    chosen.ceres.min_num_residuals_for_cpu_multi_threading = 0
    chosen.ceres.auto_select_solver_type = request.solver == "auto"
    solver: Any = chosen.ceres.solver_options
    if request.solver != "auto":
        solver.linear_solver_type = SOLVER_TYPES[request.solver]
        if request.solver == "iterative-schur":
            solver.preconditioner_type = "SCHUR_JACOBI"
    solver.num_threads = request.threads
    solver.max_num_iterations = request.max_num_iterations
    solver.function_tolerance = request.function_tolerance
    solver.gradient_tolerance = request.gradient_tolerance
    solver.parameter_tolerance = request.parameter_tolerance
    return chosen


def adjuster(
    reconstruction: pycolmap.Reconstruction,
    chosen: pycolmap.BundleAdjustmentOptions,
    gauge: str,
) -> Any:
    """Return pycolmap's adjuster of all registered images."""
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in reconstruction.reg_image_ids():
        config.add_image(image_id)
    config.fix_gauge(getattr(pycolmap.BundleAdjustmentGauge, gauge))
    return pycolmap.create_default_ceres_bundle_adjuster(chosen, config, reconstruction)


@contextmanager
def _standard_output_in(path: Path) -> Iterator[None]:
    """Send what C++ prints to a file."""
    saved = os.dup(1)
    with path.open("wb") as file:
        os.dup2(file.fileno(), 1)
    try:
        yield
    finally:
        os.dup2(saved, 1)
        os.close(saved)


def run(request: protocol.Request) -> protocol.Outcome:
    """Load, build and solve, timing each."""
    start = time.perf_counter()
    problem = bal.read(request.path) if request.kind == "bal" else None
    if problem is None:
        reconstruction = pycolmap.Reconstruction(request.path)
    else:
        reconstruction = to_reconstruction(problem)
    loaded = time.perf_counter()
    chosen = options(request)
    solver: Any = chosen.ceres.solver_options
    solver.minimizer_progress_to_stdout = True
    solver.logging_type = "PER_MINIMIZER_ITERATION"
    gauge = "TWO_CAMS_FROM_WORLD" if problem is None else "UNSPECIFIED"
    prepared = adjuster(reconstruction, chosen, gauge)
    built = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "progress"
        with _standard_output_in(log):
            answer = prepared.solve()
        solved = time.perf_counter()
        printed = log.read_text()
    memory = protocol.peak_memory()
    summary = answer.ceres_summary
    if problem is None:
        verified = colmap.cost(reconstruction)
    else:
        verified = bal.cost(to_bal(reconstruction, problem))
    return protocol.Outcome(
        load=loaded - start,
        build=built - loaded,
        solve=solved - built,
        minimizer=summary.minimizer_time_in_seconds,
        num_steps=summary.num_linear_solves,
        trace=[
            (built - loaded + seconds, cost)
            for seconds, cost in ceres_log.iterations(printed, summary.final_cost)
        ],
        initial_cost=summary.initial_cost,
        final_cost=summary.final_cost,
        termination=summary.termination_type.name,
        verified_cost=verified,
        peak_memory=memory,
        notes=[summary.linear_solver_type_used.name, summary.schur_structure_used],
        versions={"pycolmap": pycolmap.__version__, "pycolmap's Ceres": pycolmap.__ceres_version__},
    )


if __name__ == "__main__":
    protocol.main(run)
