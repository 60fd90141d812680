"""Lenses, points of common tracks, and movement in sigmas, of two models."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import bundle
from bundle.georeference.similarity import Similarity, moved
from bundle.judging.evaluation.lens_difference import lens_differences
from bundle.judging.evaluation.pair_errors import shared_points
from bundle.model.lenses.exact_image import pixel_rays
from tests.rig_scenes import rig_problem
from tests.scenes import make_problem, with_observations

ROWS = np.arange(5)


def lens(model, params, problem=None):
    problem = make_problem(num_points=80, shared=True) if problem is None else problem
    return problem.replace(camera_models=[model], camera_params=[params])


def test_equal_lenses_do_not_differ_in_any_model():
    for model, params in (
        ("EQUIRECTANGULAR", [800, 400]),
        ("OPENCV", [700, 700, 400, 300, 0.1, 0, 0, 0]),
    ):
        same = lens(model, params)
        (found,) = lens_differences(same, same, ROWS, ROWS)
        assert found.pixels.max == 0 and found.angle == 0 and found.num_images == 5


def test_a_shift_of_the_principal_point_is_mostly_a_rotation():
    a, b = (lens("PINHOLE", [700, 700, 400 + shift, 300]) for shift in (0, 5))
    (found,) = lens_differences(a, b, ROWS, ROWS)
    assert found.angle == pytest.approx(np.degrees(np.arctan(5 / 700)), rel=0.2)
    assert 0 < found.pixels.rmse < 1


def test_the_difference_is_the_least_squares_one():
    a = lens("OPENCV", [700, 705, 400, 300, -0.1, 0.02, 0.001, -0.001])
    b = lens("SIMPLE_RADIAL", [710, 405, 297, -0.05])
    (found,) = lens_differences(a, b, ROWS, ROWS)
    rows, columns = found.field.shape[:2]
    left, top, right, bottom = found.box
    x = left + (right - left) * (np.arange(columns) + 0.5) / columns
    y = top + (bottom - top) * (np.arange(rows) + 0.5) / rows
    known = np.isfinite(found.field).all(axis=-1)
    assert 100 < known.sum() <= known.size
    xy = np.stack(np.meshgrid(x, y), axis=-1)[known]
    rays, _ = pixel_rays("OPENCV", a.camera_params[0], xy)

    def residuals(vector):
        turned = rays @ Rotation.from_rotvec(vector).as_matrix().T
        return (bundle.project("SIMPLE_RADIAL", b.camera_params[0], turned)[0] - xy).ravel()

    best = least_squares(residuals, np.zeros(3), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert found.field[known].ravel() == pytest.approx(best.fun, abs=1e-6)
    assert found.angle == pytest.approx(np.degrees(np.linalg.norm(best.x)), rel=1e-4)


def test_other_sizes_are_scaled_and_a_camera_without_observations_is_unknown():
    a = lens("PINHOLE", [700, 700, 400, 300])
    half = lens("PINHOLE", [350, 350, 200, 150]).replace(camera_sizes=[[400, 300]])
    (found,) = lens_differences(a, half, ROWS, ROWS)
    assert found.pixels.max < 1e-9
    bare = a.replace(
        camera_sizes=[[0, 0]],
        **{
            f"observation_{name}": getattr(a, f"observation_{name}")[:0]
            for name in ("image", "point", "xy", "keypoint")
        },
    )
    (found,) = lens_differences(bare, half, ROWS, ROWS)
    assert np.isnan(found.pixels.rmse)
    assert bundle.evaluate(bare, half).lens_difference["rmse"] != 0


def test_cameras_of_images_pair_up():
    a = make_problem(num_images=6)
    b = a.replace(camera_ids=a.camera_ids + 10)
    found = lens_differences(a, b, np.arange(6), np.arange(6))
    assert [(one.camera_a, one.camera_b) for one in found] == [(k, k + 10) for k in range(1, 7)]
    shared = make_problem(num_images=6, shared=True)
    assert len(lens_differences(a, shared, np.arange(6), np.arange(6))) == 6


@pytest.fixture(params=["keypoints", "pixels"])
def model(request):
    problem = make_problem(num_images=6, num_points=50, track=4, seed=2)
    if request.param == "pixels":
        return problem
    keypoint = np.empty(problem.num_observations, int)
    for image in range(6):
        rows = np.flatnonzero(problem.observation_image == image)
        keypoint[rows] = np.arange(len(rows))
    return problem.replace(observation_keypoint=keypoint)


def test_points_of_the_same_track_are_found_in_any_order(model):
    rng = np.random.default_rng(0)
    order = rng.permutation(model.num_points)
    place = np.argsort(order)
    rows = rng.permutation(model.num_observations)
    images = rng.permutation(6)
    names = ("image", "point", "xy", "keypoint")
    changes = {f"observation_{n}": getattr(model, f"observation_{n}")[rows] for n in names}
    changes["observation_point"] = place[changes["observation_point"]]
    changes["observation_image"] = np.argsort(images)[changes["observation_image"]]
    other = model.replace(
        points=model.points[order],
        point_ids=model.point_ids[order],
        cam_from_world=model.cam_from_world[images],
        image_camera=model.image_camera[images],
        image_names=[model.image_names[k] for k in images],
        image_ids=model.image_ids[images],
        **changes,
    )
    pairs = shared_points(model, other, images, np.arange(6))
    assert len(pairs) == model.num_points
    assert np.array_equal(order[pairs[:, 1]], pairs[:, 0])
    found = bundle.evaluate(model, other)
    assert found.points.num_shared == 50 and found.points.distance.max < 1e-12
    assert found.verdict == "identical"


def test_a_wrong_vote_and_repeated_pixels_do_not_make_pairs(model):
    xy = model.observation_xy.copy()
    first = np.flatnonzero(model.observation_image == 0)
    xy[first[1]] = xy[first[0]]
    twice = model.replace(observation_xy=xy)
    pairs = shared_points(twice, twice, np.arange(6), np.arange(6))
    assert (pairs[:, 0] == pairs[:, 1]).all() and len(pairs) == 50
    point = model.observation_point.copy()
    point[first[2]] = point[first[3]]
    wrong = model.replace(observation_point=point)
    pairs = shared_points(model, wrong, np.arange(6), np.arange(6))
    assert (pairs[:, 0] == pairs[:, 1]).all() and len(pairs) == 50
    far = model.replace(observation_xy=model.observation_xy + 1.0)
    assert len(shared_points(model, far, np.arange(6), np.arange(6))) == 0


@pytest.fixture(scope="module")
def solved():
    """Solutions of the same scene with other noise, and the scene itself."""
    truth = make_problem(num_images=8, num_points=60, perturbation=0, noise=0, shared=True)
    models = []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        noisy = truth.replace(
            observation_xy=truth.observation_xy
            + 0.3 * rng.standard_normal(truth.observation_xy.shape)
        )
        models.append(bundle.solve(noisy, function_tolerance=1e-14).problem)
    return truth, models


def test_errors_against_the_truth_are_one_sigma_in_any_world(solved):
    truth, models = solved
    squares = []
    for row, problem in enumerate(models):
        found = bundle.evaluate(problem, truth)
        squares.append((found.movement.sigmas**2).mean())
        assert found.movement.sigma0 == pytest.approx(0.3, rel=0.15)
        if row < 3:
            turn = Rotation.from_rotvec([1, 2, 3]).as_matrix()
            world = moved(truth, Similarity(1e4, turn, np.array([5e4, 0, 1e3])))
            again = bundle.evaluate(problem, world)
            assert again.movement.sigmas == pytest.approx(found.movement.sigmas, rel=1e-6)
    assert np.mean(squares) == pytest.approx(1, abs=0.2)


def test_a_model_that_is_no_minimum_says_so(solved):
    truth, models = solved
    assert bundle.evaluate(models[0], truth).movement.is_minimum
    start = models[0].replace(points=models[0].points * 1.01)
    found = bundle.evaluate(start, truth)
    assert not found.movement.is_minimum and "not at a minimum" in " ".join(found.headline)
    assert not any("converged" in note for note in found.movement.notes)


def test_a_large_move_has_many_sigmas(solved):
    _, models = solved
    poses = models[0].cam_from_world.copy()
    poses[3, 4] += 0.2
    found = bundle.evaluate(models[0], models[0].replace(cam_from_world=poses))
    assert np.argmax(found.movement.sigmas) == 3 and found.movement.largest > 10
    assert found.images[3].sigmas == found.movement.sigmas[3]


@pytest.mark.parametrize("arm", [0.5, 0.0])
def test_rigs_move_as_their_frames_do(arm):
    """Metric rigs determine the scale; sensors in one place leave it free."""
    rig = ((0.01, 0.3, -0.01, -arm, 0.02 * arm, 0),)
    truth = rig_problem(
        num_frames=6, rigs=(rig,), num_alone=1, num_points=60, noise=0, perturbation=0
    )
    assert bundle.gauge_freedom(truth).degrees == (6 if arm else 7)
    squares = []
    for seed in range(24):
        noise = 0.3 * np.random.default_rng(seed).standard_normal(truth.observation_xy.shape)
        noisy = truth.replace(observation_xy=truth.observation_xy + noise)
        problem = bundle.solve(noisy, function_tolerance=1e-14).problem
        squares.append((bundle.evaluate(problem, truth).movement.sigmas ** 2).mean())
    assert np.mean(squares) == pytest.approx(1, abs=0.2)
    world = moved(truth, Similarity(3.0, np.eye(3), np.zeros(3)))
    if arm:
        with pytest.raises(bundle.InputError, match="differ by a factor of"):
            bundle.evaluate(problem, world, sigmas="on")
    else:
        assert bundle.evaluate(problem, world, sigmas="on").movement.median < 3


def test_when_sigmas_are_missing():
    a, b = make_problem(seed=1), make_problem(seed=2)
    assert bundle.evaluate(a, b, sigmas="off").movement is None
    rigs = rig_problem()
    found = bundle.evaluate(rigs, rigs.without_rigs().replace(points=rigs.points * 1.5))
    assert found.verdict == "identical" and found.movement is None
    without = a.replace(points=a.points + 1e4)
    assert any("No sigmas" in note for note in bundle.evaluate(without, b).notes)


def test_only_the_region_of_the_observations_counts():
    a = lens("PINHOLE", [700, 700, 400, 300])
    distance = np.linalg.norm(a.observation_xy - [400, 300], axis=1)
    near = with_observations(a, distance < 150)
    assert (np.bincount(near.observation_image) > 0).all() and near.num_observations >= 30
    (found,) = lens_differences(near, a, ROWS, ROWS)
    rows, columns = found.field.shape[:2]
    x = 800 * (np.arange(columns) + 0.5) / columns - 400
    y = 600 * (np.arange(rows) + 0.5) / rows - 300
    known = np.isfinite(found.field).all(axis=-1)
    reach = distance[distance < 150].max()
    assert np.array_equal(known, np.hypot(*np.meshgrid(x, y)) <= reach)
    (found,) = lens_differences(with_observations(a, np.arange(20)), a, ROWS, ROWS)
    assert np.isfinite(found.field).all()  # too few to tell


def test_the_same_keypoint_has_nearly_the_same_pixel():
    a = make_problem(num_images=6, num_points=50, track=4, seed=2)
    keypoint = np.zeros(a.num_observations, int)
    for image in range(6):
        rows = a.observation_image == image
        keypoint[rows] = np.arange(rows.sum())
    a = a.replace(observation_keypoint=keypoint)
    for shift, count in ((0.009, 50), (0.011, 0)):
        b = a.replace(observation_xy=a.observation_xy + shift)
        assert len(shared_points(a, b, np.arange(6), np.arange(6))) == count


def test_the_headline_counts_lenses():
    a = make_problem(num_images=6)
    b = a.replace(camera_params=a.camera_params * [1.01, 1, 1, 1])
    assert "median of 6 cameras" in bundle.evaluate(a, b).headline[-1]
    one = make_problem(num_images=6, shared=True)
    other = one.replace(camera_params=one.camera_params * [1.01, 1, 1, 1])
    assert "cameras" not in bundle.evaluate(one, other).headline[-1]
