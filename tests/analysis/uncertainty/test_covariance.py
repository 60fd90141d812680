"""Covariances against dense linear algebra, reference numbers, and each other."""

import pickle

import mpmath
import numpy as np
import pytest

import bundle
from bundle.model.rigid_motions import rotation_matrices
from tests.analysis.uncertainty.dense import Dense
from tests.analysis.uncertainty.random_problems import Case, random_case
from tests.georeference.flights import flight
from tests.scenes import make_problem

# COLMAP's data sets, two cameras: cost, dof, sigma0, sigma of the focal length, (rotation,
# translation) of the third image, first point.
REFERENCE = {
    "maupertuis": (
        (403.480433733, 3575, 0.475103, 6.50921559),
        (2.6199e-4, 1.08894e-3, 2.0514e-4, 0.01267142, 0.00446224, 0.00734296),
        (0.03623153, 0.1112772, 0.2862213),
    ),
    "crane_mast": (
        (5837.894924153, 5665, 1.435632, 2.48650411),
        (1.4056e-4, 3.5755e-4, 2.0158e-4, 8.1822e-4, 9.5271e-4, 2.61001e-3),
        (0.00511232, 0.00152831, 0.00530178),
    ),
    "lund_door": (
        (10922.343221389, 112435, 0.440780, 1.29051455),
        (1.12451e-4, 1.11552e-4, 3.59788e-5, 3.17216e-3, 2.19919e-3, 8.36995e-4),
        (0.01362642, 0.01407704, 0.03214773),
    ),
}


def sigmas(covariance):
    return np.sqrt(np.diag(covariance))


def blocks(case, dense, cov):
    """Pairs (ours, dense) of all blocks."""
    problem, column = case.problem, case.dense.column

    def of(kind, i, size):
        first = column[kind, i, 0]
        return dense[first : first + size, first : first + size]

    for i in range(problem.num_images):
        if case.dense.frame[i] < 0:
            yield "pose", cov.pose_covariance[i], of("image", i, 6)
    for i in range(len(problem.rig_from_world)):
        yield "frame", cov.frame_covariance[i], of("frame", i, 6)
    for i in range(len(problem.sensor_from_rig)):
        yield "sensor", cov.sensor_covariance[i], of("sensor", i, 6)
    for p in range(problem.num_points):
        yield "point", cov.point_covariance[p], of("point", p, 3)
    width = problem.camera_params.shape[1]
    for c in range(problem.num_cameras):
        held = np.diag(of("camera", c, width)) == 0
        assert (np.isnan(np.diag(cov.camera_covariance[c])) == held).all()
        yield "camera", np.nan_to_num(cov.camera_covariance[c]), of("camera", c, width)


def compare(case, dense, cov):
    """The largest difference of each kind, in sigmas."""
    worst = {}
    for kind, ours, theirs in blocks(case, dense, cov):
        sigma = np.sqrt(np.maximum(np.diag(theirs), 0))
        scale = np.where(sigma > 0, sigma, 1)
        error = np.abs(ours - theirs) / scale / scale[:, None]
        worst[kind] = max(worst.get(kind, 0), error.max())
    return worst


@pytest.mark.parametrize("seed", range(25))
def test_blocks_are_those_of_the_dense_pseudo_inverse(seed):
    case = random_case(seed)
    # Off a minimum a sandwich need not exist: what is far off says nothing along its residual.
    is_convex = case.settings["loss"] in ("trivial", "soft_l1")
    robust = "sandwich" if seed % 2 == 0 and is_convex and not case.joins_points else "weights"
    dense = case.dense.covariance(
        case.basis, sandwich=robust == "sandwich", num_priors=case.num_prior_rows
    )
    cov = bundle.covariance(case.problem, robust=robust, factors=case.factors, **case.settings)
    assert max(compare(case, dense, cov).values()) < 1e-9


