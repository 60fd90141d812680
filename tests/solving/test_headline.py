"""Headline of a result: a start counts as a minimum only if a solve changes almost nothing."""

import numpy as np
import pytest

import bundle
from bundle.solving.headline import SMALLEST_DECREASE, headline


@pytest.fixture(scope="module")
def minimum():
    scene = bundle.synthesize(num_images=10, num_points=300, pixel_noise=0.4, seed=4)
    tight = {"function_tolerance": 1e-14, "max_num_iterations": 100}
    return bundle.solve(bundle.solve(scene.problem).problem, **tight).problem


@pytest.mark.parametrize(
    ("factor", "is_minimum"),
    [(0.0, True), (0.1, True), (5.0, False), (100.0, False)],
)
def test_a_start_above_the_minimum_is_not_at_it(minimum, factor, is_minimum):
    moves = np.random.default_rng(0).standard_normal(minimum.points.shape)
    cost = bundle.solve(minimum).summary.initial_cost

    def started(size):
        return minimum.replace(points=minimum.points + size * moves)

    probe = bundle.solve(started(1e-4)).summary.initial_cost / cost - 1  # quadratic in the size
    size = 1e-4 * np.sqrt(factor * SMALLEST_DECREASE / probe)
    result = bundle.solve(started(size))
    decrease = 1 - result.summary.final_cost / result.summary.initial_cost
    assert decrease == pytest.approx(factor * SMALLEST_DECREASE, rel=0.3, abs=1e-7)
    assert headline(result)[0].startswith("Already at its minimum") == is_minimum


@pytest.mark.parametrize(("left", "is_far"), [(None, False), (0.299, False), (0.301, True)])
def test_a_distance_from_the_minimum_is_said(minimum, left, is_far):
    result = bundle.solve(minimum)
    vars(result.summary)["largest_camera_step_in_sigmas"] = left
    sentences = headline(result)
    assert sentences[0].startswith("Already at its minimum") != is_far
    assert ("sigmas" in sentences[0]) == (left is not None and not is_far)
    assert any("0.3 standard deviations" in sentence for sentence in sentences) == is_far
