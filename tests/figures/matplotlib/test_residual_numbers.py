"""Numbers of the report page against formulas of their own and loops."""

import itertools

import numpy as np
import pytest

from bundle.figures.residual_field import residual_fields
from bundle.figures.residual_figures import residual_histogram, worst_residuals
from bundle.figures.structure_figures import track_statistics
from bundle.model.residuals import reprojection_errors, residuals
from tests.scenes import make_problem, scene
from tests.scenes import residuals as by_formula


@pytest.mark.parametrize("model", ["OPENCV", "SIMPLE_RADIAL_FISHEYE"])
def test_residuals_are_those_of_the_formulas(model):
    problem = make_problem(model=model, num_points=30)
    found = residuals(problem)
    np.testing.assert_allclose(found.xy, by_formula(problem), rtol=1e-10, atol=1e-9)
    assert found.counted.all()


def test_residuals_go_the_shorter_way_around_the_seam_of_a_panorama():
    problem = make_problem(model="EQUIRECTANGULAR", num_points=30, noise=0.1)
    xy = problem.observation_xy.copy()
    width = problem.camera_params[problem.image_camera[problem.observation_image[7]], 0]
    xy[7, 0] += width if xy[7, 0] < width / 2 else -width
    found = residuals(problem.replace(observation_xy=xy))
    np.testing.assert_allclose(found.xy, residuals(problem).xy, atol=1e-9)
    errors, _ = reprojection_errors(problem.replace(observation_xy=xy))
    np.testing.assert_allclose(found.lengths, errors, rtol=1e-12)


def test_points_behind_cameras_count_only_where_it_is_algebraic():
    problem = make_problem(num_points=30)
    points = problem.points.copy()
    points[3] = -problem.cam_from_world[0, 4:] * 3 - [0, 0, 20]
    behind = problem.replace(points=points)
    mask = behind.observation_point == 3
    assert (residuals(behind).counted == ~mask).all()
    assert residuals(behind, "algebraic").counted.all()


def test_bal_is_algebraic_by_itself():
    problem = scene()
    found = residuals(problem)
    np.testing.assert_allclose(found.xy, by_formula(problem), rtol=1e-10, atol=1e-9)


def biased(num_points=600, shift=(0.0, 0.0), **changes):
    """A camera whose right half sees everything shifted."""
    problem = make_problem(
        num_images=6, num_points=num_points, shared=True, perturbation=0.0, seed=3, **changes
    )
    xy = problem.observation_xy.copy()
    xy[xy[:, 0] > 400] += shift
    return problem.replace(observation_xy=xy)


def test_cells_are_means_over_their_observations():
    problem = biased()
    found = residuals(problem)
    (field,) = residual_fields(problem, found)
    rows, columns = field.count.shape
    assert field.box.tolist() == [0, 0, 800, 600]
    xy = problem.observation_xy
    inside = ((xy >= 0) & (xy <= [800, 600])).all(axis=1)
    assert field.num_outside == (~inside).sum()
    assert field.count.sum() + field.num_outside == problem.num_observations
    for row, column in itertools.product(range(rows), range(columns)):
        low = np.array([800 / columns * column, 600 / rows * row])
        high = low + np.array([800 / columns, 600 / rows])
        chosen = found.xy[inside & ((xy >= low) & (xy < high)).all(axis=1)]
        n = len(chosen)
        assert field.count[row, column] == n
        if n:
            np.testing.assert_allclose(field.mean[row, column], chosen.mean(0), atol=1e-9)
            rms = np.sqrt((chosen**2).sum(1).mean())
            np.testing.assert_allclose(field.rms[row, column], rms, atol=1e-9)
        error = field.standard_error[row, column]
        if n < 5:
            assert np.isnan(error)
        else:
            expected = np.sqrt(chosen.var(axis=0, ddof=1).mean() / n)
            np.testing.assert_allclose(error, expected, atol=1e-9)