@pytest.mark.parametrize("num_images", [6, 60])
def test_a_bound_takes_no_part_in_a_prior_of_a_sandwich(num_images):
    """A parameter on its bound is as if fixed, whatever a prior says of it and the focal length."""
    problem = make_problem(
        num_images=num_images,
        num_points=5 * num_images,
        track=min(num_images, 8),
        seed=3,
        perturbation=0,
        noise=0.3,
        shared=True,
    )
    result = bundle.solve(problem, function_tolerance=1e-15)
    key = ("camera", 1)
    low, high = np.full(4, -np.inf), np.full(4, np.inf)
    high[3] = result.problem.camera_params[0, 3] - 0.01
    start = problem.camera_params.copy()
    start[0, 3] = high[3] - 0.01
    root = np.diag([1e-2, 1e-3, 1e-3, 10.0])
    root[0, 3] = 5.0  # about as much as the observations say
    factors = [bundle.PriorFactor(key, problem.camera_params[0], root.T @ root)]
    settings = {"factors": factors, "function_tolerance": 1e-15}
    on_bound = bundle.solve(
        problem.replace(camera_params=start), bounds={key: (low, high)}, **settings
    )
    assert on_bound.active_bounds
    settings = {"factors": factors, "robust": "sandwich"}
    whole = bundle.covariance(on_bound, bounds={key: (low, high)}, **settings)
    held = bundle.covariance(on_bound, constraints=["camera 1: k fixed"], **settings)
    assert whole.camera(1)[0, 0] == pytest.approx(held.camera(1)[0, 0], rel=1e-7)
    assert whole.camera(1)[3, 3] == 0


def test_a_small_problem_agrees_with_fifty_digits():
    problem = make_problem(num_images=3, num_points=8, seed=5, model="SIMPLE_PINHOLE", shared=True)
    dense = Dense(problem)
    refined = [name for name in dense.names if name[::2] not in {("camera", 1), ("camera", 2)}]
    columns = [dense.column[name] for name in refined]
    scale = 1 / np.linalg.norm(dense.jacobian[:, columns], axis=0)
    null, _ = np.linalg.qr(dense.similarities()[columns] / scale[:, None])
    with mpmath.workdps(50):
        jacobian = mpmath.matrix((dense.jacobian[:, columns] * scale).tolist())
        n = mpmath.matrix(null.tolist())
        held = (jacobian.T * jacobian + n * n.T) ** -1  # any generalised inverse; then least trace
        free = mpmath.matrix(np.linalg.qr(dense.similarities()[columns])[0].tolist())
        units = mpmath.diag(scale.tolist())
        project = mpmath.eye(len(columns)) - free * (free.T * free) ** -1 * free.T
        exact = np.array((project * units * held * units * project.T).tolist(), float)
    cov = bundle.covariance(problem)
    expected = np.zeros((len(dense.names), len(dense.names)))
    expected[np.ix_(columns, columns)] = exact
    case = Case(problem, {}, [], dense, np.eye(len(dense.names))[:, columns], 0)
    assert max(compare(case, expected, cov).values()) < 1e-8


@pytest.mark.parametrize("name", REFERENCE)
def test_reference_numbers(name, bundle_data):
    (cost, dof, sigma0, focal), pose, point = REFERENCE[name]
    tight = {"function_tolerance": 1e-14, "gradient_tolerance": 0, "parameter_tolerance": 0}
    result = bundle.solve(bundle_data / "colmap" / name, max_num_iterations=200, **tight)
    assert result.summary.final_cost == pytest.approx(cost, rel=1e-9)
    cov = bundle.covariance(result, gauge="two_cameras")
    assert cov.dof == dof
    assert cov.sigma0 == pytest.approx(sigma0, rel=1e-5)
    assert not cov.notes
    problem = result.problem
    camera = sigmas(cov.camera(problem.camera_ids[0]))
    assert camera[0] == pytest.approx(focal, rel=1e-6)
    assert sigmas(cov.pose(problem.image_ids[2])) == pytest.approx(pose, rel=2e-5)
    assert sigmas(cov.point(problem.point_ids[0])) == pytest.approx(point, rel=2e-5)
    # The gauge changes neither what is relative nor the intrinsics.
    inner = bundle.covariance(result, of=("poses", "intrinsics"))
    a, b = problem.image_ids[[0, 2]].tolist()
    ours, theirs = inner.relative(a, b), cov.relative(a, b)
    assert ours[:3, :3] == pytest.approx(theirs[:3, :3], rel=1e-8, abs=1e-8 * theirs[0, 0])
    assert inner.camera_covariance == pytest.approx(cov.camera_covariance, rel=1e-8, nan_ok=True)
    assert np.trace(inner.pose_covariance.sum(axis=0)) > 0


