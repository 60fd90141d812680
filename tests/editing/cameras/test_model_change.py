"""Cameras with another model: from the same pixels, or nearly, and a solve goes on from there."""

import numpy as np
import pycolmap
import pytest

import bundle
from bundle import InputError
from bundle.model.lenses.exact_image import angles, pixel_rays
from tests.formulas import PARAMS
from tests.io.colmap_models import fields, synthesize
from tests.scenes import make_problem, project, scene

LENSES = [model for model in PARAMS if model != "EQUIRECTANGULAR"]


@pytest.mark.parametrize("model", LENSES)
def test_the_ray_of_a_pixel_has_that_pixel(model):
    rng = np.random.default_rng(5)
    params = np.array(PARAMS[model])
    xy = np.vstack([rng.uniform((0, 0), (800, 600), (300, 2)), [params[-3:-1], [400.0, 300.0]]])
    rays, found = pixel_rays(model, params, xy)
    assert found.all()
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1, rtol=1e-14)
    off = np.abs(rays[:, :2]).max(axis=1) > 1e-6  # the formulas divide by zero on the axis
    np.testing.assert_allclose(project(model, params, rays[off]), xy[off], rtol=0, atol=1e-6)


def test_rays_beyond_ninety_degrees_and_pixels_beyond_the_fold():
    wide = np.array([300.0, 300, 400, 400])
    angle = np.radians([20.0, 89, 91, 130, 170])
    xy = np.column_stack([400 + 300 * angle, np.full(5, 400.0)])
    rays, found = pixel_rays("FISHEYE", wide, xy)
    assert found.all()
    np.testing.assert_allclose(angles(rays), angle, atol=1e-9)
    # f u (1 - 0.3 u^2) is at most f 2 / 3 / sqrt(0.9).
    folded = np.array([1000.0, 0, 0, -0.3])
    edge = 1000 * 2 / 3 / np.sqrt(0.9)
    _, found = pixel_rays("SIMPLE_RADIAL", folded, np.array([[edge - 1, 0], [edge + 1, 0]]))
    assert found.tolist() == [True, False]


@pytest.mark.parametrize(
    ("old", "new", "worst"),
    [
        ("SIMPLE_RADIAL", "SIMPLE_PINHOLE", 3.0),
        ("OPENCV", "RAD_TAN_THIN_PRISM_FISHEYE", 0.05),
        ("OPENCV_FISHEYE", "FULL_OPENCV", 1e-5),
        ("EUCM", "OPENCV_FISHEYE", 1e-5),
        ("FISHEYE", "FOV", 1e-6),  # 2 tan(omega / 2) = 1 makes it equidistant
        ("SIMPLE_PINHOLE", "FOV", 0.01),
        ("DIVISION", "EUCM", 0.02),
    ],
)
def test_a_fit_is_as_near_as_it_says(old, new, worst):
    problem = make_problem(num_images=3, num_points=80, model=old, shared=True, noise=0)
    changed = bundle.change_camera_model(problem, new)
    (change,) = changed.changes
    assert (change.exact, change.converged, change.num_without_ray) == (False, True, 0)
    assert (change.old_model, change.new_model) == (old, new)
    assert change.num_observations == problem.num_observations
    # Rays of the pixels by the old model, pixels of these by the tests' formula of the new one.
    rays, _ = pixel_rays(old, problem.camera_params[0], problem.observation_xy)
    params = changed.problem.camera_params[0]
    assert list(change.after.values()) == params.tolist()
    off = np.linalg.norm(project(new, params, rays) - problem.observation_xy, axis=1)
    assert change.max == pytest.approx(off.max(), rel=1e-6, abs=1e-9)
    assert change.rms == pytest.approx(np.sqrt(np.mean(off**2)), rel=1e-6, abs=1e-9)
    assert change.max < worst
    assert bool(changed.warnings) == (change.max > 1)


def test_a_fit_is_a_minimum():
    """No parameter can be changed so that the fitted pixels come nearer."""
    problem = make_problem(num_images=2, model="RADIAL", shared=True, noise=0)
    params = np.array([800.0, 400, 300, -0.2, 0.05])
    problem = problem.replace(camera_params=params[None], camera_sizes=[[800, 600]])
    keep = np.zeros(problem.num_observations, bool)  # so that the whole image counts
    keep[:2] = True
    names = ("observation_image", "observation_point", "observation_xy", "observation_keypoint")
    problem = problem.replace(**{name: getattr(problem, name)[keep] for name in names})
    changed = bundle.change_camera_model(problem, "SIMPLE_RADIAL")
    found = changed.problem.camera_params[0]
    side = np.stack(np.meshgrid(np.linspace(0, 800, 24), np.linspace(0, 600, 24)), -1)
    xy = side.reshape(-1, 2)
    rays, _ = pixel_rays("RADIAL", params, xy)

    def cost(p):
        return np.sum((project("SIMPLE_RADIAL", p, rays) - xy) ** 2)

    for index in range(4):
        step = np.zeros(4)
        step[index] = 1e-4 * max(1.0, abs(found[index]))
        assert cost(found) <= min(cost(found + step), cost(found - step)) + 1e-9


