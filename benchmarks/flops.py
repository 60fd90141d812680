"""The least arithmetic of a Levenberg-Marquardt step, and what these cores can do at best.

Counted are multiplications and additions of the formulas, a division or a square root as one, for
the merged camera block of BAL (6 of the pose, f, k1, k2) and points eliminated first. Symmetric
matrices are counted by half. Nothing is counted twice: no recomputation, no scaling, no second
evaluation of a Jacobian, and of the reduced system only a dense factorisation, where one is used.
What a sparse factorisation or conjugate gradients add is left out: there the share of the limit
that a solver is said to reach is lower than it is.

`python -m benchmarks.flops THREADS` prints the GFLOP/s of DGEMM.
"""

from __future__ import annotations

import sys
import time

CAMERA, POINT, RESIDUAL = 9, 3, 2

# Point into the camera's frame (18), perspective division (3), radial polynomial (6), scale (4),
# measurement (2).
_PROJECTION = 33
# By the point in the camera's frame, 2 x 3: radial derivative and the scale of both rows (25).
# Times R for the world's point (2 x 3 x 5) and times the derivative of a rotated point (2 x 3 x 3);
# by f, k1 and k2 (2 x 3 + 2). By the translation it is the first of these.
_JACOBIAN = 25 + 30 + 18 + 8
# A row's product of n numbers costs 2 n - 1 within an entry and one more to add it up.
_PRODUCT = 2 * RESIDUAL


def per_observation() -> int:
    """Return the flops of an observation, whatever its track."""
    half_camera, half_point = CAMERA * (CAMERA + 1) // 2, POINT * (POINT + 1) // 2
    normal_matrices = (half_camera + half_point) * _PRODUCT + CAMERA * POINT * (_PRODUCT - 1)
    gradients = (CAMERA + POINT) * _PRODUCT
    # Y = W V^-1; its own block of S, and its part of the right side.
    eliminated = CAMERA * POINT * (2 * POINT - 1)
    own_block = half_camera * 2 * POINT + CAMERA * 2 * POINT
    back_substitution = CAMERA * POINT * 2
    # J times the step for the model's change of cost, and the cost of the new point.
    model = RESIDUAL * (CAMERA + POINT) * 2 + 2 * RESIDUAL
    new_cost = _PROJECTION + 2 * RESIDUAL
    linearisation = _PROJECTION + _JACOBIAN + 2 * RESIDUAL
    return (
        linearisation
        + normal_matrices
        + gradients
        + eliminated
        + own_block
        + back_substitution
        + model
        + new_cost
    )


def per_camera_pair() -> int:
    """Return the flops of two observations of one point: Y_i W_j^T taken off a block of S."""
    return CAMERA * CAMERA * 2 * POINT


def per_point() -> int:
    """Return the flops of a point: damping, V^-1 by cofactors, its share of the step."""
    return 3 + 40 + 15


def dense_factorisation(num_images: int) -> int:
    """Return the flops of Cholesky and two triangular solves of the reduced camera system."""
    size = CAMERA * num_images
    return size**3 // 3 + 2 * size**2


def per_step(size: dict[str, int], dense: bool) -> int:
    """Return the flops of a step on a BAL problem; ``size`` is protocol.Outcome.size."""
    eliminated = (
        size["observations"] * per_observation()
        + size["camera_pairs"] * per_camera_pair()
        + size["points"] * per_point()
    )
    return eliminated + (dense_factorisation(size["images"]) if dense else 0)


def measure_peak(repeats: int = 7, size: int = 2000) -> float:
    """Return the best rate of NumPy's DGEMM in flops a second."""
    import numpy as np

    rng = np.random.default_rng(0)
    left, right = rng.random((2, size, size))
    out = np.empty_like(left)
    best = float("inf")
    for _ in range(repeats):
        start = time.perf_counter()
        np.matmul(left, right, out=out)
        best = min(best, time.perf_counter() - start)
    return 2.0 * size**3 / best


if __name__ == "__main__":
    from benchmarks.runners import protocol

    protocol.pin(int(sys.argv[1]))
    print(measure_peak())
