"""Parameters that are one number, and cameras that turn about a fixed centre."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import bundle
from bundle.solving.constraints.resolve import apply
from tests import scenes
from tests.solving.constraints.lenses import BACKENDS, IN_PLACE, assert_same, mixed, solve


def with_cameras(problem, image_camera, rows):
    """Other cameras for the images: camera k has the parameters of camera rows[k] of before."""
    count = len(rows)
    return problem.replace(
        image_camera=image_camera,
        camera_ids=[10 * (k + 1) for k in range(count)],
        camera_models=[problem.camera_models[row] for row in rows],
        camera_params=problem.camera_params[rows],
        camera_sizes=problem.camera_sizes[rows],
    )


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("images_of_each", [1, 2])
def test_sharing_all_parameters_is_having_one_camera(images_of_each, backend):
    one = scenes.make_problem(num_images=4, num_points=25, shared=True)
    several = with_cameras(
        one, [k // images_of_each for k in range(4)], [0] * (4 // images_of_each)
    )
    refine = "poses,points,focal,principal_point,extra"
    found = solve(several, "cameras *: share f,k,cx,cy", backend=backend, refine=refine)
    expected = solve(one, backend=backend, refine=refine)
    params = found.problem.camera_params
    assert (params == params[0]).all()
    assert abs(found.summary.final_cost / expected.summary.final_cost - 1) < 1e-10
    np.testing.assert_allclose(params[0], expected.problem.camera_params[0], rtol=1e-7)
    np.testing.assert_allclose(found.problem.points, expected.problem.points, atol=1e-7)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("shared", [False, True])
def test_a_fixed_ratio_of_one_is_a_model_with_one_focal_length(shared, backend):
    one = scenes.make_problem(num_images=4, num_points=25, model="SIMPLE_PINHOLE", shared=shared)
    f, x, y = one.camera_params.T
    two = one.replace(
        camera_models=["PINHOLE"] * one.num_cameras, camera_params=np.stack([f, f, x, y], 1)
    )
    found = solve(two, "cameras *: fx/fy fixed", backend=backend)
    expected = solve(one, backend=backend)
    params = found.problem.camera_params
    np.testing.assert_array_equal(params[:, 0], params[:, 1])
    assert abs(found.summary.final_cost / expected.summary.final_cost - 1) < 1e-10
    np.testing.assert_allclose(params[:, 0], expected.problem.camera_params[:, 0], rtol=1e-7)


def dense(problem, unpack, start):
    """The least squares of a function from free numbers to (w, t, params, points)."""

    def residual(x):
        return scenes.residuals(problem, *unpack(x)).ravel()

    return least_squares(residual, start, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14)


@pytest.mark.parametrize("backend", BACKENDS)
def test_one_focal_length_of_two_models_and_a_ratio(backend):
    problem = mixed(3, 12)  # SIMPLE_RADIAL, OPENCV, SIMPLE_RADIAL
    ratio = problem.camera_params[1, 1] / problem.camera_params[1, 0]
    rules = "cameras 1-2: share f", "camera 3: f fixed", "cameras *: k,k1,k2,p1,p2 fixed"
    held = {"fixed_image_ids": (1, 2), "gauge": "none"}
    found = solve(problem, *rules, backend=backend, **held)
    f = found.problem.camera_params[0, 0]
    np.testing.assert_array_equal(found.problem.camera_params[1, :2], [f, f])
    start = np.mean([*problem.camera_params[:1, 0], *problem.camera_params[1, :2]])

    def unpack(x, tied=True):
        w, t = np.zeros((3, 3)), problem.cam_from_world[:, 4:].copy()
        w[2], t[2] = x[:3], x[3:6]
        params = problem.camera_params.copy()
        params[1, :2] = x[6] * np.array([1, 1 if tied else ratio])
        if tied:
            params[0, 0] = x[6]
        return w, t, params, x[7:].reshape(-1, 3)

    free = np.r_[np.zeros(3), problem.cam_from_world[2, 4:], start, problem.points.ravel()]
    oracle = dense(problem, unpack, free)
    np.testing.assert_allclose(found.summary.final_cost, oracle.cost, rtol=1e-9)
    np.testing.assert_allclose(f, oracle.x[6], rtol=1e-6)

    rules = "camera 2: fx/fy fixed", "cameras 1,3: f fixed", "cameras *: k,k1,k2,p1,p2 fixed"
    found = solve(problem, *rules, backend=backend, **held)
    fx, fy = found.problem.camera_params[1, :2]
    assert fx != problem.camera_params[1, 0]
    np.testing.assert_allclose(fy / fx, ratio, rtol=4e-16)
    free[6] = problem.camera_params[1, 0]
    oracle = dense(problem, lambda x: unpack(x, tied=False), free)
    np.testing.assert_allclose(found.summary.final_cost, oracle.cost, rtol=1e-9)
    np.testing.assert_allclose(fx, oracle.x[6], rtol=1e-6)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("away", [0.0, 1e5])
def test_a_camera_turns_about_its_fixed_centre(backend, away):
    problem = scenes.make_problem(num_images=3, num_points=12, shared=True, perturbation=0.05)
    rotations = Rotation.from_quat(problem.cam_from_world[:, :4])
    pose = problem.cam_from_world.copy()
    pose[:, 4:] -= rotations.apply(np.full((3, 3), away))
    moved = problem.replace(cam_from_world=pose, points=problem.points + away)
    rules = "image 3: position fixed", "camera 1: f,k fixed"
    found = solve(moved, *rules, backend=backend, fixed_image_ids=(1, 2))
    centre = moved.projection_centers[2]
    np.testing.assert_allclose(
        found.problem.projection_centers[2], centre, rtol=0, atol=1e-14 + 1e-15 * away
    )
    turn = Rotation.from_quat(found.problem.cam_from_world[2, :4]) * rotations[2].inv()
    assert turn.magnitude() > 1e-3
    centre = problem.projection_centers[2]

    def unpack(x):
        w, t = np.zeros((3, 3)), problem.cam_from_world[:, 4:].copy()
        w[2] = x[:3]
        t[2] = -(Rotation.from_rotvec(x[:3]) * rotations[2]).apply(centre)
        return w, t, None, x[3:].reshape(-1, 3)

    oracle = dense(problem, unpack, np.r_[np.zeros(3), problem.points.ravel()])
    np.testing.assert_allclose(
        found.summary.final_cost, oracle.cost, rtol=1e-9 if not away else 1e-6
    )
    np.testing.assert_allclose(turn.as_rotvec(), oracle.x[:3], atol=1e-6)


RULES = (
    "cameras 1,3,5: share f",
    "cameras 2,4: share f,k1",
    "camera 2: fx/fy fixed",
    "cameras 1-2: share f",
    "camera 4: p1/k2 fixed",
    "image 2: position fixed",
    "image 4: rotation fixed",
    "image 5: position prior sigma 0.05",
    "cameras 1-5: f prior 1 %",
    "camera 4: k1 prior 0 sigma 0.02",
    "camera 3: k in [-0.05, 0.0101]",
)


def full(num_images=5, num_points=30):
    """A scene in which no parameter is zero, and all of some cameras have two images."""
    problem = mixed(num_images, num_points)
    params = problem.camera_params.copy()
    params[1::2, 5:] = [1e-3, 2e-4, -1e-4]
    params[1::2, 1] = params[1::2, 0]
    return problem.replace(camera_params=params)


@pytest.mark.parametrize("loss", ["trivial", "cauchy"])
@pytest.mark.parametrize(
    "method",
    [
        {"linear_solver_type": "dense_schur"},
        {"linear_solver_type": "sparse_schur"},
        {"linear_solver_type": "iterative_schur", "preconditioner_type": "schur_jacobi"},
        {"linear_solver_type": "dense_schur", "trust_region_strategy_type": "dogleg"},
    ],
    ids=lambda method: "-".join(method.values()),
)
def test_both_backends_take_the_same_steps(method, loss):
    problem = full()
    iterative = method["linear_solver_type"] == "iterative_schur"
    ours, theirs = (
        bundle.solve(
            problem,
            constraints=RULES,
            backend=backend,
            max_num_iterations=5,
            function_tolerance=0.0,
            loss=loss,
            fixed_image_ids=(1,),
            num_threads=2,
            **method,
        )
        for backend in BACKENDS
    )
    assert ours.summary.backend_used == "FUSED"
    tolerance = 1e-4 if iterative else 1e-8
    np.testing.assert_allclose(ours.iterations["cost"], theirs.iterations["cost"], rtol=tolerance)
    if not iterative:
        np.testing.assert_allclose(
            ours.iterations["gradient_max_norm"][:3],
            theirs.iterations["gradient_max_norm"][:3],
            rtol=1e-5,
        )
        np.testing.assert_allclose(
            ours.problem.camera_params, theirs.problem.camera_params, rtol=1e-6, atol=1e-9
        )
    for found in (ours, theirs):
        params = found.problem.camera_params
        f = np.r_[params[[0, 2, 4], 0], params[[1, 3], 0], params[[1, 3], 1]]
        assert (f == f[0]).all()
        assert params[1, 4] == params[3, 4]
        np.testing.assert_allclose(params[3, 6] / params[3, 5], 0.2, rtol=4e-16)
        centres = found.problem.projection_centers, problem.projection_centers
        np.testing.assert_allclose(*(c[1] for c in centres), rtol=0, atol=1e-14)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_small_sigma_stays_where_a_fixed_position_ends(backend):
    weak = "cameras 2,4: k2 fixed"
    problem = mixed(num_points=60)
    options = {"backend": backend, **IN_PLACE}
    fixed = solve(problem, weak, "image 4: position fixed", **options)
    stiff = solve(fixed.problem, weak, "image 4: position prior sigma 1e-9", **options)
    assert_same(stiff, fixed)
    assert fixed.summary.final_cost > solve(problem, weak, **options).summary.final_cost + 1


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_start_is_the_mean_or_what_a_held_camera_says(backend):
    problem = mixed()
    f = problem.camera_params[:, 0]
    shared = solve(problem, "cameras 1,3: share f", backend=backend, max_num_iterations=0)
    assert shared.problem.camera_params[0, 0] == (f[0] + f[2]) / 2
    (tie,) = shared.constraints[0].ties
    assert tie.camera_ids == (1, 3)
    assert tie.before == (f[0], f[2])
    held = solve(problem, "cameras 1,3,5: share f", backend=backend, fixed_camera_ids=(3,))
    assert (held.problem.camera_params[[0, 2, 4], 0] == f[2]).all()
    both = solve(problem, "cameras *: share k", "camera 5: k fixed", backend=backend)
    assert (both.problem.camera_params[[0, 2, 4], 3] == problem.camera_params[4, 3]).all()
    with pytest.raises(bundle.InputError, match=r"constraints.0.: .*f of camera 1.*f of camera 3"):
        apply(["cameras 1,3: share f"], problem, bundle.SolveOptions(fixed_camera_ids=(1, 3)))
    with pytest.raises(bundle.InputError, match=r"constraints.1.: .*already tied"):
        rules = ["camera 2: fx/fy fixed", "cameras 1-2: share f"]
        apply(rules, problem, bundle.SolveOptions())


def test_bounds_of_one_are_bounds_of_all():
    problem = mixed()
    f = problem.camera_params[:, 0].tolist()
    mean = (f[0] + f[2]) / 2
    rules = "cameras 1,3: share f", f"camera 3: f in [{mean - 1e-3!r}, {mean + 1e-3!r}]"
    for backend in BACKENDS:
        found = solve(problem, *rules, backend=backend)
        params = found.problem.camera_params
        assert params[0, 0] == params[2, 0]
        assert abs(params[0, 0] - mean) <= 1e-3 * (1 + 1e-9)
        ends = [end.camera_id for end in found.constraints[1].active_bounds]
        assert ends == [1, 3]
    with pytest.raises(bundle.InputError, match=r"constraints.1.: .*shared start"):
        rules = "cameras 1,3: share f", f"camera 3: f in [{f[2] - 1e-3!r}, {f[2] + 1e-3!r}]"
        apply(rules, problem, bundle.SolveOptions())


def test_what_several_cameras_share_is_known_once():
    problem = mixed()
    found = solve(problem, "cameras 1,3,5: share f", "cameras *: f prior 0.1 %")
    assert [prior.id for prior in found.constraints[1].priors] == [1, 2, 2, 4, 4]
    assert found.summary.num_factors == 5


def test_many_cameras_and_one_that_sees_nothing():
    one = scenes.make_problem(num_images=60, num_points=80, track=4, shared=True)
    several = with_cameras(one, list(range(60)), [0] * 61)
    found = solve(several, "cameras *: share f,k", linear_solver_type="sparse_schur")
    expected = solve(one, linear_solver_type="sparse_schur")
    params = found.problem.camera_params
    assert (params == params[0]).all()
    np.testing.assert_allclose(found.summary.final_cost, expected.summary.final_cost, rtol=1e-2)
    partly = solve(several, "cameras *: share f", linear_solver_type="sparse_schur")
    ceres = solve(several, "cameras *: share f", linear_solver_type="sparse_schur", backend="ceres")
    np.testing.assert_allclose(partly.summary.final_cost, ceres.summary.final_cost, rtol=1e-2)


def test_too_many_shared_numbers_are_refused():
    problem = scenes.make_problem(num_images=8, num_points=20, model="OPENCV")
    rules = [
        f"cameras {k}-{k + 1}: share {name}"
        for k in range(1, 8)
        for name in ("fx,fy" if k % 2 else "k1,k2", "p1,p2", "cx,cy")
    ]
    options = bundle.SolveOptions(refine="poses,points,focal,principal_point,extra")
    with pytest.raises(bundle.InputError, match=r"constraints.*16"):
        apply(rules, problem, options)
