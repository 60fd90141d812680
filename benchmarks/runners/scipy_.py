"""scipy.optimize.least_squares as SciPy's cookbook uses it for bundle adjustment.

Trust Region Reflective, finite differences grouped by the sparsity of the Jacobian, LSMR for the
step, variables scaled by the Jacobian's columns. Residuals are vectorised NumPy (bal.residuals).
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import scipy.optimize
import scipy.sparse
from numpy.typing import NDArray

from benchmarks import bal
from benchmarks.runners import protocol

TERMINATIONS = {0: "NO_CONVERGENCE", 1: "CONVERGENCE", 2: "CONVERGENCE", 3: "CONVERGENCE"}


def sparsity(problem: bal.Bal) -> Any:
    """Return the pattern of the Jacobian: 9 columns of the camera and 3 of the point a residual."""
    num_observations = len(problem.xy)
    cameras = 9 * problem.camera_index[:, None] + np.arange(9)
    points = problem.cameras.size + 3 * problem.point_index[:, None] + np.arange(3)
    columns = np.repeat(np.hstack([cameras, points]), 2, axis=0)
    rows = np.repeat(np.arange(2 * num_observations), 12)
    pattern = (np.ones(rows.size, dtype=np.int8), (rows, columns.ravel()))
    shape = (2 * num_observations, problem.cameras.size + problem.points.size)
    return scipy.sparse.coo_matrix(pattern, shape=shape).tocsr()


def _unpacked(parameters: NDArray[np.float64], problem: bal.Bal) -> bal.Bal:
    split = problem.cameras.size
    return bal.Bal(
        problem.camera_index,
        problem.point_index,
        problem.xy,
        parameters[:split].reshape(-1, 9),
        parameters[split:].reshape(-1, 3),
    )


def run(request: protocol.Request) -> protocol.Outcome:
    """Load, build and solve, timing each; the trace has one entry an accepted step."""
    if request.kind != "bal":
        raise protocol.NotApplicableError("this runner knows BAL's camera only")
    start = time.perf_counter()
    problem = bal.read(request.path)
    loaded = time.perf_counter()
    pattern = sparsity(problem)
    parameters = np.concatenate([problem.cameras.ravel(), problem.points.ravel()])
    built = time.perf_counter()
    initial_cost = bal.cost(problem)
    trace = [(built - loaded, initial_cost)]

    def record(intermediate_result: Any) -> None:
        trace.append((time.perf_counter() - loaded, float(intermediate_result.cost)))

    answer = scipy.optimize.least_squares(
        lambda values: bal.residuals(_unpacked(values, problem)).ravel(),
        parameters,
        jac_sparsity=pattern,
        method="trf",
        tr_solver="lsmr",
        x_scale="jac",
        ftol=request.function_tolerance,
        gtol=request.gradient_tolerance,
        xtol=request.parameter_tolerance,
        max_nfev=1 + request.max_num_iterations,
        callback=record,
    )
    solved = time.perf_counter()
    memory = protocol.peak_memory()
    return protocol.Outcome(
        load=loaded - start,
        build=built - loaded,
        solve=solved - built,
        minimizer=solved - built,
        num_steps=answer.nfev - 1,
        trace=trace,
        initial_cost=initial_cost,
        final_cost=float(answer.cost),
        termination=TERMINATIONS.get(answer.status, "FAILURE"),
        verified_cost=bal.cost(_unpacked(answer.x, problem)),
        peak_memory=memory,
        notes=["TRF", "LSMR"],
        versions={"scipy": scipy.__version__, "numpy": np.__version__},
    )


if __name__ == "__main__":
    protocol.main(run)
