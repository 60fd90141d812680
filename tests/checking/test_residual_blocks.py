"""Sample points around the given one, and the blocks of columns."""

import numpy as np
import pytest

from bundle.checking.jacobians import ModelCheck
from bundle.checking.residual_blocks import Manifold, sample
from bundle.model.cameras import camera_models


@pytest.mark.parametrize(
    ("start", "sizes"),
    [
        ([1e-6, 0.0, 200.0], [1e-6, 1e-6, 200.0]),  # a zero moves as the smallest other number
        ([50.0, 0.0, -7.0], [50.0, 1.0, 7.0]),  # but at most by 1
        ([0.0, 0.0, 0.0], [1.0, 1.0, 1.0]),
    ],
)
def test_samples_are_relative_to_each_parameter(start, sizes):
    rng = np.random.default_rng(0)
    manifold = Manifold.parse(None, 3)
    moves = [sample(manifold, np.array(start), 0.1, rng) - start for _ in range(2000)]
    assert np.std(moves, axis=0) == pytest.approx(0.1 * np.array(sizes), rel=0.1)


def test_a_constant_entry_of_a_subset_does_not_move():
    rng = np.random.default_rng(0)
    moved = sample(Manifold.parse(("subset", [1]), 3), np.array([1.0, 2.0, 3.0]), 0.1, rng)
    assert (moved != [1.0, 2.0, 3.0]).tolist() == [True, False, True]


@pytest.mark.parametrize(
    ("manifold", "size", "tangent", "expected"),
    [
        (None, 3, True, [("b", 5, 8, "")]),
        ("angle_axis", 3, True, [("b", 5, 8, "vector")]),
        ("quaternion_wxyz", 4, True, [("b", 5, 8, "tangent")]),
        ("quaternion_xyzw", 4, False, [("b", 5, 9, "quaternion")]),
        ("sphere", 3, True, [("b", 5, 7, "")]),
        (
            "se3", 7, True,
            [("b rotation", 5, 8, "tangent"), ("b translation", 8, 11, ""), ("b", 5, 11, "")],
        ),
        (
            "se3", 7, False,
            [("b rotation", 5, 9, "quaternion"), ("b translation", 9, 12, ""), ("b", 5, 12, "")],
        ),
    ],
)  # fmt: skip
def test_the_parts_of_a_block_come_before_the_whole(manifold, size, tangent, expected):
    blocks = Manifold.parse(manifold, size).blocks("b", 5, tangent=tangent)
    assert [(one.name, one.start, one.stop, one.rotation) for one in blocks] == expected


@pytest.mark.parametrize("rolls", [False, True])
@pytest.mark.parametrize("model", ["SIMPLE_PINHOLE", "OPENCV", "EQUIRECTANGULAR"])
def test_the_blocks_of_a_camera_model_are_its_groups_of_columns(model, rolls):
    check = ModelCheck.make(model, 1e-7, rolls=rolls)
    names = [column.name for column in check.tally.columns]
    params = [f"{model} {name}" for name in camera_models()[model]]
    twist = [name for name in names if name.startswith("twist")]
    assert len(twist) == 6 * rolls and len(names) == 9 + len(params) + len(twist)
    expected = {"rotation": names[:3], "translation": names[3:6], "pose": names[:6]}
    expected |= {f"{model} parameters": params, "point": ["point x", "point y", "point z"]}
    expected |= {"twist": twist} if rolls else {}
    assert {block.name: names[block.start : block.stop] for block in check.blocks} == expected
