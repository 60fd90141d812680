from __future__ import annotations

import numpy as np
import pytest

from benchmarks import flops


class Counted:
    """A number that counts what is done to it."""

    operations = 0

    def __init__(self, value):
        self.value = value

    def __mul__(self, other):
        Counted.operations += 1
        return Counted(self.value * other.value)

    def __add__(self, other):
        Counted.operations += 1
        return Counted(self.value + other.value)

    def __sub__(self, other):
        Counted.operations += 1
        return Counted(self.value - other.value)


def counted(rng, *shape):
    return np.vectorize(Counted, otypes=[object])(rng.normal(size=shape))


def count(action):
    Counted.operations = 0
    action()
    return Counted.operations


def upper(rows, columns, add_to):
    """Add the upper triangle of rows @ columns to a matrix."""
    for i in range(len(rows)):
        for j in range(i, len(rows)):
            add_to[i, j] = add_to[i, j] + rows[i] @ columns[:, j]


def test_the_products_of_an_observation_are_counted_as_they_are_done():
    rng = np.random.default_rng(0)
    camera, point, residual = counted(rng, 2, 9), counted(rng, 2, 3), counted(rng, 2)
    u, v, s = counted(rng, 9, 9), counted(rng, 3, 3), counted(rng, 9, 9)
    g_camera, g_point, b = counted(rng, 9), counted(rng, 3), counted(rng, 9)
    inverse, step_camera, step_point = counted(rng, 3, 3), counted(rng, 9), counted(rng, 3)
    w, y = counted(rng, 9, 3), counted(rng, 9, 3)

    def observation():
        upper(camera.T, camera, u)
        upper(point.T, point, v)
        camera.T @ point
        g_camera + camera.T @ residual
        g_point + point.T @ residual
        w @ inverse
        upper(y, w.T, s)
        b - y @ g_point
        g_point - w.T @ step_camera
        change = camera @ step_camera + point @ step_point
        total = Counted(0.0) + change @ residual
        total + change @ change

    projections = 2 * (33 + 4) + 81  # twice the residual, once its derivatives
    # The model's change of cost is counted to within a handful.
    assert flops.per_observation() == pytest.approx(count(observation) + projections, rel=0.02)


def test_a_pair_of_cameras_is_a_block_of_the_reduced_system():
    rng = np.random.default_rng(1)
    y, w, block = counted(rng, 9, 3), counted(rng, 9, 3), counted(rng, 9, 9)
    assert flops.per_camera_pair() == count(lambda: block - y @ w.T)


def test_a_step_is_the_sum_of_its_parts():
    size = {"images": 4, "points": 10, "observations": 30, "camera_pairs": 25}
    parts = 30 * flops.per_observation() + 25 * 486 + 10 * flops.per_point()
    assert flops.per_step(size, dense=False) == parts
    assert flops.per_step(size, dense=True) == parts + 36**3 // 3 + 2 * 36**2


def test_dgemm_is_faster_than_a_loop_in_python():
    assert flops.measure_peak(repeats=1, size=200) > 1e8
