"""Figures of the report page: what each describes is what its numbers say."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from bundle.figures.cost_figures import column_figure, iteration_figure
from bundle.figures.lens_figures import (
    distance_figure,
    focal_figure,
    lens_curve,
    lens_figure,
    sigma_figure,
)
from bundle.figures.marks import GREY, Dots, Ellipses, Line, Places, Vectors
from bundle.figures.placement_figures import placement, plan_figure, position_figure, target_figure
from bundle.figures.projection_uncertainty import projection_uncertainty
from bundle.figures.structure_figures import angle_figure, length_figure, track_statistics
from tests.figures.matplotlib.test_placement_numbers import RECORD
from tests.scenes import make_problem


@pytest.fixture(scope="module")
def problem():
    return make_problem(num_images=4, num_points=60, shared=True)


def marks(figure, kind):
    return [mark for mark in figure.marks if isinstance(mark, kind)]


def test_a_lens_before_a_solve_is_grey_and_dashed_and_has_no_band(problem):
    now = lens_curve(problem, 0, np.diag([1.0, 0.0, 0.0, 1e-6]))
    before = dataclasses.replace(now, distortion=now.distortion - 5.0)
    figure = lens_figure({"before": before, "after": now})
    first, second = marks(figure, Line)
    assert (first.label, first.colour, first.dash, first.sigma) == ("before", GREY, 1, None)
    assert (second.label, second.colour, second.dash) == ("after", 0, 0)
    np.testing.assert_array_equal(second.sigma, now.sigma)
    (places,) = marks(figure, Places)
    assert places.at == {"observed": now.observed_radius, "corner": now.corner_radius}
    assert figure.y.low <= first.y.min() and figure.y.high >= (second.y + second.sigma).max()
    unknown = dataclasses.replace(now, corner_radius=math.nan, observed_radius=math.nan)
    assert marks(lens_figure({"now": unknown}), Places)[0].at == {}


def test_the_plan_points_from_the_camera_to_the_measured_position(problem):
    place = placement(problem, RECORD)
    figure = plan_figure(place, problem.projection_centers)
    (lines,) = marks(figure, Vectors)
    factor = float(figure.note.split(", ")[1].split()[0])
    known = [i for i in place.images if np.isfinite([*i.residual[:2], *i.position]).all()]
    at = np.array([image.position[:2] for image in known])
    measured = at - np.array([image.residual[:2] for image in known])
    used = np.array([image.used for image in known])
    assert used.any()
    drawn = {tuple(start): step for start, step in zip(lines.at, lines.step, strict=True)}
    for start, end in zip(at[used], measured[used], strict=True):
        np.testing.assert_allclose(drawn[tuple(start)], factor * (end - start))


def test_errors_reach_no_farther_than_the_axes(problem):
    place = placement(problem, RECORD)
    for figure in (target_figure(place), position_figure(place)):
        (dots,) = marks(figure, Dots)
        assert np.abs(dots.xy).max() < figure.y.high
        assert len(dots.names) == len(dots.colours) == len(dots.xy)
    (moment,) = marks(position_figure(place), Ellipses)
    residuals = marks(position_figure(place), Dots)[0].xy
    np.testing.assert_allclose(moment.covariances[0], residuals.T @ residuals / len(residuals))
    nothing = dataclasses.replace(place, images=(), targets=())
    assert target_figure(nothing) is position_figure(nothing) is None
    assert plan_figure(nothing, problem.projection_centers) is None


def surveyed():
    """Three points with a position, one of them with a gross error, and one without."""
    places = ([0.0, 0.0, 5.0], [10.0, 0.0, 5.0], [0.0, 9.0, 5.0], [None] * 3)
    gcps = [
        {**point, "position_enu": at}
        for point, at in zip([*RECORD["gcps"], RECORD["gcps"][0]], places, strict=True)
    ]
    return {**RECORD, "gcps": gcps}


def test_the_plan_points_from_the_model_to_the_survey_and_says_the_error_of_height(problem):
    figure = plan_figure(placement(problem, surveyed()), problem.projection_centers)
    _, images, cameras, lines, points = figure.marks
    assert len(images.at) == len(cameras.xy) == 1 and len(points.xy) == 3
    assert points.names == ("a +0.300 m", "b", "c +2.000 m") and points.is_labelled
    assert points.colours == (0, 0, 1)
    np.testing.assert_allclose(points.xy, [[0.1, -0.2], [10.3, 0.2], [1.0, 11.0]])
    factor = float(figure.note.split(", ")[2].split()[0])
    np.testing.assert_allclose(lines.at + lines.step / factor, [[0, 0], [10, 0], [0, 9]])
    # The largest error that counts has 0.36 m: the gross one of 2.2 m does not hide it.
    height = figure.y.high - figure.y.low
    assert 0.03 < factor * math.hypot(0.3, 0.2) / height <= 0.1


def test_cameras_without_a_measured_position_are_drawn_beside_control_points(problem):
    alone = placement(problem, {**surveyed(), "gps": []})
    figure = plan_figure(alone, problem.projection_centers)
    np.testing.assert_array_equal(figure.marks[0].xy, problem.projection_centers[:, :2])
    assert "images" not in figure.note
    both = plan_figure(placement(problem, surveyed()), problem.projection_centers)
    assert len(both.marks[0].xy) == 0
    assert "check" not in plan_figure(placement(problem, RECORD), problem.projection_centers).note


def test_a_cost_that_hardly_falls_is_drawn_above_the_last_one():
    wide = iteration_figure(np.array([1e6, 1e3, 1.0]))
    assert wide.y.is_logarithmic and "log scale" in wide.y.label
    narrow = iteration_figure(np.array([200.0, 150.0, 100.0]))
    assert not narrow.y.is_logarithmic
    np.testing.assert_allclose(narrow.marks[0].y, [50.0, 25.0, 0.0])
    assert all(tick == int(tick) for tick in wide.x.ticks)


def test_sigmas_share_their_scale_at_all_distances(problem):
    known = projection_uncertainty(problem, 0, np.diag([4.0, np.nan, np.nan, 1e-6]))
    far, near = sigma_figure(known), sigma_figure(known, known.distance)
    both = np.stack([known.sigma(), known.sigma(known.distance)])
    assert far.marks[0].top == near.marks[0].top == pytest.approx(np.quantile(both, 0.98), rel=1e-5)
    np.testing.assert_array_equal(near.marks[0].values, known.sigma(known.distance))
    curves = distance_figure(known)
    for line, (label, values) in zip(curves.marks, known.by_distance().items(), strict=False):
        assert line.label == label
        np.testing.assert_array_equal(line.y, values)
    assert curves.marks[-1].at == {"median": known.distance}


def test_columns_cover_the_width_and_repeat_colours_dashed():
    figure = column_figure({f"order {k}": [3, 2, 1] for k in range(12)} | {"empty": []})
    assert len(figure.marks) == 12
    assert [mark.colour for mark in figure.marks] == [*range(10), 0, 1]
    assert [mark.dash for mark in figure.marks] == [0] * 10 + [1] * 2
    np.testing.assert_allclose(figure.marks[0].x, [0, 1 / 3, 2 / 3, 1])


def test_classes_of_tracks_are_named(problem):
    tracks = track_statistics(problem)
    for figure, counts in (
        (length_figure(tracks, 4), tracks.lengths),
        (angle_figure(tracks), tracks.angles),
    ):
        assert [*figure.marks[0].values.values()] == counts.tolist()
    names = [*length_figure(tracks, 4).marks[0].values]
    assert names[-1] == f"{len(tracks.lengths) - 1}"
    assert [*length_figure(tracks).marks[0].values][-1].endswith(" or more")


@pytest.mark.parametrize(("sigma", "reach"), [(0.1, 1.0), (8.0, 9.0), (math.nan, 1.0)])
def test_the_typical_bar_of_a_focal_length_is_inside(sigma, reach):
    """Four cameras that spread over 4 px; the focal length of the last is not determined."""
    values, sigmas = np.array([1000.0, 1002, 1004, 1001]), np.array([sigma, sigma, sigma, 1e4])
    figure = focal_figure(np.arange(4.0), {"f": values}, {"f": sigmas}, "")
    assert figure.y.low <= 1000 - reach and figure.y.high >= 1004 + reach
    assert figure.y.high - figure.y.low < 1100


def test_the_marks_of_several_lenses_are_those_of_all(problem):
    near = lens_curve(problem, 0)
    far = dataclasses.replace(near, corner_radius=near.corner_radius + 5)
    (places,) = marks(lens_figure({"camera 1": near, "camera 2": far}), Places)
    assert places.at == {"observed": near.observed_radius, "corner": far.corner_radius}


def test_a_lens_without_distortion_has_no_figure():
    problem = make_problem(model="PINHOLE", num_images=2, num_points=20, shared=True)
    curve = lens_curve(problem, 0, np.diag([1.0, 1.0, 4.0, 4.0]))
    assert lens_figure({"now": curve}) is None
    before = dataclasses.replace(curve, distortion=curve.distortion - 5.0)
    assert lens_figure({"before": before, "after": curve}) is not None