@pytest.mark.parametrize("backend", ["ceres", "fused"])
def test_a_solve_goes_on_below_the_optimum_of_the_old_model(backend):
    truth = make_problem(model="OPENCV", shared=True, num_points=60, noise=0.02)
    start = bundle.change_camera_model(truth, "SIMPLE_RADIAL").problem
    options = {"backend": backend, "max_num_iterations": 60}
    old = bundle.solve(start, **options)
    changed = bundle.change_camera_model(old.problem, "OPENCV")
    assert changed.changes[0].exact
    new = bundle.solve(changed.problem, **options)
    assert new.summary.initial_cost == pytest.approx(old.summary.final_cost, rel=1e-9)
    assert new.summary.final_cost < 0.5 * old.summary.final_cost


def test_a_model_round_trips_through_pycolmap(tmp_path):
    source = synthesize(11, model="SIMPLE_RADIAL")
    problem = bundle.Problem.from_pycolmap(source)
    changed = bundle.change_camera_model(problem, "OPENCV", camera_ids=[2])
    assert [change.camera_id for change in changed.changes] == [2]
    assert bundle.save(changed.problem, tmp_path / "out") == ()
    found = pycolmap.Reconstruction(tmp_path / "out")
    assert [found.camera(key).model.name for key in (1, 2)] == ["SIMPLE_RADIAL", "OPENCV"]
    before, after = fields(source), fields(found)
    for name in ("rigs", "frames", "images", "points"):
        assert after[name] == before[name]
    assert found.compute_mean_reprojection_error() == pytest.approx(
        source.compute_mean_reprojection_error(), rel=1e-9
    )


def without_observations(problem, keep):
    names = ("observation_image", "observation_point", "observation_xy", "observation_keypoint")
    return problem.replace(**{name: getattr(problem, name)[keep] for name in names})


@pytest.mark.parametrize("size", [(800, 600), (0, 0)])
@pytest.mark.parametrize("count", [0, 1, 29, 31])
def test_cameras_with_few_observations_and_without_a_size(count, size):
    problem = make_problem(model="OPENCV_FISHEYE", shared=True, noise=0)
    problem = without_observations(problem, np.arange(problem.num_observations) < count)
    problem = problem.replace(camera_sizes=[size], camera_ids=[2**31 + 7])
    changed = bundle.change_camera_model(problem, "FULL_OPENCV")
    (change,) = changed.changes
    assert (change.camera_id, change.num_observations) == (2**31 + 7, count)
    assert change.max < 0.1
    assert changed.problem.camera_sizes.tolist() == [list(size)]


def test_nothing_to_do_and_no_cameras():
    problem = make_problem(model="RADIAL")
    changed = bundle.change_camera_model(problem, "radial")
    assert changed.problem is problem
    assert changed.changes == ()
    assert bundle.change_camera_model(problem, "OPENCV", camera_ids=[]).problem is problem


def test_padding_goes_with_the_largest_model():
    problem = make_problem(model="OPENCV", shared=True).replace(
        camera_params=[[800, 790, 400, 300, 0, 0, 0, 0]]
    )
    small = bundle.change_camera_model(problem, "PINHOLE").problem
    np.testing.assert_array_equal(small.camera_params, [[800, 790, 400, 300]])
    small.check_padding()


def test_a_fisheye_that_sees_too_much():
    xy = np.array([[400.0 + 300 * np.radians(angle), 400] for angle in (10, 40, 95, 120)])
    problem = bundle.Problem(
        cam_from_world=[[0, 0, 0, 1, 0, 0, 0]],
        camera_models=["SIMPLE_FISHEYE"],
        camera_params=[[300, 400, 400]],
        camera_ids=[9],
        points=np.ones((4, 3)),
        observation_image=[0] * 4,
        observation_point=range(4),
        observation_xy=xy,
    )
    for target in ("PINHOLE", "OPENCV", "FOV", "EUCM"):
        with pytest.raises(InputError, match=r"camera 9 .*2 observations at up to 120\.0 degrees"):
            bundle.change_camera_model(problem, target)
    assert bundle.change_camera_model(problem, "OPENCV_FISHEYE").changes[0].exact
    # A division model sees behind; the fit is bad and says so.
    assert bundle.change_camera_model(problem, "DIVISION").changes[0].num_observations == 4