def relative_case(**settings):
    problem = make_problem(num_images=5, num_points=40, seed=3, perturbation=0, noise=0.3)
    return problem, bundle.solve(problem, function_tolerance=1e-15, **settings)


def relative_motion(problem, a, b):
    """Rotation and translation of cam_b_from_cam_a, and R_ba t_a; a and b count from 0."""
    turn_a, turn_b = rotation_matrices(problem.cam_from_world[[a, b], :4])
    arm = turn_b @ turn_a.T @ problem.cam_from_world[a, 4:]
    return turn_b @ turn_a.T, problem.cam_from_world[b, 4:] - arm, arm


def moved_by_b(problem, a, b):
    """Derivative of cam_b_from_cam_a by the pose of image b."""
    arm = relative_motion(problem, a, b)[2]
    moves = np.eye(6)
    moves[3:, :3] = [[0, -arm[2], arm[1]], [arm[2], 0, -arm[0]], [-arm[1], arm[0], 0]]
    return moves


def test_relative_pose_beside_a_held_one_is_that_of_the_other():
    problem, _ = relative_case()
    cov = bundle.covariance(problem, fixed_image_ids=(2,), relative=[(2, 4)])
    moves = moved_by_b(problem, 1, 3)
    expected = moves @ cov.pose(4) @ moves.T
    assert cov.relative(2, 4) == pytest.approx(expected, rel=1e-9, abs=1e-12 * expected.max())
    assert (cov.pose(2) == 0).all()


@pytest.mark.parametrize("robust", ["weights", "sandwich"])
def test_relative_rotations_and_directions_do_not_depend_on_the_gauge(robust):
    _, result = relative_case()
    pairs = [(1, 2), (5, 3)]
    given = {"relative": pairs, "robust": robust, "of": "poses"}
    inner = bundle.covariance(result, **given).relative_covariance
    two = bundle.covariance(result, gauge="two_cameras", **given).relative_covariance
    for (a, b), ours, theirs in zip(pairs, inner, two, strict=True):
        direction = relative_motion(result.problem, a - 1, b - 1)[1]
        seen = np.zeros((5, 6))
        seen[:3, :3], seen[3:, 3:] = np.eye(3), np.linalg.svd(direction[None])[2][1:]
        ours, theirs = seen @ ours @ seen.T, seen @ theirs @ seen.T
        assert ours == pytest.approx(theirs, abs=1e-8 * np.abs(theirs).max())


def test_blocks_of_the_selected_inverse_are_those_of_solves():
    """Above 300 unknowns the factor is sparse; relative poses solve for whole columns."""
    problem = make_problem(num_images=70, num_points=240, track=4, seed=5, perturbation=1e-3)
    pairs = [(36, 1), (36, 20), (36, 70)]
    cov = bundle.covariance(problem, fixed_image_ids=(36,), relative=pairs, num_threads=2)
    for (_, b), ours in zip(pairs, cov.relative_covariance, strict=True):
        moves = moved_by_b(problem, 35, b - 1)
        expected = moves @ cov.pose(b) @ moves.T
        assert ours == pytest.approx(expected, abs=1e-8 * expected.max())
    one = bundle.covariance(problem, fixed_image_ids=(36,), num_threads=1)
    assert cov.point_covariance == pytest.approx(one.point_covariance, rel=1e-9, abs=1e-12)


