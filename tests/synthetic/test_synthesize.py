"""Scenes as a whole: what every kind promises, measured on what comes out."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

import bundle
from bundle import InputError, SceneOptions, SyntheticScene, synthesize
from bundle.interface.scene_options import CAMERA_MODELS
from tests.scenes import project

KINDS = ("street", "orbit", "photo_collection")
SIZES = {
    "street": {"num_images": 80, "num_points": 5000},
    "orbit": {"num_images": 60, "num_points": 4000},
    "photo_collection": {"num_images": 120, "num_points": 8000},
}
ARRAYS = tuple(
    field.name for field in dataclasses.fields(bundle.Problem) if field.name not in {"source"}
)


@pytest.fixture(scope="module", params=KINDS)
def scene(request: pytest.FixtureRequest) -> SyntheticScene:
    kind = request.param
    return synthesize(scene=kind, seed=5, outlier_share=0.03, pixel_noise=0.8, **SIZES[kind])


def residuals(problem):
    """Projection minus measurement and depth, by SciPy's rotations and formulas of the tests."""
    poses = problem.cam_from_world[problem.observation_image]
    points = problem.points[problem.observation_point]
    in_camera = Rotation.from_quat(poses[:, :4]).apply(points) + poses[:, 4:]
    camera = problem.image_camera[problem.observation_image]
    xy = np.empty_like(problem.observation_xy)
    for index in range(problem.num_cameras):
        mine = camera == index
        params = problem.camera_params[index]
        xy[mine] = project(problem.camera_models[index], params, in_camera[mine])
    return xy - problem.observation_xy, in_camera[:, 2]


def rms(residual):
    return np.sqrt((residual**2).sum(axis=1).mean())


def projection_centers(problem):
    rotations = Rotation.from_quat(problem.cam_from_world[:, :4])
    return -rotations.inv().apply(problem.cam_from_world[:, 4:].copy())


def shared_points(problem):
    """(num_images, num_images) how many points each pair of images shares."""
    seen = np.zeros((problem.num_points, problem.num_images), dtype=np.float32)
    seen[problem.observation_point, problem.observation_image] = 1
    return (seen.T @ seen).astype(int)


@pytest.mark.parametrize("kind", KINDS)
def test_same_seed_same_bits(kind):
    one, two = (synthesize(scene=kind, num_images=30, num_points=900, seed=3) for _ in range(2))
    for name in ARRAYS:
        assert_array_equal(getattr(one.problem, name), getattr(two.problem, name), err_msg=name)
        assert_array_equal(getattr(one.ground_truth, name), getattr(two.ground_truth, name))
    other = synthesize(scene=kind, num_images=30, num_points=900, seed=4)
    assert not np.array_equal(one.ground_truth.points, other.ground_truth.points)


def test_noise_does_not_change_the_structure():
    quiet = synthesize(num_images=20, num_points=500, pixel_noise=0.0)
    noisy = synthesize(num_images=20, num_points=500, pixel_noise=2.0, outlier_share=0.2)
    for name in ("points", "cam_from_world", "camera_params", "observation_image"):
        assert_array_equal(getattr(quiet.ground_truth, name), getattr(noisy.ground_truth, name))
    residual, _ = residuals(quiet.ground_truth)
    assert np.abs(residual).max() < 1e-9


def test_counts_ids_and_order(scene):
    problem, options = scene.problem, scene.options
    assert (problem.num_images, problem.num_points) == (options.num_images, options.num_points)
    assert problem.format == "memory"
    assert problem.image_names[0] == f"{options.scene}_0001.jpg"
    for ids in (problem.image_ids, problem.camera_ids, problem.point_ids):
        assert_array_equal(ids, np.arange(1, len(ids) + 1))
    code = problem.observation_point.astype(np.int64) * problem.num_images
    assert (np.diff(code + problem.observation_image) > 0).all()
    for image in range(problem.num_images):
        numbers = problem.observation_keypoint[problem.observation_image == image]
        assert_array_equal(numbers, np.arange(len(numbers)))


