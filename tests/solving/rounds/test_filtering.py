"""Filtering against pycolmap's ObservationManager and against all pairs of rays."""

import numpy as np
import pycolmap
import pytest

import bundle
from bundle.model import ray_angles
from bundle.model.residuals import standardized_errors
from bundle.solving.layout import lay_out
from bundle.solving.rounds.plan import _of_suspects
from tests import scenes
from tests.analysis.uncertainty.dense import Dense
from tests.analysis.uncertainty.test_reliability import diagonal_blocks, residual_maker
from tests.scenes import make_problem


@pytest.fixture
def manager():
    """COLMAP's filter: of a reconstruction, which it changes."""
    return lambda reconstruction: pycolmap.ObservationManager(reconstruction)


def all_pairs(problem, observations):
    """The largest angle of each point's rays in degrees, -1 for fewer than two, pair by pair.

    By Kahan's formula, 2 atan2(|u - v|, |u + v|) of unit vectors.
    """
    angles = np.full(problem.num_points, -1.0)
    for point in range(problem.num_points):
        mine = observations[problem.observation_point[observations] == point]
        rays = problem.projection_centers[problem.observation_image[mine]] - problem.points[point]
        rays /= np.linalg.norm(rays, axis=1)[:, None]
        for i in range(len(rays)):
            for j in range(i):
                ends = np.linalg.norm(rays[i] - rays[j]), np.linalg.norm(rays[i] + rays[j])
                angles[point] = max(angles[point], np.rad2deg(2 * np.arctan2(min(ends), max(ends))))
    return angles


def scattered(seed, num_images=12, num_points=80, spread=0.3):
    """Images and points at random, tracks of all lengths: rays from all sides, some behind."""
    rng = np.random.default_rng(seed)
    base = make_problem(num_images=num_images, num_points=num_points, model="PINHOLE", seed=seed)
    seen = rng.random((num_points, num_images)) < rng.random((num_points, 1))
    point, image = np.nonzero(seen)
    pose = base.cam_from_world.copy()
    pose[:, 4:] += spread * rng.standard_normal((num_images, 3))
    points = base.points * np.where(rng.random((num_points, 1)) < 0.3, 20.0, 1.0)
    return base.replace(
        cam_from_world=pose,
        points=points,
        observation_image=image,
        observation_point=point,
        observation_xy=rng.uniform(0, 800, (len(image), 2)),
        observation_keypoint=np.full(len(image), -1),
    )


@pytest.mark.parametrize(
    ("max_error", "min_angle"), [(2, 1.5), (1, 5), (4, 20), (0.7, 35), (1e9, 60)]
)
def test_agrees_with_colmap_on_a_real_model(bundle_data, manager, max_error, min_angle):
    reconstruction = pycolmap.Reconstruction(bundle_data / "colmap" / "crane_mast")
    problem = bundle.Problem.from_pycolmap(reconstruction)
    filtered = bundle.filter_observations(problem, max_error, min_angle)
    count = manager(reconstruction).filter_all_points3D(max_error, min_angle)
    expected = bundle.Problem.from_pycolmap(reconstruction)
    assert 0 < filtered.num_observations_removed == count
    for name in ("point_ids", "observation_image", "observation_point", "observation_keypoint"):
        np.testing.assert_array_equal(getattr(filtered.problem, name), getattr(expected, name))


@pytest.mark.parametrize("seed", range(6))
def test_agrees_with_colmap_on_scattered_scenes(manager, seed):
    problem = scattered(seed)
    reconstruction = problem.to_pycolmap()
    problem = bundle.Problem.from_pycolmap(reconstruction)
    errors, behind = bundle.reprojection_errors(problem)
    assert behind.any()
    max_error, min_angle = float(np.quantile(errors[~behind], 0.6)), 10.0 * seed + 3
    filtered = bundle.filter_observations(problem, max_error, min_angle)
    manager(reconstruction).filter_all_points3D(max_error, min_angle)
    expected = bundle.Problem.from_pycolmap(reconstruction)
    assert 0 < expected.num_points < problem.num_points
    np.testing.assert_array_equal(filtered.problem.point_ids, expected.point_ids)
    for name in ("observation_image", "observation_point", "observation_xy"):
        np.testing.assert_array_equal(getattr(filtered.problem, name), getattr(expected, name))