@pytest.mark.parametrize(
    ("old", "new"), [("EQUIRECTANGULAR", "PINHOLE"), ("PINHOLE", "EQUIRECTANGULAR")]
)
def test_the_sphere_is_no_lens(old, new):
    with pytest.raises(InputError, match=r"camera 1: .*EQUIRECTANGULAR"):
        bundle.change_camera_model(make_problem(model=old), new)


def test_misuse():
    problem = scene()
    with pytest.raises(InputError, match=r"model: .*did you mean OPENCV"):
        bundle.change_camera_model(problem, "OPENC")
    with pytest.raises(InputError, match="camera_ids: camera 77 is not in the problem"):
        bundle.change_camera_model(problem, "OPENCV", camera_ids=[0, 77])


def test_a_pixel_far_outside_the_image_does_not_spoil_the_fit():
    problem = make_problem(model="OPENCV_FISHEYE", shared=True, noise=0)
    xy = problem.observation_xy.copy()
    xy[0] = 1e3, 2e3
    spoilt = problem.replace(observation_xy=xy)
    clean, outlier = (
        bundle.change_camera_model(given, "RADIAL_FISHEYE").problem.camera_params[0]
        for given in (problem, spoilt)
    )
    np.testing.assert_allclose(outlier, clean, rtol=1e-3, atol=1e-3)


def test_an_image_whose_origin_is_its_middle():
    """As after BAL, with a size: most pixels are not between 0 and it."""
    problem = make_problem(model="RADIAL", shared=True, noise=0)
    moved = problem.replace(
        camera_params=problem.camera_params - [0, 400, 300, 0, 0],
        observation_xy=problem.observation_xy - [400, 300],
    )
    here, there = (
        bundle.change_camera_model(given, "SIMPLE_RADIAL").changes[0] for given in (problem, moved)
    )
    assert there.max < 2 * here.max


def fisheye(xy, params=(300, 550, 550), model="SIMPLE_FISHEYE"):
    """One wide image, 1100 pixels square, with observations at some pixels."""
    return bundle.Problem(
        cam_from_world=[[0, 0, 0, 1, 0, 0, 0]],
        camera_models=[model],
        camera_params=[params],
        camera_sizes=[[1100, 1100]],
        points=np.ones((len(xy), 3)),
        observation_image=[0] * len(xy),
        observation_point=range(len(xy)),
        observation_xy=xy,
    )


def test_a_lens_is_fitted_as_far_out_as_there_are_observations():
    rng = np.random.default_rng(8)
    near = 550 + rng.uniform(-100, 100, (50, 2))
    params = [300, 300, 550, 550, 0.1, -0.05, 0.02, -0.004]
    changed = bundle.change_camera_model(fisheye(near, params, "OPENCV_FISHEYE"), "RADIAL_FISHEYE")
    assert changed.changes[0].max < 1e-2
    few = bundle.change_camera_model(fisheye(near[:9], params, "OPENCV_FISHEYE"), "RADIAL_FISHEYE")
    assert few.changes[0].max > 0.1  # the whole image counts
    # To 100 degrees the image goes, where no perspective lens has one.
    assert bundle.change_camera_model(fisheye(near), "OPENCV").changes[0].max < 1e-2
    unseen = bundle.change_camera_model(fisheye(np.empty((0, 2))), "OPENCV")
    assert unseen.changes[0].converged
    assert unseen.changes[0].max < 50


def test_a_symmetric_lens_keeps_its_principal_point():
    rng = np.random.default_rng(9)
    corner = rng.uniform((560, 500), (900, 700), (200, 2))
    problem = fisheye(corner, [300, 550.25, 549.5, 0.1], "SIMPLE_RADIAL_FISHEYE")
    changed = bundle.change_camera_model(problem, "THIN_PRISM_FISHEYE").problem
    assert changed.camera_params[0, 2:4].tolist() == [550.25, 549.5]
    fitted = bundle.change_camera_model(problem, "FISHEYE").problem
    assert fitted.camera_params[0, 2:4].tolist() == [550.25, 549.5]


def test_the_worst_fit_comes_first_and_padding_goes():
    params = np.array([[800.0, 700, 400, 300, 0, 0], [800.0, 500, 400, 300, 0, 0]])
    problem = make_problem(num_images=2, model="PINHOLE").replace(
        camera_params=np.hstack([params, [[0, 0], [0, 0]]]), camera_models=["PINHOLE", "PINHOLE"]
    )
    changed = bundle.change_camera_model(problem, "RADIAL")
    assert [warning.split(":")[0] for warning in changed.warnings] == ["Camera 2", "Camera 1"]
    larger = problem.replace(
        camera_models=["OPENCV", "OPENCV"],
        camera_params=np.hstack([params[:, :4], np.full((2, 4), 0.01)]),
    )
    one = bundle.change_camera_model(larger, "PINHOLE", camera_ids=[1]).problem
    assert one.camera_models == ("PINHOLE", "OPENCV")
    one.check_padding()