def test_start_and_truth_share_the_observations(scene):
    for name in ARRAYS:
        start, truth = getattr(scene.problem, name), getattr(scene.ground_truth, name)
        perturbed = name in {"cam_from_world", "points", "camera_params"}
        assert np.array_equal(start, truth) != perturbed, name


def test_everything_is_seen_enough_and_connected(scene):
    problem = scene.problem
    tracks = np.bincount(problem.observation_point, minlength=problem.num_points)
    images = np.bincount(problem.observation_image, minlength=problem.num_images)
    assert tracks.min() >= 2
    assert images.min() >= 20
    nodes = problem.num_images + problem.num_points
    edges = (problem.observation_image, problem.num_images + problem.observation_point)
    graph = coo_array((np.ones(problem.num_observations), edges), shape=(nodes, nodes))
    assert connected_components(graph, directed=False)[0] == 1


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("asked", [3.0, 6.0, 10.0])
def test_mean_track_length(kind, asked):
    problem = synthesize(scene=kind, mean_track_length=asked, **SIZES[kind]).problem
    assert problem.num_observations / problem.num_points == pytest.approx(asked, rel=0.05)


def test_truth_explains_the_observations_up_to_noise(scene):
    problem = scene.ground_truth
    residual, depth = residuals(problem)
    assert depth.min() > 0
    inlier = ~scene.is_outlier
    assert rms(residual[inlier]) == pytest.approx(0.8 * np.sqrt(2), rel=0.02)
    sizes = problem.camera_sizes[problem.image_camera][problem.observation_image]
    exact = problem.observation_xy + residual
    for xy in (exact, problem.observation_xy):
        assert (xy >= 0).all()
        assert (xy <= sizes).all()


def test_outliers_are_uniform_and_as_many_as_asked(scene):
    problem = scene.problem
    assert scene.is_outlier.sum() == round(0.03 * problem.num_observations)
    sizes = problem.camera_sizes[problem.image_camera][problem.observation_image]
    where = (problem.observation_xy / sizes)[scene.is_outlier]
    count = len(where)
    for axis in range(2):
        in_bin = np.histogram(where[:, axis], bins=5, range=(0, 1))[0]
        chi_squared = ((in_bin - count / 5) ** 2 / (count / 5)).sum()
        assert chi_squared < 18.5  # 99.9 % for 4 degrees of freedom


def test_start_is_perturbed_as_asked():
    scene = synthesize(
        scene="orbit", num_images=400, num_points=4000, cameras="individual", camera_model="OPENCV",
        rotation_noise=2.0, translation_noise=0.02, point_noise=0.01, focal_noise=0.05,
        distortion_noise=0.01, seed=2,
    )  # fmt: skip
    start, truth = scene.problem, scene.ground_truth
    rotations = [Rotation.from_quat(p.cam_from_world[:, :4]) for p in (start, truth)]
    turn = np.degrees((rotations[0] * rotations[1].inv()).as_rotvec())
    assert turn.std() == pytest.approx(2.0, rel=0.1)
    centers = [projection_centers(p) for p in (start, truth)]
    rays = truth.points[truth.observation_point] - centers[1][truth.observation_image]
    scale = np.median(np.linalg.norm(rays, axis=1))
    assert (centers[0] - centers[1]).std() == pytest.approx(0.02 * scale, rel=0.1)
    assert (start.points - truth.points).std() == pytest.approx(0.01 * scale, rel=0.1)
    ratio = start.camera_params[:, :2] / truth.camera_params[:, :2]
    np.testing.assert_allclose(ratio[:, 0], ratio[:, 1], rtol=1e-12)
    assert ratio[:, 0].std() == pytest.approx(0.05, rel=0.15)
    change = start.camera_params - truth.camera_params
    assert_array_equal(change[:, 2:4], 0)
    assert change[:, 4:6].std() == pytest.approx(0.01, rel=0.1)
    assert change[:, 6:8].std() == pytest.approx(0.001, rel=0.1)