@pytest.mark.parametrize("spread", [0.3, 1e-3, 1e-6])
@pytest.mark.parametrize("seed", range(3))
def test_angles_are_those_of_all_pairs(monkeypatch, seed, spread):
    """Limits just above and below the angle of each point, down to millionths of a degree."""
    monkeypatch.setattr(ray_angles, "PAIRS_AT_ONCE", 7)
    problem = scattered(seed, num_images=9, num_points=25)
    centers = problem.projection_centers
    pose = problem.cam_from_world.copy()  # all centres close together: tiny angles
    rotations = pycolmap.Rotation3d
    for i in range(problem.num_images):
        center = spread * centers[i] / 0.3
        pose[i, 4:] = -(rotations(pose[i, :4]).matrix() @ center)
    rng = np.random.default_rng(seed)
    problem = problem.replace(cam_from_world=pose)
    observations = rng.permutation(problem.num_observations)[: problem.num_observations * 3 // 4]
    expected = all_pairs(problem, observations)
    for angle in expected[expected > 0]:
        for limit in (angle * (1 - 1e-7), min(angle * (1 + 1e-7), 90.0)):
            found = ray_angles.enclose_angle(problem, observations, limit)
            np.testing.assert_array_equal(found, expected >= limit)


def test_every_step_of_the_decision_is_taken(monkeypatch):
    """A cone of rays around a point: decided by the first, the farthest, the middle, all pairs."""
    calls = []
    real = ray_angles._all_pairs
    monkeypatch.setattr(ray_angles, "_all_pairs", lambda *a: calls.append(a[0].lengths) or real(*a))
    rng = np.random.default_rng(3)
    num_points, num_images = 100, 30
    base = make_problem(num_images=num_images, num_points=num_points, model="PINHOLE")
    centers = np.c_[rng.uniform(-1, 1, (num_images, 2)), np.zeros(num_images)]
    pose = np.c_[np.tile([0, 0, 0, 1.0], (num_images, 1)), -centers]
    points = np.c_[np.zeros((num_points, 2)), rng.uniform(7, 80, num_points)]
    problem = base.replace(cam_from_world=pose, points=points)
    observations = np.arange(problem.num_observations)
    expected = all_pairs(problem, observations)
    for limit in (2.0, 5.0, 12.0):
        found = ray_angles.enclose_angle(problem, observations, limit)
        np.testing.assert_array_equal(found, expected >= limit)
        assert 0 < found.sum() < num_points
    assert sum(map(len, calls)) < 60, "few points need all pairs"
    assert calls, "some do"


def test_rays_from_opposite_sides_enclose_no_angle():
    problem = make_problem(num_images=2, num_points=1, model="PINHOLE")
    centers = np.array([[-1.0, 0, 0], [1, 1e-4, 0]])
    pose = np.c_[np.tile([0, 0, 0, 1.0], (2, 1)), -centers]
    problem = problem.replace(cam_from_world=pose, points=[[0, 0, 0]])
    assert not ray_angles.enclose_angle(problem, np.arange(2), 0.1)
    assert ray_angles.enclose_angle(problem, np.arange(2), 0.005)
    coincident = problem.replace(points=centers[:1])
    assert not ray_angles.enclose_angle(coincident, np.arange(2), 1e-12)


def test_observations_may_stand_in_any_order():
    problem = make_problem(num_points=60, track=3, noise=2.0)
    order = np.random.default_rng(1).permutation(problem.num_observations)
    names = ("observation_image", "observation_point", "observation_xy", "observation_keypoint")
    shuffled = problem.replace(**{name: getattr(problem, name)[order] for name in names})
    one, other = (bundle.filter_observations(p, 7.0, 33.0) for p in (problem, shuffled))
    np.testing.assert_array_equal(one.observation_mask[order], other.observation_mask)
    np.testing.assert_array_equal(one.point_mask, other.point_mask)
    assert 0 < one.num_points_below_min_angle < 60
    assert one.num_observations_beyond_max_error > 0


def test_counts_and_masks_describe_what_is_left():
    problem = make_problem(num_points=60, track=3, noise=2.0)
    filtered = bundle.filter_observations(problem, 7.0, 33.0, 3)
    left = filtered.problem
    assert filtered.num_points_with_short_track > 0
    assert filtered.num_points_removed == problem.num_points - left.num_points
    assert filtered.num_observations_removed == problem.num_observations - left.num_observations
    kept = filtered.observation_mask
    np.testing.assert_array_equal(left.point_ids, problem.point_ids[filtered.point_mask])
    np.testing.assert_array_equal(left.points, problem.points[filtered.point_mask])
    np.testing.assert_array_equal(
        left.point_ids[left.observation_point], problem.point_ids[problem.observation_point[kept]]
    )
    np.testing.assert_array_equal(left.observation_xy, problem.observation_xy[kept])
    assert np.bincount(left.observation_point, minlength=left.num_points).min() >= 3
    assert (bundle.reprojection_errors(left)[0] <= 7.0).all()
    again = bundle.filter_observations(left, 7.0, 33.0, 3)
    assert again.problem is left


def test_limits_that_ask_for_nothing_keep_everything():
    problem = make_problem(num_points=20, track=1)
    problem = problem.replace(
        points=np.vstack([problem.points, [[0, 0, 0]]]), point_ids=np.arange(21)
    )  # the last point is observed nowhere
    everything = bundle.filter_observations(problem, 1e9, 0, 0)
    assert everything.problem is problem
    assert bundle.filter_observations(problem, 1e9, 0, 1).num_points_removed == 1
    assert bundle.filter_observations(problem, 1e9, 1e-9, 0).problem.num_points == 0


def test_errors_that_are_no_numbers_exceed_every_limit():
    problem = make_problem(num_images=3, num_points=10, model="PINHOLE")
    points = problem.points.copy()
    pose = problem.cam_from_world[0]
    points[4] = pycolmap.Rotation3d(pose[:4]).matrix().T @ -pose[4:]  # in the camera's centre
    filtered = bundle.filter_observations(problem.replace(points=points), 1e300, 0, 0)
    bad = (problem.observation_point == 4) & (problem.observation_image == 0)
    np.testing.assert_array_equal(filtered.observation_mask, ~bad)


def test_points_that_are_to_stay_lose_observations_only():
    problem = make_problem(num_points=30, track=2, noise=3.0)
    plain = bundle.filter_observations(problem, 20.0, 20.0)
    gone = problem.point_ids[~plain.point_mask]
    assert len(gone) > 3
    kept = bundle.filter_observations(problem, 20.0, 20.0, kept_point_ids=gone)
    assert kept.num_points_removed == 0
    errors = bundle.reprojection_errors(problem)[0]
    np.testing.assert_array_equal(kept.observation_mask, errors <= 20.0)


def test_a_saved_model_has_no_link_to_what_was_removed(bundle_data, tmp_path):
    folder = bundle_data / "colmap" / "crane_mast"
    problem = bundle.load(folder)
    filtered = bundle.filter_observations(problem, 2.0, 5.0)
    bundle.save(filtered.problem, tmp_path / "model")
    model, source = pycolmap.Reconstruction(tmp_path / "model"), pycolmap.Reconstruction(folder)
    assert set(model.points3D) == set(filtered.problem.point_ids.tolist())
    for point_id, point in model.points3D.items():
        np.testing.assert_array_equal(point.color, source.points3D[point_id].color)
    links = 0
    for image_id, image in model.images.items():
        before = source.images[image_id]
        assert image.num_points2D() == before.num_points2D()
        links += image.num_points3D
        for index, keypoint in enumerate(image.points2D):
            np.testing.assert_array_equal(keypoint.xy, before.points2D[index].xy)
            if keypoint.has_point3D():
                elements = model.points3D[keypoint.point3D_id].track.elements
                assert any((e.image_id, e.point2D_idx) == (image_id, index) for e in elements)
    assert links == model.compute_num_observations() == filtered.problem.num_observations


def test_a_saved_bal_file_has_what_is_left(tmp_path):
    problem = scenes.scene(5, 40, noise=2.0)
    filtered = bundle.filter_observations(problem, 12.0, 1.0).problem
    assert 0 < filtered.num_observations < problem.num_observations
    bundle.save(filtered, tmp_path / "left.txt")
    again = bundle.load(tmp_path / "left.txt")
    np.testing.assert_array_equal(again.points, filtered.points)
    np.testing.assert_array_equal(again.observation_xy, filtered.observation_xy)
    np.testing.assert_array_equal(again.observation_point, filtered.observation_point)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("max_error", 0.0),
        ("max_error", -1),
        ("max_error", float("nan")),
        ("max_error", "4"),
        ("min_angle", -0.1),
        ("min_angle", 90.1),
        ("min_track_length", -1),
        ("min_track_length", 2.5),
        ("kept_point_ids", [10**6]),
        ("kept_point_ids", ["a"]),
    ],
)
def test_bad_limits_are_refused(name, value):
    with pytest.raises(bundle.InputError, match=rf"^{name}: [^\n]+$"):
        bundle.filter_observations(make_problem(num_points=5), **{name: value})


