"""Statistics against counts made one observation at a time, and every suspicion provoked alone."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle import _core
from bundle.analysis.diagnosis import track_table
from bundle.analysis.diagnosis.track_table import components, covisibility
from bundle.analysis.statistics.description import describe
from bundle.analysis.statistics.suspicions import fold_radius, lenses
from tests.scenes import make_problem, scene

PARTS = ["cam_from_world", "image_ids", "image_names", "image_camera", "camera_ids"]
PARTS += ["camera_models", "camera_params", "camera_sizes", "points", "point_ids"]


def random_graph(seed, num_images=12, num_points=40, num_observations=90):
    """A scene whose observations are drawn at random: repeated ones, empty images and points."""
    rng = np.random.default_rng(seed)
    return scene(
        num_images,
        num_points,
        observation_image=rng.integers(0, num_images, num_observations),
        observation_point=rng.integers(0, num_points, num_observations),
        observation_xy=rng.normal(size=(num_observations, 2)),
        observation_keypoint=np.full(num_observations, -1),
    )


def kinds(problem):
    return {suspicion.kind: suspicion for suspicion in describe(problem).suspicions}


def observe(problem, keep, **changes):
    """The same problem with some of its observations."""
    names = ("observation_image", "observation_point", "observation_xy", "observation_keypoint")
    return problem.replace(**{name: getattr(problem, name)[keep] for name in names}, **changes)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("cells", [2**27, 30])  # 30: two rows of the adjacency at a time
def test_covisibility_against_sets(monkeypatch, seed, cells):
    monkeypatch.setattr(track_table, "_CELLS", cells)
    problem = random_graph(seed, num_observations=15 * (seed + 1))
    seen_by = {}
    for image, point in zip(problem.observation_image, problem.observation_point, strict=True):
        seen_by.setdefault(int(point), set()).add(int(image))
    pairs = {pair for images in seen_by.values() for pair in itertools.combinations(images, 2)}
    pairs = {tuple(sorted(pair)) for pair in pairs}
    graph = covisibility(problem)
    degree = [sum(image in pair for pair in pairs) for image in range(problem.num_images)]
    assert graph.neighbours.tolist() == degree
    assert graph.num_pairs == len(pairs)
    assert graph.schur_fill == pytest.approx((12 + 2 * len(pairs)) / 144)

    groups = [{image} for image in set(problem.observation_image.tolist())]
    for a, b in pairs:
        with_a = next(group for group in groups if a in group)
        with_b = next(group for group in groups if b in group)
        if with_a is not with_b:
            groups.remove(with_b)
            with_a |= with_b
    assert list(graph.component_sizes) == sorted(map(len, groups), reverse=True)
    for group in groups:
        assert len({int(graph.component[image]) for image in group}) == 1
    unseen = np.setdiff1d(np.arange(12), problem.observation_image)
    assert (graph.component[unseen] == -1).all()
    assert (graph.component >= 0).sum() == 12 - len(unseen)


def test_components_of_a_long_chain_in_shuffled_order():
    """A street: image i shares a point only with image i + 1."""
    count = 2000
    order = np.random.default_rng(0).permutation(count)
    images = np.stack([order[:-1], order[1:]], axis=1).ravel()
    points = np.repeat(np.arange(count - 1), 2)
    component, sizes = components(images, points, count)
    assert sizes == (count,)
    assert (component == 0).all()
    # Without point 700 the street is in two.
    component, sizes = components(images[points != 700], points[points != 700], count)
    assert sizes == (count - 701, 701)
    assert (component[order[:701]] == 1).all()


def test_counts_and_histograms():
    problem = scene(4, 30)
    keep = (problem.observation_image < 3) | (problem.observation_point < 10)
    problem = observe(problem, keep)
    description = describe(problem)
    images = description.observations_per_image
    assert (images.min, images.median, images.mean, images.max) == (10, 30, 25, 30)
    assert images.histogram == ((9, 16, 1), (17, 32, 3))
    assert description.track_length.histogram == ((3, 4, 30),)
    (group,) = description.cameras
    assert (group.model, group.num_cameras, group.num_images) == ("RADIAL", 4, 4)
    assert group.images_per_camera == (1, 1)
    assert group.focal == (800, 803)
    assert group.supported


@pytest.mark.parametrize(
    ("length", "low", "high"), [(0, 0, 0), (1, 1, 1), (2, 2, 2), (3, 3, 4), (4, 3, 4), (5, 5, 8)]
)
def test_histogram_bins(length, low, high):
    problem = scene(6, 2)
    keep = problem.observation_image < length
    assert describe(observe(problem, keep)).track_length.histogram == ((low, high, 2),)


def test_problem_without_anything():
    empty = observe(scene(), slice(0), **{name: getattr(scene(), name)[:0] for name in PARTS})
    description = describe(empty)
    assert np.isnan(description.track_length.mean)
    assert description.observations_per_image.histogram == ()
    assert np.isnan(description.covisibility.schur_fill)
    assert description.reprojection_error.num_observations == 0
    assert [suspicion.kind for suspicion in description.suspicions] == ["no_observations"]


def test_sound_scene_raises_no_suspicion():
    assert kinds(scene()) == {}


def test_images():
    problem = scene(5, 30, image_ids=np.arange(5) + 100)
    keep = (problem.observation_image < 3) | (
        (problem.observation_image == 3) & (problem.observation_point < 9)
    )
    found = kinds(observe(problem, keep))
    assert set(found) == {"images_without_observations", "images_with_few_observations"}
    assert found["images_without_observations"].evidence["ids"] == [104]
    assert found["images_with_few_observations"].sentence == (
        "1 image has fewer than 10 observations (image 103)."
    )


def test_points():
    problem = scene(4, 30, point_ids=np.arange(30) + 1000)
    keep = (problem.observation_point >= 8) | (
        (problem.observation_point < 7) & (problem.observation_image == 0)
    )
    found = kinds(observe(problem, keep))
    assert found["points_seen_once"].evidence["count"] == 7
    assert found["points_seen_once"].sentence == (
        "7 points are seen only once: the depth is free (points 1000, 1001, 1002, 1003, 1004, ...)."
    )
    assert found["points_not_seen"].evidence["ids"] == [1007]


def test_pieces_without_common_points():
    problem = scene(4, 30)
    keep = (problem.observation_image < 3) == (problem.observation_point < 15)
    found = kinds(observe(problem, keep))
    assert found["disconnected"].evidence["count"] == 2
    assert found["disconnected"].evidence["ids"] == [3]
    assert "(of 3, 1 images)" in found["disconnected"].sentence


def test_repeated_observations_are_counted_beyond_the_first_and_no_fault():
    problem = scene()
    index = np.concatenate([np.arange(120), [5, 5, 40]])
    description = describe(observe(problem, index))
    assert description.num_repeated_observations == 3
    assert description.suspicions == ()
    assert describe(problem).num_repeated_observations == 0


def test_depths_against_rotation_matrices():
    problem = random_graph(3)
    poses = problem.cam_from_world.copy()
    poses[:, :4] = np.random.default_rng(0).standard_normal((len(poses), 4))
    problem = problem.replace(cam_from_world=poses)
    depths = [
        (Rotation.from_quat(poses[i, :4].copy()).as_matrix() @ problem.points[p] + poses[i, 4:])[2]
        for i, p in zip(problem.observation_image, problem.observation_point, strict=True)
    ]
    found = describe(problem).depths
    expected = np.quantile(depths, [0, 0.05, 0.5, 0.95, 1])
    assert [found.min, found.p5, found.median, found.p95, found.max] == pytest.approx(expected)
    assert found.num_behind == sum(depth <= 0 for depth in depths)


@pytest.mark.parametrize(("share", "is_collapsed"), [(0.9e-4, True), (1.1e-4, False)])
def test_points_collapsed_onto_a_camera(share, is_collapsed):
    problem = scene()
    median = describe(problem).depths.median
    chosen = np.flatnonzero(problem.observation_image == 1)[:3]
    points, poses = problem.points.copy(), problem.cam_from_world
    rotation = Rotation.from_quat(poses[1, :4].copy())
    at = rotation.inv().apply([0.0, 0.0, share * median] - poses[1, 4:])
    points[problem.observation_point[chosen]] = at
    description = describe(problem.replace(points=points))
    found = {suspicion.kind: suspicion for suspicion in description.suspicions}
    assert ("collapsed_points" in found) == is_collapsed
    if is_collapsed:
        assert found["collapsed_points"].evidence["count"] == 3
        assert found["collapsed_points"].evidence["of"] == "point"
        assert description.depths.num_collapsed == 3


def test_errors_are_computed_once(monkeypatch):
    calls = []
    original = _core.reprojection_errors
    monkeypatch.setattr(_core, "reprojection_errors", lambda *a: calls.append(0) or original(*a))
    describe(scene())
    assert len(calls) == 1


def test_behind_the_camera():
    problem = scene()
    poses = problem.cam_from_world.copy()
    poses[2, 6] = -6.0
    found = kinds(problem.replace(cam_from_world=poses))
    assert found["observations_behind_camera"].evidence["count"] == 30
    assert found["observations_behind_camera"].evidence["ids"] == [2]
    assert "gross_errors" not in found


def test_gross_errors():
    problem = scene()
    xy = problem.observation_xy.copy()
    xy[[3, 70]] += 400.0
    found = kinds(problem.replace(observation_xy=xy))
    assert found["gross_errors"].evidence["count"] == 2
    assert found["gross_errors"].evidence["ids"] == sorted(problem.observation_image[[3, 70]])


@pytest.mark.parametrize(
    ("field", "column", "value"),
    [
        ("camera_params", 0, 1e-308),  # errors in focal lengths
        ("camera_params", 0, 1e308),  # the sum of the errors
        ("cam_from_world", 4, 1e308),  # the errors themselves
        ("points", slice(None), 1e300),  # distances
        ("observation_xy", 0, 1e308),
    ],
)
def test_what_no_double_holds_is_described_all_the_same(field, column, value):
    """Any finite number is legal; warnings are errors here."""
    problem = scene()
    numbers = getattr(problem, field).copy()
    numbers[:, column] = value * (numbers if field == "points" else 1)
    description = describe(problem.replace(**{field: numbers}))
    error = description.reprojection_error
    assert error.num_observations == problem.num_observations
    assert not np.isnan([error.rmse, error.mean, error.median, error.p95, error.max]).any()
    assert {s.kind for s in description.suspicions} & {"gross_errors", "absurd_focal_lengths"}


def test_an_infinite_error_is_gross_however_many_are():
    problem = scene()
    poses = problem.cam_from_world.copy()
    poses[:, 4] = 1e308
    assert kinds(problem.replace(cam_from_world=poses))["gross_errors"].evidence["count"] == 120


def test_quaternions():
    poses = scene().cam_from_world.copy()
    poses[1, :4] *= 1.001
    assert kinds(scene(cam_from_world=poses))["quaternions_not_normalised"].evidence["ids"] == [1]


@pytest.mark.parametrize("known_size", [True, False])
@pytest.mark.parametrize("focal", [2e4, 20.0])
def test_focal_lengths(focal, known_size):
    problem = scene(camera_sizes=np.full((4, 2), 600) if known_size else np.zeros((4, 2)))
    params = problem.camera_params.copy()
    params[3, 0] = focal
    found = kinds(problem.replace(camera_params=params))
    assert found["absurd_focal_lengths"].evidence["ids"] == [3]


def test_folding_distortion():
    params = scene().camera_params.copy()
    params[0, 3] = -40.0  # folds at r = 1 / sqrt(120), distorted 0.061: 31 px
    found = kinds(scene(camera_params=params))
    assert found["folding_distortion"].evidence["ids"] == [0]


@pytest.mark.parametrize(("gain", "is_absurd"), [(0.99, False), (1.01, True)])
def test_absurd_distortion(gain, is_absurd):
    problem = scene()
    params = problem.camera_params.copy()
    camera = problem.image_camera[problem.observation_image]
    radius = np.hypot(*(problem.observation_xy[camera == 2] - params[2, 1:3]).T).max()
    params[2, 3] = gain * (2.0 * params[2, 0] / radius) ** 2  # half the radius is doubled at 1
    found = kinds(problem.replace(camera_params=params))
    assert ("absurd_distortion" in found) == is_absurd
    assert "folding_distortion" not in found
    if is_absurd:
        assert found["absurd_distortion"].evidence["ids"] == [2]


@pytest.mark.parametrize(
    ("k1", "k2", "kind"),
    [
        # Coefficients for the farthest observation at 1.
        (4.4, -0.1, "absurd_distortion"),  # folds at 244
        (-14.0, 80.0, "folding_distortion"),  # folds at 0.11, and grows again beyond
    ],
)
def test_a_lens_folds_or_stretches(k1, k2, kind):
    problem = scene().replace(camera_models=("RADIAL",) * 4)
    params = problem.camera_params.copy()
    camera = problem.image_camera[problem.observation_image]
    radius = np.hypot(*(problem.observation_xy[camera == 2] - params[2, 1:3]).T).max()
    square = (params[2, 0] / radius) ** 2
    params[2, 3:] = k1 * square, k2 * square**2
    found = kinds(problem.replace(camera_params=params))
    assert {"absurd_distortion", "folding_distortion"} & set(found) == {kind}


@pytest.mark.parametrize("k1", [-0.4, -0.05, 0.0, 0.3])
@pytest.mark.parametrize("k2", [-0.2, -0.01, 0.0, 0.01, 0.2])
def test_fold_radius_against_sampling(k1, k2):
    r = np.linspace(0, 20, 200_001)
    distorted = r * (1 + k1 * r**2 + k2 * r**4)
    falls = np.flatnonzero(np.diff(distorted) < 0)
    expected = distorted[falls[0]] if len(falls) else np.inf
    assert fold_radius(np.array([k1]), np.array([k2]))[0] == pytest.approx(expected, rel=1e-6)


def test_lens_of_a_camera_that_nothing_observes():
    problem = scene()
    problem = observe(problem, problem.observation_image < 2)
    lens = lenses(problem)
    assert np.isnan(lens.farthest[2:]).all()
    assert np.isnan(lens.size[2:]).all()
    assert np.isfinite(lens.farthest[:2]).all()


def test_positions():
    points = scene().points.copy()
    points[4] = [0, 0, 1e6]
    assert kinds(scene(points=points))["far_points"].evidence["ids"] == [4]
    moved = scene().points + np.array([4e6, 5e6, 0])
    assert "6.4e+06" in kinds(scene(points=moved))["far_from_origin"].sentence


def test_outside_the_image():
    found = kinds(scene(kind="colmap", camera_sizes=np.full((4, 2), 4000)))
    xy = scene().observation_xy
    assert found["observations_outside_image"].evidence["count"] == int((xy < 0).any(1).sum())


def test_cameras_that_no_image_uses():
    found = kinds(scene(image_camera=np.array([0, 0, 1, 1])))
    assert found["unused_cameras"].evidence["ids"] == [2, 3]


def test_a_panorama_has_no_lens():
    problem = make_problem(model="EQUIRECTANGULAR")
    lens = lenses(problem)
    assert np.isnan(lens.focal).all()
    assert np.isinf(lens.fold).all()
    assert (lens.size == 800).all()
    (group,) = describe(problem).cameras
    assert group.supported
    assert group.focal is None
    assert not {"absurd_focal_lengths", "folding_distortion"} & set(kinds(problem))


@pytest.mark.parametrize("model", bundle.camera_models())
def test_every_model_is_described(model):
    problem = make_problem(model=model)
    (group,) = describe(problem).cameras
    assert group.model == model
    assert not {"unsupported_camera_models", "folding_distortion"} & set(kinds(problem))
