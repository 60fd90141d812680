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
    assert flops.per_observation(9) == pytest.approx(count(observation) + projections, rel=0.02)


def test_a_pair_of_images_is_a_block_of_the_reduced_system():
    rng = np.random.default_rng(1)
    y, w, block = counted(rng, 9, 3), counted(rng, 9, 3), counted(rng, 9, 9)
    assert flops.per_image_pair(9) == count(lambda: block - y @ w.T)


SIZE = {"images": 4, "points": 10, "observations": 30, "image_pairs": 25, "camera_columns": 3}


def test_a_step_is_the_sum_of_its_parts():
    size = {**SIZE, "cameras": 4}
    parts = 30 * flops.per_observation(9) + 25 * 486 + 10 * flops.per_point()
    assert flops.per_step(size, dense=False) == parts
    assert flops.per_step(size, dense=True) == parts + 36**3 // 3 + 2 * 36**2


def test_a_shared_camera_is_multiplied_once_per_point():
    shared = flops.per_step({**SIZE, "cameras": 1}, dense=False)
    per_image = flops.per_step({**SIZE, "cameras": 4}, dense=False)
    assert per_image - shared == 25 * (486 - 216) - 10 * 27 - 30 * 36


def test_the_limit_adds_the_time_of_bytes():
    size = {**SIZE, "cameras": 4}
    rates = {"dgemm": 1e9, "copy": 1e9}
    read = 30 * 42 + 10 * 144
    assert flops.limit(size, False, rates) == pytest.approx(
        1e-9 * (flops.per_step(size, dense=False) + read)
    )
    assert flops.bytes_per_step(size, True) == read + 24 * 36**2


def test_rates_are_work_per_time(monkeypatch):
    """The clock says 2 s and 4 s, then 1 s and 8 s: the best of each counts."""
    clock = iter(np.cumsum([0, 2, 0, 4, 0, 1, 0, 8]).tolist())
    monkeypatch.setattr(flops.time, "perf_counter", lambda: next(clock))
    rates = flops.measure_rates(repeats=2, size=20)
    assert rates == {"dgemm": 2 * 20**3 / 1, "copy": 2 * 8 * 16 * 1024 * 1024 / 4}
