"""Residuals in single precision, as a whole or inside: right ones pass, mistakes are found."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bundle.checking.classify import rounds_to_single
from tests.checking.reprojection import check_few

FOCAL = 500.0


def camera(rng, depth):
    """Rotation vector, translation and point, at a depth."""
    turn, point = rng.normal(0, 1, 3), rng.normal(0, 2, 3)
    seen = depth * np.array([*rng.uniform(-0.4, 0.4, 2), 1])
    return [turn, seen - Rotation.from_rotvec(turn).apply(point), point]


def project(rotation, blocks):
    """Pixels in single precision, and their Jacobians by translation and point in double."""
    _, translation, point = blocks
    matrix = rotation.astype(np.float32)
    x, y, z = matrix @ point.astype(np.float32) + translation.astype(np.float32)
    pixels = np.float32(FOCAL) * np.array([x, y]) / z
    x, y, z = rotation @ point + translation
    by_seen = FOCAL / z * np.array([[1, 0, -x / z], [0, 1, -y / z]])
    return pixels, [by_seen, by_seen @ rotation]


@pytest.mark.parametrize("depth", [3.0, 10.0, 30.0])
@pytest.mark.parametrize("seed", range(4))
def test_a_projection_in_single_precision_is_right(depth, seed):
    """Large numbers cancel in it: its rounding is that of its parameters, not of its size."""
    blocks = camera(np.random.default_rng(seed), depth)
    rotation = Rotation.from_rotvec(blocks[0]).as_matrix()

    def function(moved, factor=1.0):
        pixels, (by_translation, by_point) = project(rotation, [blocks[0], *moved])
        return pixels, [by_translation, by_point * [factor, 1, 1]]

    report = check_few(function, blocks[1:], seed=seed)
    assert report.verdict == "correct", report
    report = check_few(lambda b: function(b, 1.01), blocks[1:], seed=seed)
    assert report.verdict == "wrong"


def mixed(blocks, factor=1.0):
    """A sine in single precision times a number in double precision."""
    x, y = blocks
    sine = np.sin(x.astype(np.float32)).astype(float)
    return sine * y - 0.3, [np.diag(np.cos(x) * y), factor * np.diag(np.sin(x))]


def test_a_number_in_single_precision_inside_is_no_mistake():
    verdicts = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        start = [rng.uniform(0.5, 1.2, 2), rng.uniform(1, 10, 2)]
        verdicts.append(check_few(mixed, start, seed=seed).verdict)
        wrong = check_few(lambda b: mixed(b, 1.001), start, seed=seed)
        assert [(f.kind, f.columns) for f in wrong.findings if f.kind != "undecided"] == [
            ("factor", ("block 1 [0]", "block 1 [1]"))
        ]
    assert "wrong" not in verdicts
    assert verdicts.count("correct") >= 8


def test_only_a_parameter_that_is_rounded_is_single():
    point = [np.array([0.3, 1.7]), np.array([0.0, -2e5])]
    assert rounds_to_single(lambda b: np.sin(b[1].astype(np.float32)), point)
    assert rounds_to_single(lambda b: b[0][::-1].astype(np.float32) + b[1], point)
    for function in (
        lambda b: np.append(b[0], b[1]),
        lambda b: b[0] * 0 + 5.0,
        lambda b: (b[0] + 4e5) - 4e5,
        lambda b: (b[0] + 2.0**28) - 2.0**28,  # half as coarse, and twice as coarse
        lambda b: (b[0] + 2.0**30) - 2.0**30,
        lambda b: np.round(b[0], 7),
        lambda b: b[0].astype(np.float16),
    ):
        assert not rounds_to_single(function, point)


def test_large_constants_leave_the_tolerance_of_double_precision():
    def function(blocks, factor=1.0):
        (x, y) = blocks[0]
        return np.array([x * y + 1e3, y]), [np.array([[factor * y, x], [0, 1.0]])]

    start = [np.array([1.5, -2.5])]
    assert check_few(function, start)
    assert check_few(lambda b: function(b, 1 + 1e-5), start).verdict == "wrong"