@pytest.mark.parametrize("model", CAMERA_MODELS)
@pytest.mark.parametrize("kind", KINDS)
def test_start_is_far_off_and_refinable(kind, model):
    scene = synthesize(
        scene=kind, num_images=24, num_points=800, mean_track_length=5, camera_model=model, seed=3
    )
    assert rms(residuals(scene.problem)[0]) > 10 * rms(residuals(scene.ground_truth)[0])
    settings = {"max_num_iterations": 200, "function_tolerance": 1e-10}
    from_start = bundle.solve(scene.problem, **settings)
    from_truth = bundle.solve(scene.ground_truth, **settings)
    assert from_start.summary.final_cost == pytest.approx(from_truth.summary.final_cost, rel=1e-4)


def test_street_is_banded():
    street = {"num_images": 200, "num_points": 10000, "seed": 1}
    one_way = shared_points(synthesize(loop_closure=False, **street).problem)
    apart = np.abs(np.subtract.outer(np.arange(200), np.arange(200)))
    assert (one_way[apart > 40] == 0).all()
    assert (one_way[apart == 1] >= 20).all()
    laps = shared_points(synthesize(loop_closure=True, **street).problem)
    far = laps[apart > 40]
    assert 0.005 < (far > 0).mean() < 0.2
    assert far.max() >= 20


def test_orbit_sees_a_point_over_an_arc():
    scene = synthesize(scene="orbit", **SIZES["orbit"], num_rings=1, mean_track_length=8)
    truth = scene.ground_truth
    centers = projection_centers(truth)
    azimuth = np.unwrap(np.arctan2(centers[:, 1], centers[:, 0]))
    assert np.ptp(azimuth) > np.radians(345)
    # Half the widest angle between a normal and a line of sight on either side, and the parallax.
    shared = shared_points(truth)
    between = np.abs(np.subtract.outer(azimuth, azimuth))
    between = np.minimum(between, 2 * np.pi - between)
    assert (shared[between > np.radians(150)] == 0).all()
    assert (shared[between < np.radians(20)] > 0).all()


def test_photo_collection_is_heavy_tailed_and_clustered():
    problem = synthesize(
        scene="photo_collection", num_images=300, num_points=20000, mean_track_length=6, seed=1
    ).ground_truth
    tracks = np.bincount(problem.observation_point)
    assert np.median(tracks) < 0.8 * tracks.mean()
    assert np.quantile(tracks, 0.999) > 6 * tracks.mean()
    images = np.bincount(problem.observation_image)
    assert images.max() > 4 * np.median(images)
    focal = problem.camera_params[:, 0] / problem.camera_sizes.max(axis=1)
    assert focal.max() > 5 * focal.min()
    sizes = problem.camera_sizes.max(axis=1)
    assert sizes.max() > 3 * sizes.min()
    # Two images that share points with a third one mostly share points with each other.
    linked = shared_points(problem) >= 5
    np.fill_diagonal(linked, False)
    paths = linked.astype(float) @ linked
    np.fill_diagonal(paths, 0)
    assert paths[linked].sum() / paths.sum() > 2 * linked.mean()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("cameras", ["shared", "individual"])
def test_cameras(kind, cameras):
    problem = synthesize(
        scene=kind, num_images=30, num_points=900, cameras=cameras, image_size=(800, 600)
    ).problem
    assert problem.num_cameras == (1 if cameras == "shared" else 30)
    assert len(set(problem.image_camera)) == problem.num_cameras
    if cameras == "shared":
        assert_array_equal(problem.camera_sizes, [[800, 600]])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scene": "orbit", "num_images": 8, "mean_track_length": 8}, "mean_track_length: "),
        ({"scene": "orbit", "num_images": 200, "num_points": 20}, "num_points: "),
        ({"colour": "red"}, "synthesize: there is no option 'colour'"),
    ],
)
def test_impossible_scenes(changes, message):
    with pytest.raises(InputError, match=message):
        synthesize(**changes)


def test_options_and_changes_combine():
    options = SceneOptions(num_images=12, num_points=300, mean_track_length=3)
    scene = synthesize(options, scene="orbit")
    assert scene.options == options.replace(scene="orbit")
    assert scene.problem.num_images == 12
