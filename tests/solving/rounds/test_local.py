"""Adjustment of some images only, against pycolmap and against holding all else by hand."""

import json

import numpy as np
import pycolmap
import pytest

import bundle
from tests.scenes import make_problem

TIGHT = {"function_tolerance": 1e-14, "gradient_tolerance": 1e-12, "parameter_tolerance": 1e-14}


def chain(num_images=10, num_points=120, *, seed=2, **changes):
    """Each point is seen by three images in a row, so that a few images see few of the points."""
    problem = make_problem(num_images=num_images, num_points=num_points, seed=seed, noise=0.5)
    first = np.random.default_rng(seed).integers(0, num_images - 2, num_points)
    offset = problem.observation_image - first[problem.observation_point]
    left = (offset >= 0) & (offset < 3)
    names = ("observation_image", "observation_point", "observation_xy", "observation_keypoint")
    return problem.replace(**{n: getattr(problem, n)[left] for n in names}, **changes)


def test_agrees_with_pycolmap(bundle_data, backend):
    """On lund_door: images 1 to 6 and the points that they see, others and theirs held.

    The model is text of six digits. pycolmap normalises the quaternions of images that it refines
    and takes the others as they stand, so that those do not rotate quite: 9868.492767 ->
    9860.961701. With all of them normalised it agrees.
    """
    folder = bundle_data / "colmap" / "lund_door"
    reconstruction = pycolmap.Reconstruction(folder)
    for frame in reconstruction.frames.values():
        pose = frame.rig_from_world
        pose.rotation.normalize()
        frame.rig_from_world = pose
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in range(1, 7):
        config.add_image(image_id)
    boundary = 0
    for point_id, point in reconstruction.points3D.items():
        images = {element.image_id for element in point.track.elements}
        if min(images) <= 6 < max(images):
            config.add_variable_point(point_id)
            boundary += 1
    assert boundary == 7454
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    ceres = options.ceres.solver_options
    for name, value in TIGHT.items():
        setattr(ceres, name, value)
    options.ceres.solver_options = ceres
    expected = (
        pycolmap.create_default_bundle_adjuster(options, config, reconstruction)
        .solve()
        .ceres_summary
    )
    result = bundle.solve_rounds(folder, num_rounds=0, only_images="1-6", backend=backend, **TIGHT)
    assert result.summary.initial_cost == pytest.approx(expected.initial_cost, rel=1e-9)
    assert result.summary.final_cost == pytest.approx(expected.final_cost, rel=1e-9)
    assert expected.final_cost == pytest.approx(9860.961701, rel=1e-5)
    assert 2 * result.part.num_observations == expected.num_residuals
    before, after = result.initial_problem, result.problem
    np.testing.assert_array_equal(after.cam_from_world[6:], before.cam_from_world[6:])
    assert (after.cam_from_world[:6] != before.cam_from_world[:6]).any(axis=1).all()


def test_is_a_solve_with_all_else_held(backend):
    problem = chain()
    named = problem.image_ids[3:6]
    sees = np.isin(problem.observation_image, [3, 4, 5])
    points = np.unique(problem.observation_point[sees])
    whole = bundle.solve(
        problem,
        backend=backend,
        fixed_image_ids=np.setdiff1d(problem.image_ids, named),
        fixed_camera_ids=np.setdiff1d(problem.camera_ids, problem.camera_ids[3:6]),
        fixed_point_ids=np.delete(problem.point_ids, points),
        **TIGHT,
    )
    part = bundle.solve_rounds(problem, num_rounds=0, only_images=named, backend=backend, **TIGHT)
    np.testing.assert_allclose(part.problem.points, whole.problem.points, atol=1e-8)
    np.testing.assert_allclose(part.problem.cam_from_world, whole.problem.cam_from_world, atol=1e-8)
    np.testing.assert_allclose(part.problem.camera_params, whole.problem.camera_params, rtol=1e-6)
    others = np.delete(np.arange(problem.num_points), points)
    assert len(points) > 20 < len(others)
    for name, rows in (("points", others), ("cam_from_world", [0, 1, 2, 6, 7, 8, 9]),
                       ("camera_params", [0, 1, 2, 6, 7, 8, 9])):  # fmt: skip
        given, left = getattr(problem, name)[rows], getattr(part.problem, name)[rows]
        assert given.tobytes() == left.tobytes()
    record = part.part
    assert (record.num_images, record.num_images_held) == (3, 4)
    assert record.num_points == len(points)
    assert record.num_observations == np.isin(problem.observation_point, points).sum()
    assert record.shared_camera_ids == ()
    assert part.summary.num_residuals == 2 * record.num_observations
    assert part.options.fixed_image_ids == ()


def test_cameras_shared_with_held_images_are_named_and_can_be_held():
    problem = make_problem(num_images=6, num_points=60, shared=True, seed=4)
    free = bundle.solve_rounds(problem, num_rounds=0, only_images=[1, 2])
    assert free.part.shared_camera_ids == (1,)
    assert (free.problem.camera_params != problem.camera_params).any()
    held = bundle.solve_rounds(problem, num_rounds=0, only_images=[1, 2], fixed_camera_ids=[1])
    np.testing.assert_array_equal(held.problem.camera_params, problem.camera_params)
    assert held.options.fixed_camera_ids == (1,)