def dense_standardized(problem, loss="trivial", loss_scale=1.0):
    """Errors by R = I - J J^+ and its eigenvectors; and the blocks of R."""
    dense = Dense(problem, loss=loss, loss_scale=loss_scale)
    held = [j for j, name in enumerate(dense.names) if name[0] == "camera" and name[2] in (1, 2)]
    blocks = diagonal_blocks(residual_maker(np.delete(dense.jacobian, held, axis=1)))
    values, vectors = np.linalg.eigh(blocks)
    along = np.einsum("nji,nj->ni", vectors, dense.residual.reshape(-1, 2))
    squares = np.where(values >= 0.02, along**2 / np.maximum(values, 1e-9), 0).sum(axis=1)
    squares[values.max(axis=1) < 0.02] = np.nan
    sigma = 1.0 if problem.observation_sigma is None else problem.observation_sigma
    return sigma * np.sqrt(squares / dense.rho_prime)


@pytest.fixture(scope="module")
def uneven():
    """A refined problem with tracks of 2 to 5 rays, sigmas, and an error of 30 px."""
    problem = make_problem(num_points=25, seed=2, perturbation=1e-3, shared=True)
    keep = np.random.default_rng(2).random(problem.num_observations) < 0.8
    problem = scenes.with_observations(problem, keep)
    sigmas = np.random.default_rng(3).uniform(0.5, 2, problem.num_observations)
    xy = problem.observation_xy.copy()
    xy[40] += [18, -24]
    return bundle.solve(problem.replace(observation_xy=xy, observation_sigma=sigmas)).problem


