"""Dimensions of georeferenced blocks against those of the flight."""

import json
import math
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bundle import pictures
from bundle.figures.placement_figures import Placement, block, overlap_figure
from bundle.georeference.alignment_result import ControlPointError
from bundle.georeference.similarity import Similarity, moved
from bundle.reports.page.model_sections import placement_sections
from bundle.reports.page.svg import drawing
from bundle.reports.sections import dumps, plain
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
    # All frames of a grid of 16 m contain 128 x 108 m; one alone has 16 x 16 m at each corner.
    assert found.area == pytest.approx(128 * 108 - 4 * 16 * 16, rel=0.03)
    for word in ("m above", "cm per pixel", "1.28 ha of ground", "(5 in"):
        assert word in found.sentence


@pytest.mark.parametrize(("k", "off"), [(0.0, 0.2), (-0.15, 0.2), (-0.3, 0.3)])
def test_the_map_counts_the_frames_around_each_place_of_a_slope(k, off):
    """A lens with k < 0 folds: far outside its frame, places have pixels inside again.

    With k = -0.3, corners of the frame have no ray, and the map ends a little before the fold.
    """
    truth = flight([], num_points=2000).truth
    points = 2 * truth.points
    points[:, 2] = 0.2 * points[:, 0] + 0.1 * points[:, 1]
    turned = Rotation.from_euler("x", 180, degrees=True)  # without tilt
    poses = truth.cam_from_world.copy()
    poses[:, :4] = np.roll(turned.as_quat(), 1)
    poses[:, 4:] = -turned.apply(truth.projection_centers)
    params = np.array([[1500.0, 1000.0, 750.0, k]])
    problem = truth.replace(points=points, cam_from_world=poses, camera_params=params)
    found = block(problem)
    east, north = (
        axis.low + (np.arange(count) + 0.5) / count * (axis.high - axis.low)
        for axis, count in zip(found.axes, (37, 24), strict=True)
    )
    assert east[-1] > 150
    seen = np.zeros(found.images.shape)
    for u, v, height in problem.projection_centers.tolist():
        for row, y in enumerate(north[::-1]):
            x = east
            has_points = (np.abs(x) < 84) & (abs(y) < 84)
            depth = height - np.where(has_points, 0.2 * x + 0.1 * y, points[:, 2].mean())
            across, down = (x - u) / depth, (y - v) / depth
            squared = across**2 + down**2
            grown = 1 + k * squared
            inside = (np.abs(across * grown) < 1000 / 1500) & (np.abs(down * grown) < 0.5)
            seen[row] += inside & (1 + 3 * k * squared > 0)
    assert np.abs(found.images - seen).mean() < off and seen.max() == 16
    assert found.images.max() == pytest.approx(16, abs=1)
    far = seen == 0
    assert far.sum() > 300 and (found.images[far] > 1).mean() < 0.02
    x, y = (axis.high - axis.low for axis in found.axes)
    assert found.area == pytest.approx((seen > 1).mean() * x * y, rel=0.06)


def test_the_map_has_the_north_on_top_on_pages_and_in_pictures():
    truth = flight([], num_points=400).truth
    problem = truth.replace(points=truth.points * [1, 1, 0] + [0, 200, 0])
    dimensions = block(problem)  # cameras at the origin, and points in the north
    figure = overlap_figure(dimensions, problem.projection_centers)
    assert (figure.x, figure.y) == dimensions.axes
    south = dimensions.images[12:]
    assert south.sum() > 0.9 * dimensions.images.sum() > 0
    markup = drawing(figure)
    cells = re.findall(r'y="([\d.]+)"[^>]*fill-opacity="([\d.]+)"', markup)
    assert len(cells) == 24 * 37 and "16 images" in markup
    shown = np.array(cells, float)
    assert (shown[:, 1] * shown[:, 0]).sum() / shown[:, 1].sum() > 150  # down on the page
    _, axes = pictures.figure()
    pictures.draw_lines(axes[0, 0], figure)
    (image,) = axes[0, 0].images
    np.testing.assert_array_equal(image.get_array(), dimensions.images)
    assert image.origin == "upper" and image.get_extent()[2:] == [figure.y.low, figure.y.high]
    assert axes[0, 0].get_ylim() == (figure.y.low, figure.y.high)


