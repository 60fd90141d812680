"""The least time of a Levenberg-Marquardt step: its arithmetic and its bytes at these cores' rates.

Counted are multiplications and additions of the formulas, a division or a square root as one, with
points eliminated first. Symmetric matrices are counted by half. Nothing is counted twice: no
recomputation, no scaling, no second evaluation of a Jacobian. The parameters of a camera that
images share are summed per point before its pairs, which then have the 6 columns of a pose. The
projection is counted as BAL's, the shortest of the camera models. Of the reduced system only a
dense factorisation is counted, where one is used; what a sparse factorisation or conjugate
gradients add is left out: there a solver's share of the limit is higher than the table says.

Bytes are those of a solver that reads each observation twice (image and measurement, 20 bytes, and
2 of an index), each point four times and writes it twice, and writes and reads a dense S.

`python -m benchmarks.flops THREADS` prints the flops a second of DGEMM and the bytes a second of a
copy.
"""

from __future__ import annotations

import sys
import time

POSE, POINT, RESIDUAL = 6, 3, 2
POINT_BYTES = 24

# Point into the camera's frame (18), perspective division (3), radial polynomial (6), scale (4),
# measurement (2).
_PROJECTION = 33
# By the point in the camera's frame, 2 x 3: radial derivative and the scale of both rows (25).
# Times R for the world's point (2 x 3 x 5) and times the derivative of a rotated point (2 x 3 x 3);
# by f, k1 and k2 (2 x 3 + 2). By the translation it is the first of these.
_JACOBIAN = 25 + 30 + 18 + 8
# A row's product of n numbers costs 2 n - 1 within an entry and one more to add it up.
_PRODUCT = 2 * RESIDUAL


def per_observation(columns: int) -> int:
    """Return the flops of an observation with ``columns`` camera parameters, whatever its track."""
    half_camera, half_point = columns * (columns + 1) // 2, POINT * (POINT + 1) // 2
    normal_matrices = (half_camera + half_point) * _PRODUCT + columns * POINT * (_PRODUCT - 1)
    gradients = (columns + POINT) * _PRODUCT
    # Y = W V^-1; its own block of S, and its part of the right side.
    eliminated = columns * POINT * (2 * POINT - 1)
    own_block = half_camera * 2 * POINT + columns * 2 * POINT
    back_substitution = columns * POINT * 2
    # J times the step for the model's change of cost, and the cost of the new point.
    model = RESIDUAL * (columns + POINT) * 2 + 2 * RESIDUAL
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


def per_image_pair(columns: int) -> int:
    """Return the flops of two observations of one point: Y_i W_j^T taken off a block of S."""
    return columns * columns * 2 * POINT


def per_point() -> int:
    """Return the flops of a point: damping, V^-1 by cofactors, its share of the step."""
    return 3 + 40 + 15


def unknowns(size: dict[str, int]) -> int:
    """Return the columns of the reduced system; ``size`` is protocol.Outcome.size."""
    return POSE * size["images"] + size["camera_columns"] * size["cameras"]


def per_step(size: dict[str, int], dense: bool) -> int:
    """Return the flops of a step."""
    of_camera = size["camera_columns"]
    is_shared = size["cameras"] < size["images"]
    pairs = size["image_pairs"] * per_image_pair(POSE if is_shared else POSE + of_camera)
    eliminated = (
        size["observations"] * per_observation(POSE + of_camera) + size["points"] * per_point()
    )
    if is_shared:
        eliminated += size["points"] * of_camera**2 * POINT
        eliminated += size["observations"] * 2 * POSE * of_camera
    n = unknowns(size)
    return eliminated + pairs + ((n**3 // 3 + 2 * n**2) if dense else 0)


def bytes_per_step(size: dict[str, int], dense: bool) -> int:
    """Return the bytes that a step reads and writes."""
    return (
        size["observations"] * (2 * 20 + 2)
        + size["points"] * 6 * POINT_BYTES
        + (3 * 8 * unknowns(size) ** 2 if dense else 0)
    )


def limit(size: dict[str, int], dense: bool, rates: dict[str, float]) -> float:
    """Return the least seconds of a step at the rates of :func:`measure_rates`."""
    return per_step(size, dense) / rates["dgemm"] + bytes_per_step(size, dense) / rates["copy"]


def measure_rates(repeats: int = 7, size: int = 2000) -> dict[str, float]:
    """Return the best rates of NumPy's DGEMM, flops a second, and of copies, bytes a second."""
    import numpy as np

    rng = np.random.default_rng(0)
    left, right = rng.random((2, size, size))
    out = np.empty_like(left)
    source = rng.random(16 * 1024 * 1024)
    target = np.empty_like(source)
    multiply, copy = float("inf"), float("inf")
    for _ in range(repeats):
        start = time.perf_counter()
        np.matmul(left, right, out=out)
        multiply = min(multiply, time.perf_counter() - start)
        start = time.perf_counter()
        np.copyto(target, source)
        copy = min(copy, time.perf_counter() - start)
    return {"dgemm": 2.0 * size**3 / multiply, "copy": 2.0 * source.nbytes / copy}


if __name__ == "__main__":
    import json

    from benchmarks.runners import protocol

    protocol.pin(int(sys.argv[1]))
    print(json.dumps(measure_rates()))