def test_a_long_drive_one_way_keeps_its_digits():
    """Eliminated from one end to the other, its selected inverse is off by powers of ten."""
    drive = {"loop_closure": False, "cameras": "individual", "camera_model": "RADIAL", "seed": 4}
    scene = bundle.synthesize(num_images=400, num_points=14000, mean_track_length=5.0, **drive)
    problem = scene.ground_truth
    b = 399
    cov = bundle.covariance(problem, fixed_image_ids=(200,), relative=[(200, b)], of="poses")
    moves = moved_by_b(problem, 199, b - 1)
    expected = moves @ cov.pose(b) @ moves.T
    assert cov.relative(200, b) == pytest.approx(expected, abs=1e-8 * expected.max())
    assert (np.linalg.eigvalsh(np.delete(cov.pose_covariance, 199, axis=0)) > 0).all()


def test_points_without_parallax_are_left_out_and_named():
    problem = make_problem(num_images=5, num_points=30, seed=1, perturbation=0, noise=0.2)
    once = (problem.observation_point != 7) | (problem.observation_image == 0)
    kept = {
        name: getattr(problem, name)[once]
        for name in (
            "observation_image",
            "observation_point",
            "observation_xy",
            "observation_keypoint",
        )
    }
    lonely = problem.replace(**kept)
    without = bundle.covariance(
        problem.replace(
            **{name: getattr(problem, name)[problem.observation_point != 7] for name in kept}
        )
    )
    cov = bundle.covariance(lonely)
    assert cov.null_point_ids.tolist() == [8]
    assert np.isnan(cov.point(8)).all()
    # It says nothing of the others.
    assert np.isnan(without.point(8)).all()
    assert cov.camera_covariance == pytest.approx(without.camera_covariance, rel=1e-9, nan_ok=True)
    assert np.isfinite(np.delete(cov.point_covariance, 7, axis=0)).all()


def test_a_far_origin_changes_no_point_and_no_intrinsics():
    problem = make_problem(num_images=6, num_points=40, seed=2, perturbation=0)
    shift = np.array([5e5, 6e6, 100.0])
    rotation = rotation_matrices(problem.cam_from_world[:, :4])
    poses = problem.cam_from_world.copy()
    poses[:, 4:] -= rotation @ shift
    far = problem.replace(points=problem.points + shift, cam_from_world=poses)
    for gauge in ("inner", "two_cameras"):
        near_by, far_off = (bundle.covariance(p, gauge=gauge) for p in (problem, far))
        np.testing.assert_allclose(
            far_off.camera_covariance, near_by.camera_covariance, rtol=1e-5, atol=1e-12
        )
    near_by, far_off = (bundle.covariance(p, fixed_image_ids=(1, 2)) for p in (problem, far))
    scale = np.abs(near_by.point_covariance).max()
    np.testing.assert_allclose(
        far_off.point_covariance, near_by.point_covariance, rtol=1e-5, atol=1e-7 * scale
    )

    # Rotations are what they were; the centre -R^T t scatters as before.
    ours, theirs = centre_covariance(problem, near_by, 4), centre_covariance(far, far_off, 4)
    np.testing.assert_allclose(theirs, ours, atol=1e-3 * np.abs(ours).max())


def centre_covariance(problem, cov, i):
    rotation = rotation_matrices(problem.cam_from_world[:, :4])[i]
    moved = [np.cross(problem.cam_from_world[i, 4:], axis) for axis in np.eye(3)]
    moves = np.hstack([-rotation.T @ np.transpose(moved), -rotation.T])
    return moves @ cov.pose_covariance[i] @ moves.T


def test_sigma0_scales_observations_but_no_priors():
    problem, result = relative_case()
    unit, scaled = (bundle.covariance(result, scale=scale) for scale in ("unit", "sigma0"))
    assert scaled.point_covariance == pytest.approx(unit.sigma0**2 * unit.point_covariance)
    # A prior that alone says where something is keeps its sigma.
    prior = bundle.PriorFactor(("point", 1), problem.points[0], np.eye(3) / 0.01**2)
    others = {"fixed_image_ids": tuple(range(1, 6)), "refine": ("points",), "factors": [prior]}
    weak = problem.replace(observation_sigma=np.full(problem.num_observations, 1e4))
    cov = bundle.covariance(weak, scale="sigma0", **others)
    assert cov.sigma0 < 1e-3
    unscaled = bundle.covariance(
        problem.replace(observation_sigma=np.full(problem.num_observations, 1e4 * cov.sigma0)),
        **others,
    )
    assert cov.point(1) == pytest.approx(unscaled.point(1), rel=1e-9)


