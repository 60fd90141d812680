"""Sample points around the given one."""

import numpy as np
import pytest

from bundle.checking.residual_blocks import Manifold, sample


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
