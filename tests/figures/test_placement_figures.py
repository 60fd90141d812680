"""Dimensions of georeferenced blocks against those of the flight."""

import math

import numpy as np
import pytest

from bundle.figures.placement_figures import PlacedTarget, Placement, block
from bundle.georeference.similarity import Similarity, moved
from bundle.reports.page.model_sections import placement_sections
from tests.georeference.flights import flight


def test_the_block_has_the_dimensions_of_the_flight():
    """Nadir images at 60 m, 1500 px of focal length: 4 cm per pixel; the frame has 80 x 60 m."""
    truth = flight([], num_points=400).truth
    found = block(truth)
    assert found.height == pytest.approx(60, abs=1.5)
    assert found.ground_pixel == pytest.approx(0.04, rel=0.03)
    span = np.sort(np.ptp(truth.points[:, :2], axis=0))[::-1]
    np.testing.assert_allclose(found.extent, span, rtol=0.05)
    turn = np.array([[np.cos(0.5), -np.sin(0.5), 0], [np.sin(0.5), np.cos(0.5), 0], [0, 0, 1]])
    turned = block(moved(truth, Similarity(1.0, turn, np.array([9.0, 8.0, 7.0]))))
    np.testing.assert_allclose(turned.extent, found.extent, rtol=0.02)
    assert turned.ground_pixel == pytest.approx(found.ground_pixel)
    # Of a grid of 16 m, the frame around a point in the middle has most images.
    seen = [
        sum(
            abs(x - u) < 40 and abs(y - v) < 30 for u, v in truth.projection_centers[:, :2].tolist()
        )
        for x, y in truth.points[:, :2].tolist()
    ]
    assert found.overlap == pytest.approx(np.median(seen), abs=1.5)
    for word in ("m above", "cm per pixel", "images see"):
        assert word in found.sentence


def test_what_is_unknown_is_left_out():
    truth = flight([]).truth
    unsized = block(truth.replace(camera_sizes=np.zeros_like(truth.camera_sizes)))
    assert math.isnan(unsized.overlap) and "images see" not in unsized.sentence
    below = truth.points * [1, 1, -1] + [0, 0, 200]  # cameras under a ceiling
    assert "above" not in block(truth.replace(points=below)).sentence
    nothing = {
        "observation_image": [],
        "observation_point": [],
        "observation_xy": np.zeros((0, 2)),
        "observation_keypoint": [],
    }
    assert block(truth.replace(**nothing)) is None


def target(name, role, residual, left_out):
    triples = (np.array(one, float) for one in (residual, left_out, (0.02, 0.02, 0.02)))
    return PlacedTarget(name, role, 3, *triples, 0.5, False, np.full(3, np.nan))


def test_accuracy_comes_before_precision():
    place = Placement(None, (), (
        target("a", "control", (0.1, 0, 0), (0.3, 0.4, 1.0)),
        target("b", "check", (3, 4, 10), (3, 4, 10)),
    ))  # fmt: skip
    table, _ = placement_sections(place, flight([]).truth)[0].tables
    names = [row[0] for row in table.rows]
    assert names == ["check points", "control points, each left out", "control points"]
    # The 90 % quantiles of 200,000 errors with these RMS.
    rng = np.random.default_rng(0)
    plan = np.hypot(*(rng.normal(size=(2, 200_000)) * 5 / np.sqrt(2)))
    up = np.abs(rng.normal(size=200_000)) * 10
    np.testing.assert_allclose(
        [float(cell) for cell in table.rows[0][-2:]],
        [np.quantile(plan, 0.9), np.quantile(up, 0.9)],
        rtol=0.01,
    )


def test_a_shift_stands_beside_its_spread():
    ups = [0.10, 0.13, 0.16]
    checks = [target(f"c{k}", "check", (0, 0, up), (0, 0, up)) for k, up in enumerate(ups)]
    unknown = target("d", "check", (0, 0, math.nan), (0, 0, math.nan))
    place = Placement(None, (), (*checks, unknown, target("e", "control", (1, 1, 1), (2, 2, 2))))
    _, table = placement_sections(place, flight([]).truth)[0].tables
    assert table.rows[0] == ["check points", "4", "+0.0000 ± 0.0000", "+0.0000 ± 0.0000",
                             f"+{np.mean(ups):.4f} ± {np.std(ups, ddof=1):.4f}"]  # fmt: skip
    assert table.rows[1][0] == "control points, each left out" and set(table.rows[1][2:]) == {"-"}
