"""One run of ``benchmarks.practitioners``: reads a request, writes an answer, both JSON files.

Who "start" moves a model to its positions, for the others: "model" and "positions.json" in the
folder of the request.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.practitioners import OURS, SIGMA
from benchmarks.runners import protocol

STOPPING = (
    "max_num_iterations",
    "function_tolerance",
    "gradient_tolerance",
    "parameter_tolerance",
)
FILTERS = 7


def start(request: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Write the model in metres east, north, up, and the positions."""
    import bundle

    problem = bundle.load(request["path"])
    geodetic = json.loads((Path(request["path"]).parent / "lla.json").read_text())
    frame = bundle.georeference.LocalFrame.about(list(geodetic.values()))
    positions = dict(zip(geodetic, frame.to_enu(list(geodetic.values())).tolist(), strict=True))
    priors = [bundle.PositionPrior(name, xyz, SIGMA) for name, xyz in positions.items()]
    moved = bundle.solve(problem, priors=priors, align=True, max_num_iterations=0)
    bundle.save(disturbed(moved.problem), folder / "model", "colmap")
    (folder / "positions.json").write_text(json.dumps(positions))
    return {}


def disturbed(problem: Any) -> Any:
    """Return a problem with errors to be refined away: the models have been refined before."""
    rng = np.random.default_rng(1)
    depth = np.median(np.linalg.norm(problem.points - problem.projection_centers.mean(0), axis=1))
    poses = problem.cam_from_world.copy()
    poses[:, :3] += 1e-3 * rng.standard_normal((problem.num_images, 3))
    poses[:, 4:] += 2e-3 * depth * rng.standard_normal((problem.num_images, 3))
    points = problem.points + 5e-3 * depth * rng.standard_normal(problem.points.shape)
    return problem.replace(cam_from_world=poses, points=points)


def ours(request: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Solve by bundle."""
    import bundle

    options: dict[str, Any] = {name: request[name] for name in STOPPING}
    options |= {"num_threads": request["threads"], "cheirality": "zero", "convergence": "ceres"}
    what = request["what"]
    problem = bundle.load(folder / "model" if what == "priors" else request["path"])
    if what == "priors":
        positions = json.loads((folder / "positions.json").read_text())
        priors = [bundle.PositionPrior(name, xyz, SIGMA) for name, xyz in positions.items()]
        options |= {"priors": priors, "align": False}
    else:
        options["gauge"] = "none"
        if what == "filter":
            problem = disturbed(problem)
    time.sleep(protocol.SETTLE)
    begun = time.perf_counter()
    result = bundle.solve(problem, **options)
    total = time.perf_counter() - begun
    summary = result.summary
    answer = {
        "step": summary.minimizer_time_in_seconds / summary.num_linear_solves,
        "num_steps": summary.num_linear_solves,
        "total": total,
        "initial_cost": summary.initial_cost,
        "cost": summary.final_cost,
    }
    if what == "filter":
        times = []
        for _ in range(FILTERS):
            # Arrays of its own, as after every round.
            solved = result.problem.replace(points=np.array(result.problem.points))
            begun = time.perf_counter()
            bundle.filter_observations(solved, num_threads=request["threads"])
            times.append(time.perf_counter() - begun)
        answer["filter"] = sorted(times)[FILTERS // 2]
    return answer


def theirs(request: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Solve by pycolmap."""
    import pycolmap

    what = request["what"]
    model = folder / "model" if what == "priors" else request["path"]
    reconstruction = pycolmap.Reconstruction(model)
    chosen = pycolmap.BundleAdjustmentOptions()
    chosen.print_summary = False
    chosen.refine_sensor_from_rig = False
    # Below this number of residuals COLMAP drops to one thread.
    chosen.ceres.min_num_residuals_for_cpu_multi_threading = 0
    solver: Any = chosen.ceres.solver_options
    solver.num_threads = request["threads"]
    for name in STOPPING:
        setattr(solver, name, request[name])
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in reconstruction.reg_image_ids():
        config.add_image(image_id)
    time.sleep(protocol.SETTLE)
    begun = time.perf_counter()
    if what == "priors":
        positions = json.loads((folder / "positions.json").read_text())
        adjuster: Any = pycolmap.create_pose_prior_ceres_bundle_adjuster(
            chosen,
            pycolmap.PosePriorBundleAdjustmentOptions(),
            config,
            _priors(reconstruction, positions),
            reconstruction,
        )
    else:
        config.fix_gauge(pycolmap.BundleAdjustmentGauge.UNSPECIFIED)
        adjuster = pycolmap.create_default_ceres_bundle_adjuster(chosen, config, reconstruction)
    summary = adjuster.solve().ceres_summary
    total = time.perf_counter() - begun
    return {
        "step": summary.minimizer_time_in_seconds / summary.num_linear_solves,
        "num_steps": summary.num_linear_solves,
        "total": total,
        "initial_cost": summary.initial_cost,
        "cost": summary.final_cost,
    }


def _priors(reconstruction: Any, positions: dict[str, list[float]]) -> list[Any]:
    import pycolmap

    priors = []
    for image in reconstruction.images.values():
        prior = pycolmap.PosePrior()
        prior.corr_data_id = image.data_id
        prior.position = np.array(positions[image.name])
        prior.position_covariance = SIGMA**2 * np.eye(3)
        prior.coordinate_system = pycolmap.PosePriorCoordinateSystem.CARTESIAN
        priors.append(prior)
    return priors


def main() -> None:
    """Answer the request; a failure is an answer too."""
    asked, answered = map(Path, sys.argv[1:3])
    request = json.loads(asked.read_text())
    protocol.pin(request["threads"])
    run = {"start": start, OURS: ours}.get(request["who"], theirs)
    try:
        answer = {"failure": "", **run(request, Path(request["folder"]))}
    except Exception as error:  # a failed run is a row, not the end of the benchmark
        answer = {"failure": f"{type(error).__name__}: {error}".splitlines()[0]}
    answered.write_text(json.dumps(answer))


if __name__ == "__main__":
    main()
