"""Cost of one image with a larger camera model for the elimination of all others.

Prints the ratio of the times to linearise and eliminate: 40 images with SIMPLE_RADIAL and one with
FULL_OPENCV against 41 with SIMPLE_RADIAL. Solves are interleaved, on one thread; of the times of
each, the least counts, as whatever else the machine does only adds to them.

Run: python -m benchmarks.mixed_models
"""

from __future__ import annotations

import numpy as np

import bundle


def with_full_opencv(problem: bundle.Problem, image: int) -> bundle.Problem:
    """Return the problem with one image's camera as FULL_OPENCV, its distortion the same."""
    camera = problem.image_camera[image]
    params = np.zeros((problem.num_cameras, 12))
    params[:, : problem.camera_params.shape[1]] = problem.camera_params
    focal, x, y, k = problem.camera_params[camera, :4]
    params[camera] = [focal, focal, x, y, k, *np.zeros(7)]
    models = list(problem.camera_models)
    models[camera] = "FULL_OPENCV"
    return problem.replace(camera_models=models, camera_params=params)


def step_time(problem: bundle.Problem) -> float:
    """Return the seconds of one linearisation and elimination."""
    summary = bundle.solve(
        problem,
        backend="fused",
        linear_solver_type="dense_schur",
        max_num_iterations=3,
        num_threads=1,
    ).summary
    return summary.jacobian_evaluation_time_in_seconds / summary.num_jacobian_evaluations


def main(repetitions: int = 40) -> None:
    """Print the least times and their ratio."""
    scene = bundle.synthesize(
        scene="street", num_images=41, num_points=3000, cameras="individual", seed=1
    )
    one = scene.problem
    problems = (one, with_full_opencv(one, 20))
    times: tuple[list[float], list[float]] = ([], [])
    for _ in range(repetitions):
        for problem, record in zip(problems, times, strict=True):
            record.append(step_time(problem))
    uniform, mixed = (min(record) for record in times)
    print(f"one width {1e3 * uniform:.2f} ms, mixed {1e3 * mixed:.2f} ms: {mixed / uniform:.2f}")


if __name__ == "__main__":
    main()