def test_what_is_systematic_is_significant_where_it_is_and_nowhere_else():
    problem = biased(shift=(1.0, 0.5), num_points=1500)
    (field,) = residual_fields(problem, residuals(problem))
    columns = field.count.shape[1]
    crowded = field.count >= 10
    left, right = (np.zeros_like(crowded) for _ in range(2))
    left[:, : columns // 2 - 1], right[:, columns // 2 + 1 :] = True, True
    assert field.significance[crowded & right].min() > 3.03
    quiet = field.significance[crowded & left]
    assert (quiet > 3.03).mean() < 0.1
    assert np.median(quiet) == pytest.approx(1.18, abs=0.35)  # Rayleigh's median


def test_a_wrong_focal_length_points_outwards():
    problem = biased(noise=0.0)
    params = problem.camera_params.copy()
    params[0, 0] *= 1.01
    wrong = problem.replace(camera_params=params)
    (field,) = residual_fields(wrong, residuals(wrong))
    profile = field.profile
    full = profile.count > 5
    np.testing.assert_allclose(
        profile.radial[full], 0.01 * profile.radius[full], rtol=0.1, atol=0.05
    )
    assert np.abs(profile.tangential[full]).max() < 0.05
    np.testing.assert_allclose(field.center, params[0, 1:3])


def test_many_cameras_are_pooled_first():
    problem = make_problem(num_images=9, num_points=50)
    fields = residual_fields(problem, residuals(problem))
    assert [len(field.camera_ids) for field in fields] == [9, 1, 1, 1, 1, 1]
    assert fields[0].num_images == 9
    single = fields[1]
    assert single.num_images == 1
    assert single.num_observations + single.num_outside == 50


def test_histograms_hold_every_residual():
    found = {"before": residuals(make_problem(noise=60.0)), "after": residuals(make_problem())}
    histogram = residual_histogram(found)
    for label, of in found.items():
        count = of.xy.size
        inside = histogram.coordinates[label].sum()
        assert inside == pytest.approx(count * (1 - histogram.share_outside[label]))
        assert histogram.lengths[label].sum() == count // 2
    widths = [np.quantile(np.abs(found[label].xy), 0.99) for label in found]
    assert widths[0] > 4 * widths[1]
    assert histogram.edges[-1] == pytest.approx(4 * widths[1])
    normal = np.random.default_rng(0).normal(0.0, 2.0, (20_000, 2))
    made = type(found["after"])(normal, np.ones(20_000, bool))
    assert residual_histogram({"now": made}).sigma["now"] == pytest.approx(2.0, rel=0.03)
    none = type(made)(normal, np.zeros(20_000, bool))
    assert residual_histogram({"now": none}) is None


def test_tracks_and_angles_are_those_of_a_loop():
    problem = make_problem(num_images=6, num_points=60, track=3)
    tracks = track_statistics(problem)
    assert tracks.lengths.tolist() == [0, 0, 0, 60]
    expected = np.zeros(len(tracks.angles), int)
    for point in range(60):
        images = problem.observation_image[problem.observation_point == point]
        rays = problem.projection_centers[images] - problem.points[point]
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        sines = [np.linalg.norm(np.cross(a, b)) for a, b in itertools.combinations(rays, 2)]
        angle = np.degrees(np.arcsin(max(sines)))
        expected[np.searchsorted(tracks.angle_limits, angle, side="right")] += 1
    assert tracks.angles.tolist() == expected.tolist()


def test_points_seen_once_have_no_angle():
    problem = make_problem(num_images=4, num_points=20, track=1)
    tracks = track_statistics(problem)
    assert tracks.lengths.tolist() == [0, 20]
    assert tracks.angles.sum() == 0


def test_worst_images_come_first_with_their_largest_residuals():
    problem = make_problem(num_images=4, num_points=500)
    xy = problem.observation_xy.copy()
    xy[problem.observation_image == 2] += 5.0
    problem = problem.replace(observation_xy=xy)
    found = residuals(problem)
    worst = worst_residuals(problem, found)
    assert worst[0].error.image_id == 3
    lengths = np.sort(found.lengths[problem.observation_image == 2])[::-1]
    np.testing.assert_allclose(np.hypot(*worst[0].residual.T), lengths[:400])
    assert worst[0].error.max == pytest.approx(lengths[0])