def test_what_is_unknown_is_left_out():
    truth = flight([]).truth
    unsized = block(truth.replace(camera_sizes=np.zeros_like(truth.camera_sizes)))
    assert unsized.area == 0 and " ha" not in unsized.sentence
    assert overlap_figure(unsized, truth.projection_centers) is None
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
    sigma = (0.02, 0.02, 0.02)
    return ControlPointError(name, role, 3, residual, left_out, sigma, 0.5, (), False)


def test_accuracy_comes_before_precision():
    place = Placement(None, (), (
        target("a", "control", (0.1, 0, 0), (0.3, 0.4, 1.0)),
        target("b", "check", (3, 4, 10), (3, 4, 10)),
    ))  # fmt: skip
    rms, table = placement_sections(place, flight([]).truth)[0].tables
    names = [row[0] for row in rms.rows]
    assert names == ["check points", "control points, each left out", "control points"]
    # The 90 % quantiles of 200,000 errors with these RMS.
    rng = np.random.default_rng(0)
    plan = np.hypot(*(rng.normal(size=(2, 200_000)) * 5 / np.sqrt(2)))
    up = np.abs(rng.normal(size=200_000)) * 10
    assert table.head[4:6] == ("CE90 [m]", "LE90 [m]")
    np.testing.assert_allclose(
        [float(cell) for cell in table.rows[0][4:6]],
        [np.quantile(plan, 0.9), np.quantile(up, 0.9)],
        rtol=0.01,
    )
    assert table.rows[0][6:] == ["-", "-"]  # of one point


def test_relative_accuracy_is_that_of_differences_between_points():
    """A common shift of 3 m moves no point relative to another."""
    rng = np.random.default_rng(3)
    errors = rng.normal(size=(4000, 3)) * [0.02, 0.02, 0.05] + [3.0, -1.0, 2.0]
    checks = tuple(target(f"c{k}", "check", e, e) for k, e in enumerate(errors.tolist()))
    _, table = placement_sections(Placement(None, (), checks), flight([]).truth)[0].tables
    apart = (errors[::2] - errors[1::2]) / np.sqrt(2)
    expected = [np.quantile(np.hypot(*apart[:, :2].T), 0.9), np.quantile(np.abs(apart[:, 2]), 0.9)]
    np.testing.assert_allclose([float(cell) for cell in table.rows[0][6:]], expected, rtol=0.04)
    assert float(table.rows[0][4]) > 3.0


def test_a_shift_stands_beside_its_spread():
    ups = [0.10, 0.13, 0.16]
    checks = [target(f"c{k}", "check", (0, 0, up), (0, 0, up)) for k, up in enumerate(ups)]
    unknown = target("d", "check", (0, 0, math.nan), (0, 0, math.nan))
    place = Placement(None, (), (*checks, unknown, target("e", "control", (1, 1, 1), (2, 2, 2))))
    _, table = placement_sections(place, flight([]).truth)[0].tables
    assert table.rows[0][:4] == ["check points", "+0.0000 ± 0.0000", "+0.0000 ± 0.0000",
                                 f"+{np.mean(ups):.4f} ± {np.std(ups, ddof=1):.4f}"]  # fmt: skip
    assert table.rows[1][0] == "control points, each left out" and set(table.rows[1][1:4]) == {"-"}


@pytest.mark.parametrize(
    ("role", "suspect", "is_used"),
    [("control", False, True), ("check", True, False), ("unused", False, False)],
)
def test_a_point_is_read_as_it_was_written(role, suspect, is_used):
    nan = math.nan
    point = ControlPointError(
        "a", role, 2, (0.1, -0.2, nan), (nan,) * 3, (0.02, 0.03, nan), 0.5,
        (("x.jpg", 0.3, -0.4), ("y.jpg", 1.0, 2.0)), suspect, "", 0.25, (5.0, 6.0, nan),
    )  # fmt: skip
    read = ControlPointError.of(json.loads(dumps({"of": plain(point.asdict())}))["of"])
    assert repr(read) == repr(point)
    assert read.used is is_used
    without = {key: value for key, value in point.asdict().items() if key != "images"}
    assert ControlPointError.of(without).num_images == 0