def test_sigma0_beside_factors_leaves_the_weights_of_a_loss():
    """Oracle: no loss, but each observation with the sigma that its weight gives it."""
    problem, _ = relative_case()
    centers = problem.projection_centers
    factors = [
        bundle.PositionFactor(("image", i + 1), centers[i], np.eye(3) / 0.02**2) for i in range(3)
    ]
    loss = {"loss": "huber", "loss_scale": 0.2}
    result = bundle.solve(problem, factors=factors, function_tolerance=1e-14, **loss)
    cov = bundle.covariance(result, scale="sigma0", factors=factors, gauge="none")
    errors, _ = bundle.reprojection_errors(result.problem)
    weights = np.minimum(1, 0.2 / errors)
    assert 0.2 < (weights < 1).mean() < 0.9 and abs(cov.sigma0 - 1) > 0.2
    weighed = result.problem.replace(observation_sigma=cov.sigma0 / np.sqrt(weights))
    # The second derivative of a loss does not count in Huber's weights.
    expected = bundle.covariance(weighed, factors=factors, gauge="none")
    np.testing.assert_allclose(cov.pose_covariance, expected.pose_covariance, rtol=1e-7)
    np.testing.assert_allclose(cov.point_covariance, expected.point_covariance, rtol=1e-7)


def test_priors_do_not_move_the_problem():
    """Positions in another frame: they say as much as positions in the problem's own."""
    _, result = relative_case()
    centers = result.problem.projection_centers

    def sigmas_with(scale):
        priors = [bundle.PositionPrior(i + 1, scale * centers[i] + 3, 0.01) for i in range(4)]
        return bundle.covariance(result.problem, result.options, priors=priors, gauge="none")

    own, other = sigmas_with(1.0), sigmas_with(5.0)
    np.testing.assert_allclose(other.pose_covariance, own.pose_covariance, rtol=1e-9)


def test_as_many_residuals_as_parameters_are_enough():
    """Poses from three known points; sigma0 has nothing to be estimated from."""
    problem = make_problem(num_images=2, num_points=3, model="PINHOLE", noise=0, perturbation=0)
    settings = {"refine": ("poses",), "gauge": "none"}
    cov = bundle.covariance(problem, **settings)
    assert cov.dof == 0 and np.isnan(cov.sigma0)
    assert (np.linalg.eigvalsh(cov.pose(1)) > 0).all()
    with pytest.raises(bundle.InputError, match="degrees of freedom"):
        bundle.covariance(problem, scale="sigma0", **settings)


@pytest.mark.parametrize(("move", "is_said"), [(6e-5, True), (1e-6, False)])
def test_what_is_no_minimum_is_said(move, is_said):
    _, result = relative_case()
    solved = result.problem
    rng = np.random.default_rng(0)
    off = solved.replace(points=solved.points + move * rng.standard_normal(solved.points.shape))
    cost = bundle.solve(off, result.options, max_num_iterations=0).summary.initial_cost
    if is_said:  # between the limit and a hundred times the limit
        share = cost / result.summary.final_cost - 1
        assert 1e-4 < share < 1e-2
    assert bool(bundle.covariance(off, result.options).notes) == is_said


def test_control_points_that_start_where_their_rays_meet_are_no_missing_minimum():
    """A rough pixel of a target: its rays meet elsewhere than where a solve has put it."""
    made = flight([(-20, -10, 0.5), (15, 20, -0.5), (25, -25, 0.0)], target_noise=4.0)
    options = {"function_tolerance": 1e-14, "refine": ("poses", "points")}
    result = bundle.solve(made.problem, priors=made.gcps, **options)
    assert bundle.covariance(result, priors=made.gcps).notes == ()