@pytest.mark.parametrize("loss", ["trivial", "cauchy"])
def test_standardized_errors_agree_with_dense_matrices(uneven, loss):
    layout = lay_out(uneven, bundle.SolveOptions(loss=loss), ())
    errors, _ = bundle.reprojection_errors(uneven)
    given = layout.options.asdict(), layout.limits, layout.core_factors()
    found = standardized_errors(uneven, errors, given)
    np.testing.assert_allclose(found, dense_standardized(uneven, loss), rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("max_error", [0.5, 4.0, 12.0])
def test_a_standardized_filter_removes_the_largest_error_of_each_point(uneven, max_error):
    errors = dense_standardized(uneven)
    limit = max(max_error, 6 * np.median(errors) / 1.17741)
    largest = np.zeros(uneven.num_points)
    np.maximum.at(largest, uneven.observation_point, errors)
    bad = (errors > limit) & (errors == largest[uneven.observation_point])
    assert 0 < bad.sum() < 10
    settings = {"max_error": max_error, "min_angle": 0, "min_track_length": 0}
    found = bundle.filter_observations(uneven, **settings, standardized=True)
    np.testing.assert_array_equal(found.observation_mask, ~bad)
    ids = uneven.point_ids[uneven.observation_point[bad]]
    kept = bundle.filter_observations(uneven, **settings, standardized=True, kept_track_ids=ids)
    assert kept.num_observations_removed == 0


def test_errors_that_do_not_exist_are_removed_with_those_beyond_the_noise(uneven):
    errors = np.full(uneven.num_observations, 0.1)
    tested = errors.copy()
    errors[3] = np.nan
    tested[[3, 4, 40]] = np.nan, np.nan, 30.0  # nothing checks the second
    found = _of_suspects(uneven, errors, tested)
    assert np.isnan(found[3]) and found[40] == 30.0
    assert not np.delete(found, [3, 40]).any()


def test_an_observation_that_nothing_checks_stays(uneven):
    """An image with three observations, whose pose absorbs all their errors."""
    rows = np.flatnonzero(uneven.observation_image == 2)
    keep = np.ones(uneven.num_observations, bool)
    keep[rows[3:]] = False
    loose = scenes.with_observations(uneven.replace(observation_sigma=None), keep)
    loose = bundle.solve(loose, function_tolerance=1e-12).problem
    layout = lay_out(loose, bundle.SolveOptions(), ())
    errors, _ = bundle.reprojection_errors(loose)
    given = layout.options.asdict(), layout.limits, layout.core_factors()
    found = standardized_errors(loose, errors, given)
    np.testing.assert_array_equal(np.isnan(found), loose.observation_image == 2)
    settings = {"max_error": 1e-3, "min_angle": 0, "min_track_length": 0}
    kept = bundle.filter_observations(loose, **settings, standardized=True).observation_mask
    assert kept[loose.observation_image == 2].all() and not kept.all()


def test_errors_of_a_solution_that_is_not_determined_are_not_standardized(uneven):
    apart = (uneven.observation_image < 2) == (uneven.observation_point < 12)
    pieces = scenes.with_observations(uneven.replace(observation_sigma=None), apart)
    with pytest.raises(bundle.InputError, match="full rank"):
        bundle.reliability(pieces)
    settings = {"max_error": 0.5, "min_angle": 0, "min_track_length": 0}
    found = bundle.filter_observations(pieces, **settings, standardized=True)
    raw = bundle.filter_observations(pieces, **settings)
    assert 0 < raw.num_observations_removed < pieces.num_observations
    np.testing.assert_array_equal(found.observation_mask, raw.observation_mask)


def test_standardized_rounds_can_be_resumed_held_out_and_local(uneven, tmp_path):
    settings = {"num_rounds": 3, "standardized": True, "min_angle": 0, "deterministic": True}
    whole = bundle.solve_rounds(uneven, **settings)
    assert not whole.observation_mask[40]
    file = tmp_path / "checkpoint"
    bundle.solve_rounds(uneven, **settings, checkpoint=file)
    resumed = bundle.solve_rounds(uneven, **settings, resume=file)
    np.testing.assert_array_equal(resumed.observation_mask, whole.observation_mask)
    with pytest.raises(bundle.InputError, match="standardized"):
        bundle.solve_rounds(uneven, **{**settings, "standardized": False}, resume=file)
    held_out = bundle.solve_rounds(uneven, **settings, hold_out=10)
    np.testing.assert_array_equal(held_out.observation_mask, whole.observation_mask)
    image = int(uneven.image_ids[uneven.observation_image[40]])
    local = bundle.solve_rounds(uneven, **settings, only_images=[image])
    assert not local.observation_mask[40]
