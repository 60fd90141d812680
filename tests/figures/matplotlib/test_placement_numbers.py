"""Errors of positions and control points, and covariances, against formulas of their own."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bundle import InputError, pictures
from bundle.analysis.uncertainty.covariance_result import Certainty, largest_eigenvalues
from bundle.figures.placement_figures import placement
from tests.scenes import make_problem


def target(name, residual, **changes):
    return {
        "name": name,
        "role": "control",
        "residual_enu": residual,
        "residual_leave_one_out_enu": [None] * 3,
        "residual_px": 0.5,
        "sigma": [0.02, 0.03, None],
        "suspect": False,
        "images": [{"image": f"image{k}.jpg", "residual_px": [0.3, -0.4]} for k in (1, 2)],
        **changes,
    }


RECORD = {
    "reference_system": "EPSG:32630",
    "gps": [
        {"image": "image1.jpg", "residual_enu": [3.0, 4.0, None], "sigmas": 2.5, "used": True},
        {"image": "gone.jpg", "residual_enu": [9.0, 9.0, 9.0], "sigmas": None, "used": False},
    ],
    "gcps": [
        target("a", [0.1, -0.2, 0.3]),
        target("b", [0.3, 0.2, None]),
        target("c", [1.0, 2.0, 2.0], role="check", suspect=True),
    ],
}


def covariances(problem, rng):
    """As the library gives them, of random values, poses and cameras in another order."""
    factor = rng.normal(size=(problem.num_images, 6, 6))
    points = rng.normal(size=(problem.num_points, 3, 3))
    return SimpleNamespace(
        pose_ids=problem.image_ids[::-1],
        pose_covariance=1e-4 * factor @ np.swapaxes(factor, 1, 2),
        point_ids=problem.point_ids,
        point_covariance=1e-4 * points @ np.swapaxes(points, 1, 2),
        camera_ids=problem.camera_ids,
        camera_covariance=np.array(
            [[[4, math.nan, math.nan, 1e-3], [math.nan] * 4, [math.nan] * 4,
              [1e-3, math.nan, math.nan, 1e-6]]]
        ),
        sigma0=0.5,
        dof=100,
        unit="m",
        gauge="inner",
        scale="sigma0",
        notes=("A note.",),
        null_point_ids=[7, 8],
        lens_sigmas=None,
        readout_sigmas={},
    )  # fmt: skip


def test_root_mean_squares_are_those_of_the_known_coordinates():
    problem = make_problem()
    place = placement(problem, RECORD)
    east, north, up = math.sqrt(0.05), 0.2, 0.3
    horizontal = math.hypot(east, north)
    np.testing.assert_allclose(
        place.rms("control"), [east, north, up, horizontal, math.hypot(horizontal, up)]
    )
    np.testing.assert_allclose(place.rms("check"), [1, 2, 2, math.sqrt(5), 3])
    np.testing.assert_allclose(place.rms("gps"), [3, 4, math.nan, 5, 5])
    np.testing.assert_allclose(place.images[0].position, problem.projection_centers[1])
    assert np.isnan(place.images[1].position).all()


@pytest.mark.parametrize(
    "change",
    [{"gps": None}, {"gcps": [{"name": "x"}]}, {"gcps": [target("a", [1.0])]}, {"gps": [3]}],
)
def test_another_file_is_refused_in_one_line(change):
    with pytest.raises(InputError, match="georeference"):
        placement(make_problem(), RECORD | change)
    with pytest.raises(InputError, match="georeference"):
        placement(make_problem(), {})


def test_centres_are_as_certain_as_random_draws_say():
    problem = make_problem(num_images=3, num_points=5, shared=True)
    rng = np.random.default_rng(5)
    given = covariances(problem, rng)
    known = Certainty(problem, given)
    assert known.images.tolist() == [2, 1, 0]
    for place, image in enumerate(known.images):
        draws = rng.multivariate_normal(np.zeros(6), 1e-4 * given.pose_covariance[place], 40_000)
        start = Rotation.from_quat(problem.cam_from_world[image, :4])
        moved = Rotation.from_rotvec(draws[:, :3]) * start
        centers = -moved.inv().apply(problem.cam_from_world[image, 4:] + draws[:, 3:])
        expected = np.cov(centers.T) * 1e4
        error = np.abs(known.centers[place] - expected).max() / np.abs(expected).max()
        assert error < 0.05
        largest = np.linalg.eigvalsh(given.pose_covariance[place][:3, :3])[-1]
        assert known.angles[place] == pytest.approx(np.degrees(np.sqrt(largest)))


def test_ellipsoids_are_eigenvectors_and_stay_nan_where_unknown():
    covariance = np.stack([np.diag([1.0, 4.0, 9.0]), np.full((3, 3), math.nan)])
    values = largest_eigenvalues(covariance)
    assert values[0] == pytest.approx(9.0)
    assert np.isnan(values[1])


def test_pictures_draw_these_numbers():
    problem = make_problem(num_images=3, num_points=5, shared=True)
    place, known = (
        placement(problem, RECORD),
        Certainty(problem, covariances(problem, np.random.default_rng(1))),
    )
    made, axes = pictures.figure(1, 3)
    pictures.draw_target_errors(axes[0, 0], place)
    drawn = np.concatenate([line.get_xydata() for line in axes[0, 0].lines])
    assert [0.1, -0.2] in drawn.tolist()
    pictures.draw_position_errors(axes[0, 1], place)
    np.testing.assert_allclose(axes[0, 1].lines[0].get_xydata(), [[3, 4], [9, 9]])
    pictures.draw_correlations(axes[0, 2], problem, known, 0)
    np.testing.assert_allclose(axes[0, 2].images[0].get_array(), [[1, 0.5], [0.5, 1]])
    made.canvas.draw()
    with pytest.raises(InputError, match="camera"):
        pictures.draw_correlations(axes[0, 2], problem, known, 7)
