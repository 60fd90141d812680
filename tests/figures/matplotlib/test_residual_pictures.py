"""Figures of the report page on Matplotlib's axes: what is drawn is what the numbers say."""

import matplotlib
import numpy as np
import pytest

from bundle import InputError, figures, pictures
from tests.scenes import make_problem

matplotlib.use("agg")


@pytest.fixture(scope="module")
def numbers():
    problem = make_problem(num_images=6, num_points=200, shared=True)
    found = figures.residuals(problem)
    (field,) = figures.residual_fields(problem, found)
    return {
        "problem": problem,
        "found": found,
        "field": field,
        "histogram": figures.residual_histogram({"before": found, "after": found}),
        "tracks": figures.track_statistics(problem),
        "image": figures.worst_residuals(problem, found)[0],
    }


def drawn(function, *arguments):
    made, axes = pictures.figure()
    function(axes[0, 0], *arguments)
    made.canvas.draw()
    return axes[0, 0]


def test_cells_and_vectors_are_those_of_the_field(numbers):
    field = numbers["field"]
    for what in ("count", "rms", "significance"):
        shown = drawn(pictures.draw_residual_cells, field, what).images[0].get_array()
        expected = np.where(field.count > 0, getattr(field, what), np.nan)
        np.testing.assert_allclose(np.ma.filled(shown, np.nan), expected)
    quiver = drawn(pictures.draw_residual_vectors, field, 20.0).collections[0]
    filled = field.count > 0
    np.testing.assert_allclose(np.column_stack([quiver.U, quiver.V]), 20 * field.mean[filled])
    with pytest.raises(InputError, match="what"):
        drawn(pictures.draw_residual_cells, field, "nothing")


def test_dots_profiles_and_histograms_are_those_of_the_numbers(numbers):
    field, histogram = numbers["field"], numbers["histogram"]
    dots = drawn(pictures.draw_residual_directions, field).collections[0]
    np.testing.assert_allclose(dots.get_offsets(), field.dots)
    profile = drawn(pictures.draw_radial_profile, field)
    np.testing.assert_allclose(profile.lines[0].get_ydata(), field.profile.radial)
    for function, counts in (
        (pictures.draw_residual_histogram, histogram.coordinates),
        (pictures.draw_residual_lengths, histogram.lengths),
    ):
        patches = drawn(function, histogram).patches
        for patch, expected in zip(patches, counts.values(), strict=True):
            np.testing.assert_allclose(patch.get_data().values, expected)


def test_tracks_and_images_are_those_of_the_numbers(numbers):
    tracks, image = numbers["tracks"], numbers["image"]
    for function, counts in (
        (pictures.draw_track_lengths, tracks.lengths),
        (pictures.draw_triangulation_angles, tracks.angles),
    ):
        axes = drawn(function, tracks)
        ends = [bar.get_x() + bar.get_width() for bar in axes.patches]
        np.testing.assert_allclose(ends, counts[counts > 0])
        assert axes.get_xscale() == "log"
    axes = drawn(pictures.draw_image_residuals, image, 7.0, np.zeros((6, 8)))
    lines = np.array(axes.collections[0].get_segments())
    np.testing.assert_allclose(np.diff(lines, axis=1)[:, 0], 7 * image.residual)
    np.testing.assert_allclose(lines[:, 0], image.xy)
    assert len(axes.images) == 1


def test_opposite_directions_have_other_colours_and_equal_ones_the_same():
    from bundle.figures.marks import direction_colours

    vectors = np.array([[1, 0], [0, 1], [-1, 0], [0, -1], [3, 0]], float)
    colours = direction_colours(vectors).astype(int)
    assert colours[0].tolist() == colours[4].tolist()
    assert all(np.abs(colours[i] - colours[j]).max() > 50 for i in range(4) for j in range(i))


def test_lenses_and_scenes_are_those_of_the_numbers(numbers):
    problem = numbers["problem"]
    curve = figures.lens_curve(problem, 0, np.diag([1.0, 0.0, 0.0, 1e-6]))
    axes = drawn(pictures.draw_lens_curves, [curve])
    np.testing.assert_allclose(axes.lines[0].get_ydata(), curve.distortion)
    assert axes.lines[1].get_xdata()[0] == curve.observed_radius
    assert len(axes.collections) == 1
    view = figures.scene_view(problem, numbers["found"])
    made, flat = pictures.figure()
    with pytest.raises(InputError, match="3d"):
        pictures.draw_scene(flat[0, 0], view)
    deep = made.add_subplot(projection="3d")
    pictures.draw_scene(deep, view)
    made.canvas.draw()
    assert deep.get_xlabel() == "x"


def test_rows_before_and_after_are_those_of_the_numbers(numbers):
    found = figures.row_residuals(numbers["problem"], numbers["found"])
    one = drawn(pictures.draw_row_residuals, found)
    np.testing.assert_allclose(one.lines[1].get_ydata(), found.size[:, 1])
    both = drawn(pictures.draw_row_residuals, found, found)
    assert len(both.lines) == 5
    np.testing.assert_allclose(both.lines[-1].get_ydata(), found.noise)
    with pytest.raises(InputError, match="found 3"):
        drawn(pictures.draw_row_residuals, found, found, found)