def test_rounds_filter_the_part_alone():
    problem = chain(num_points=200)
    xy = problem.observation_xy.copy()
    xy[::13] += 60.0
    problem = problem.replace(observation_xy=xy)
    result = bundle.solve_rounds(
        problem, num_rounds=3, max_error=6.0, only_images=[4, 5, 6], loss="cauchy"
    )
    in_part = np.isin(problem.observation_image, [3, 4, 5])
    seen = np.isin(np.arange(200), problem.observation_point[in_part])
    left = result.problem
    outside = np.flatnonzero(~seen)
    assert set(problem.point_ids[outside]) <= set(left.point_ids.tolist())
    rows = np.isin(left.point_ids, problem.point_ids[outside])
    assert left.points[rows].tobytes() == problem.points[outside].tobytes()
    of_outside = ~seen[problem.observation_point]
    kept = rows[left.observation_point]
    np.testing.assert_array_equal(left.observation_xy[kept], problem.observation_xy[of_outside])
    removed = sum(done.num_observations_removed for done in result.rounds)
    assert left.num_observations == problem.num_observations - removed
    assert removed > 10
    errors, _ = bundle.reprojection_errors(left)
    assert (errors[~kept] <= 6.0).all()
    assert (errors[kept] > 6.0).any()


def test_factors_of_what_is_not_in_the_part_are_kept():
    problem = chain()
    far = bundle.PriorFactor(("point", 1), problem.points[0] + 1.0, np.eye(3))
    near = bundle.PositionFactor(("image", 5), problem.projection_centers[4], 1e4)
    result = bundle.solve_rounds(
        problem, num_rounds=0, only_images=[5], factors=[far, near], backend="ceres"
    )
    assert result.summary.num_factors == 2
    assert result.factor_costs_after[0] == pytest.approx(1.5)
    sees_first = problem.observation_image[problem.observation_point == 0]
    assert 4 not in sees_first, "the point is not in the part"
    np.testing.assert_array_equal(result.problem.points[0], problem.points[0])


@pytest.mark.parametrize(
    ("selection", "expected"),
    [
        ("3", (3,)),
        ("1,3-5", (1, 3, 4, 5)),
        ("image2.jpg, 9", (3, 9)),
        ("image[13].jpg", (2, 4)),
        ("image1*", (2,)),
        ([2, "image?.jpg"], tuple(range(1, 11))),
        ("*", tuple(range(1, 11))),
    ],
)
def test_images_are_named_by_ids_and_patterns(selection, expected):
    from bundle.model.problem_keys import find_images

    assert find_images("x", make_problem(num_images=10, num_points=3), selection) == expected


@pytest.mark.parametrize(
    "selection",
    ["77", "5-2", "", "1,,2", "nobody", "IMAGE*", [], [1.5], 3, [True], "1-99999999999"],
)
def test_bad_images_are_refused(selection):
    with pytest.raises(bundle.InputError, match=r"^only_images: [^\n]+$"):
        bundle.solve_rounds(make_problem(num_points=9), num_rounds=0, only_images=selection)


def test_ids_to_hold_have_to_exist_in_the_whole_problem():
    problem = chain()
    assert bundle.solve_rounds(problem, num_rounds=0, only_images=[1], fixed_point_ids=[1, 2, 3])
    with pytest.raises(bundle.InputError, match=r"^fixed_point_ids: .*999"):
        bundle.solve_rounds(problem, num_rounds=0, only_images=[1], fixed_point_ids=[999])


@pytest.fixture
def model(tmp_path):
    bundle.save(chain(), tmp_path / "model")
    return tmp_path / "model"


def test_the_command_leaves_the_rest(run, model, tmp_path):
    report = tmp_path / "report.json"
    code, out, _ = run(
        *("refine", model, "-o", tmp_path / "out", "--only-images", "4-5,image6*"),
        *("--fix-images", "image1.*", "--json", report, "--verbose"),
    )
    assert code == 0
    found = json.loads(report.read_text())
    assert found["part"]["num_images"] == 3
    assert found["options"]["fixed_image_ids"] == [2]
    assert found["options"]["only_images"] == "4-5,image6*"
    assert str(found["part"]["num_observations"]) in out
    before, after = bundle.load(model), bundle.load(tmp_path / "out")
    moved = (before.cam_from_world != after.cam_from_world).any(axis=1)
    np.testing.assert_array_equal(np.flatnonzero(moved), [3, 4, 6])


@pytest.mark.parametrize(
    ("flags", "named"),
    [
        (["--only-images", "88"], "--only-images: there is no image 88"),
        (["--only-images", "a*"], "--only-images: expected ids or names"),
        (["--only-images", ""], "--only-images"),
        (["--fix-images", "a*"], "--fix-images: expected ids or names"),
    ],
)
def test_the_command_names_the_flag(run, model, tmp_path, flags, named):
    code, _, err = run("refine", model, "-o", tmp_path / "out", "--quiet", *flags)
    assert code == 2
    (line,) = err.splitlines()
    assert named in line