def test_a_bound_that_holds_a_parameter_takes_its_covariance():
    problem, result = relative_case()
    key = ("camera", 1)
    low, high = np.full(4, -np.inf), np.full(4, np.inf)
    high[3] = result.problem.camera_params[0, 3] - 0.01
    start = problem.camera_params.copy()
    start[0, 3] = high[3] - 0.01
    bounds = {key: (low, high)}
    on_bound = bundle.solve(
        problem.replace(camera_params=start), bounds=bounds, function_tolerance=1e-15
    )
    assert on_bound.active_bounds
    cov = bundle.covariance(on_bound, bounds=bounds)
    held = bundle.covariance(on_bound, constraints=["camera 1: k fixed"])
    assert cov.camera(1)[0, 0] == pytest.approx(held.camera(1)[0, 0], rel=1e-9)
    assert cov.camera(1)[3, 3] == 0
    assert cov.point_covariance == pytest.approx(held.point_covariance, rel=1e-7, abs=1e-12)


def test_parts_of_a_problem():
    problem, _ = relative_case()
    points = bundle.covariance(problem, refine=("points",))
    assert (points.pose_covariance == 0).all()
    assert np.isnan(points.camera_covariance).all()
    full = bundle.covariance(problem, gauge="two_cameras")
    assert (sigmas(points.point(3)) < sigmas(full.point(3))).all()
    poses = bundle.covariance(problem, refine=("poses",), of="poses")
    assert len(poses.point_covariance) == len(poses.camera_covariance) == 0
    assert (sigmas(poses.pose(2)) > 0).all()
    nothing = bundle.covariance(problem, refine=("poses",), fixed_image_ids=range(1, 6))
    assert (nothing.pose_covariance == 0).all()


@pytest.mark.parametrize(
    ("settings", "field"),
    [
        ({"gauge": "none"}, "gauge"),
        ({"gauge": "four_cameras"}, "gauge"),
        ({"of": "lenses"}, "of"),
        ({"of": ()}, "of"),
        ({"scale": 1}, "scale"),
        ({"robust": "no"}, "robust"),
        ({"robust": "sandwich", "scale": "sigma0"}, "scale"),
        ({"relative": [(1, 99)]}, "relative"),
        ({"relative": [3]}, "relative"),
        ({"fixed_image_ids": (77,)}, "fixed_image_ids"),
    ],
)
def test_wrong_arguments(settings, field):
    problem, _ = relative_case()
    with pytest.raises(bundle.InputError, match=f"^{field}: "):
        bundle.covariance(problem, **settings)


def test_what_cannot_be_computed_is_said():
    two = make_problem(num_images=2, num_points=5, seed=4, model="SIMPLE_PINHOLE", shared=True)
    with pytest.raises(bundle.InputError, match=r"full rank|degrees of freedom"):
        bundle.covariance(two, scale="sigma0")
    _, result = relative_case()
    with_factor = bundle.solve(
        result.problem, factors=[bundle.PriorFactor(("point", 1), np.zeros(3), np.eye(3))]
    )
    with pytest.raises(bundle.InputError, match=r"^problem: "):
        bundle.covariance(with_factor)
    off = make_problem(num_images=4, num_points=30)
    assert len(bundle.covariance(off).notes) == 1


def test_it_pickles_shows_itself_and_is_written_whole(tmp_path):
    _, result = relative_case()
    cov = bundle.covariance(result, relative=[(1, 2)])
    again = pickle.loads(pickle.dumps(cov))
    assert (again.pose(3) == cov.pose(3)).all()
    assert again.relative(2, 4) == pytest.approx(cov.relative(2, 4))
    assert "40 points" in repr(cov)
    cov.save(tmp_path / "c.npz")
    with np.load(tmp_path / "c.npz") as file:
        assert {"pose_ids", "point_covariance", "camera_covariance", "sigma0", "dof"} <= {*file}
        assert (file["pose_covariance"] == cov.pose_covariance).all()
        assert str(file["gauge"]) == "inner"
    with pytest.raises(bundle.InputError, match=r"^image: "):
        cov.pose(99)
    with pytest.raises(ValueError, match="read-only"):
        cov.pose_covariance[0] = 0
