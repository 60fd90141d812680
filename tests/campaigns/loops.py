"""A drive of 1000 images that has drifted: bundle adjustment alone, and with its loops closed.

Prints the RMS distance of the cameras from the truth after the best similarity, and the RMSE. Some
points end near the plane of a camera, so bundle adjustment takes a Cauchy loss at 2 px and two
rounds of filtering, each time. The share of the observations that is left stands beside.

python -m tests.campaigns.loops [IMAGES POINTS]
"""

from __future__ import annotations

import sys
from time import perf_counter

import bundle
from bundle.model.residuals import reprojection_error
from tests.graphs.loops.drift import ate, closures_of, drifted_street, pairs_along

ROBUST = {"loss": "cauchy", "loss_scale": 2.0, "max_num_iterations": 100, "num_rounds": 2}


def run(num_images: int, num_points: int) -> dict[str, tuple[float, float, float]]:
    """Distance in metres, RMSE in pixels and share of the observations, of each way."""
    truth, model, scales = drifted_street(num_images, num_points, degrees=0.01, growth=0.0003)
    closures = closures_of(truth, scales, pairs=pairs_along(truth, 5))
    begun = perf_counter()
    closed = bundle.close_loops(model, closures)
    print(f"{closed.num_used} used, {closed.num_rejected} rejected, {perf_counter() - begun:.0f} s")
    problems = {
        "drifted": model,
        "bundle adjustment alone": bundle.solve_rounds(model, **ROBUST).problem,
        "loops closed": closed.problem,
        "then bundle adjustment": bundle.solve_rounds(
            closed.problem, factors=closed.factors, **ROBUST
        ).problem,
        "from the truth": bundle.solve_rounds(truth, **ROBUST).problem,
    }
    return {
        name: (
            ate(problem, truth),
            reprojection_error(problem).rmse,
            problem.num_observations / truth.num_observations,
        )
        for name, problem in problems.items()
    }


if __name__ == "__main__":
    sizes = [int(word) for word in sys.argv[1:3]] or [1000, 40000]
    for name, (distance, rmse, share) in run(*sizes).items():
        print(f"{name:24} {distance:9.4f} m {rmse:14.4f} px {share:7.2%}")
