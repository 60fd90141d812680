"""Factors in a bundle adjustment: keys, what they free and hold, who solves it, bad input."""

import pickle

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from tests import scenes

BACKENDS = ("fused", "ceres")


def positions(problem, sigma=0.01, **settings):
    return [
        bundle.PositionFactor(("image", int(i)), center, 1 / sigma**2, **settings)
        for i, center in zip(problem.image_ids, problem.projection_centers, strict=True)
    ]


def centers(problem):
    rotation = Rotation.from_quat(problem.cam_from_world[:, :4])
    return rotation.inv().apply(-problem.cam_from_world[:, 4:])


@pytest.mark.parametrize("backend", BACKENDS)
def test_positions_decide_where_the_world_is(backend):
    problem = scenes.make_problem(noise=0)
    goal = centers(problem) * 2 + [5, -3, 1]
    factors = [
        bundle.PositionFactor(("image", i + 1), goal[i], 1e6) for i in range(problem.num_images)
    ]
    result = bundle.solve(problem, factors=factors, backend=backend, max_num_iterations=300)
    assert result.summary.num_factors == 5
    assert result.options.gauge == "none"
    assert not result.summary.warnings
    assert result.factor_costs_after.shape == (5,)
    np.testing.assert_allclose(centers(result.problem), goal, atol=0.05)
    assert result.summary.final_cost >= result.factor_costs_after.sum()
    assert "factors" in repr(result)
    again = pickle.loads(pickle.dumps(result))
    np.testing.assert_array_equal(again.factor_costs_after, result.factor_costs_after)


def test_relative_poses_leave_the_world_alone():
    problem = scenes.make_problem(num_images=4, num_points=30)
    rotation = Rotation.from_quat(problem.cam_from_world[:, :4])
    turn = rotation[2] * rotation[0].inv()
    t = problem.cam_from_world[:, 4:].copy()
    measured = np.r_[turn.as_quat(), t[2] - turn.apply(t[0]) + 0.1]
    factor = bundle.RelativePoseFactor(("image", 1), ("image", 3), measured, 100.0)
    before = bundle.solve(problem, factors=[factor], max_num_iterations=0)
    assert before.factor_costs_before[0] == pytest.approx(0.5 * 100 * 3 * 0.01, rel=1e-9)
    world = Rotation.from_rotvec([0.3, -0.4, 0.5])
    moved = np.hstack([(rotation * world).as_quat(), t + rotation.apply([3, 2, 1])])
    elsewhere = bundle.solve(
        problem.replace(cam_from_world=moved), factors=[factor], max_num_iterations=0
    )
    np.testing.assert_allclose(
        elsewhere.factor_costs_before, before.factor_costs_before, rtol=1e-10
    )


def test_no_factors_change_no_bit():
    problem = scenes.make_problem()
    plain, empty = bundle.solve(problem), bundle.solve(problem, factors=[])
    assert plain.iterations["cost"].tolist() == empty.iterations["cost"].tolist()
    assert plain.summary.num_factors == 0
    assert plain.factor_costs_after.shape == (0,)


@pytest.mark.parametrize("backend", BACKENDS)
def test_what_only_factors_know_is_refined(backend):
    base = scenes.make_problem(num_images=5, num_points=30)
    seen = (base.observation_image != 4) & (base.observation_point != 29)
    names = ("observation_image", "observation_point", "observation_xy", "observation_keypoint")
    problem = base.replace(**{name: getattr(base, name)[seen] for name in names})
    pose, params = problem.cam_from_world[0], problem.camera_params[0] * 1.01
    factors = [
        bundle.PriorFactor(("image", 5), pose, 100.0),
        bundle.PriorFactor(("camera", 5), params, 1.0),
        bundle.PriorFactor(("point", 30), [1, 2, 3], 1.0),
    ]
    result = bundle.solve(problem, factors=factors, backend=backend, function_tolerance=1e-15)
    turned = Rotation.from_quat(result.problem.cam_from_world[4, :4]).as_matrix()
    np.testing.assert_allclose(turned, Rotation.from_quat(pose[:4]).as_matrix(), atol=1e-6)
    np.testing.assert_allclose(result.problem.points[29], [1, 2, 3], atol=1e-6)
    found = result.problem.camera_params[4]
    np.testing.assert_allclose(found[[0, 3]], params[[0, 3]], atol=1e-5)
    # The principal point is held: its share of the cost stays.
    np.testing.assert_array_equal(found[1:3], problem.camera_params[4, 1:3])
    held = 0.5 * np.sum((problem.camera_params[4, 1:3] - params[1:3]) ** 2)
    assert result.factor_costs_after[1] == pytest.approx(held, rel=1e-6)


@pytest.mark.parametrize("backend", BACKENDS)
def test_held_variables_stay_and_their_cost_is_fixed(backend):
    problem = scenes.make_problem()
    factors = [
        bundle.PositionFactor(("image", 2), [9, 9, 9], 1.0),
        bundle.PriorFactor(("point", 3), [9, 9, 9], 1.0),
    ]
    held = {"fixed_image_ids": (2,), "fixed_point_ids": (3,), "backend": backend}
    result = bundle.solve(problem, factors=factors, **held)
    plain = bundle.solve(problem, gauge="none", **held)
    assert result.summary.fixed_cost == pytest.approx(result.factor_costs_before.sum(), rel=1e-12)
    np.testing.assert_array_equal(result.factor_costs_after, result.factor_costs_before)
    assert result.summary.num_residuals == plain.summary.num_residuals
    assert result.iterations["cost"][-1] == pytest.approx(
        plain.iterations["cost"][-1] + result.summary.fixed_cost, rel=1e-12
    )


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_scene_far_from_its_origin_keeps_its_factors(backend):
    near = scenes.make_problem(num_images=6, num_points=50)
    shift = np.array([5e6, -3e6, 4e5])
    rotation = Rotation.from_quat(near.cam_from_world[:, :4])
    poses = near.cam_from_world.copy()
    poses[:, 4:] -= rotation.apply(shift)
    far = near.replace(cam_from_world=poses, points=near.points + shift)

    def factors(at):
        goals = near.projection_centers + 0.1 * np.random.default_rng(1).standard_normal((6, 3))
        made = [
            bundle.PositionFactor(("image", i + 1), goals[i] + at, 1e4, lever_arm=(0.1, 0, 0.2))
            for i in range(6)
        ]
        return [*made, bundle.PriorFactor(("point", 4), near.points[3] + at + 0.05, 1e4)]

    options = {"backend": backend, "function_tolerance": 1e-12, "parameter_tolerance": 1e-12}
    expected = bundle.solve(near, factors=factors(np.zeros(3)), **options)
    found = bundle.solve(far, factors=factors(shift), **options)
    assert found.summary.warning_kinds == ("far_origin",)
    assert found.summary.initial_cost == pytest.approx(expected.summary.initial_cost, rel=1e-6)
    assert found.summary.final_cost == pytest.approx(expected.summary.final_cost, rel=1e-6)
    # Where the last steps end depends on rounding, with Ceres on two threads from run to run.
    np.testing.assert_allclose(found.problem.points - shift, expected.problem.points, atol=1e-4)
    np.testing.assert_allclose(
        found.factor_costs_after, expected.factor_costs_after, rtol=1e-4, atol=1e-6
    )


def distance(length, sigma=1e-3):
    """A scale bar between two points."""

    def function(values):
        difference = values[1] - values[0]
        norm = np.linalg.norm(difference)
        row = difference / norm / sigma
        return np.array([(norm - length) / sigma]), [-row[None], row[None]]

    return function


def test_functions_in_python_are_for_ceres():
    problem = scenes.make_problem()
    bar = bundle.FunctionFactor([("point", 1), ("point", 2)], distance(1.5))
    for settings in ({}, {"linear_solver_type": "sparse_schur"}, {"num_threads": 2}):
        result = bundle.solve(problem, factors=[bar], max_num_iterations=200, **settings)
        assert result.summary.backend_used == "CERES"
        assert "FunctionFactor" in result.summary.backend_choice
        length = np.linalg.norm(result.problem.points[1] - result.problem.points[0])
        assert length == pytest.approx(1.5, abs=1e-3)
    with pytest.raises(bundle.InputError, match=r"^factors: expected .* found factor 0, Function"):
        bundle.solve(problem, factors=[bar], backend="fused")

    def broken(_values):
        raise RuntimeError("mine")

    calls = []

    def breaks_later(values):
        calls.append(1)
        if len(calls) > 5:
            raise RuntimeError("mine")
        return distance(1.5)(values)

    for function in (broken, breaks_later):
        with pytest.raises(RuntimeError, match="mine"):
            bundle.solve(problem, factors=[bundle.FunctionFactor(bar.keys, function)])


@pytest.mark.parametrize("ordering", ["points_first", "cameras_first"])
@pytest.mark.parametrize(
    "solver", ["dense_schur", "sparse_schur", "sparse_normal_cholesky", "dense_qr"]
)
def test_points_coupled_with_others_are_for_ceres(ordering, solver):
    problem = scenes.make_problem(num_images=4, num_points=20)
    model, xy = problem.camera_models[0], problem.observation_xy[0] + 1.0
    factors = [
        bundle.ReprojectionFactor(("image", 1), ("camera", 1), ("point", 5), xy, model),
        bundle.BetweenFactor(("point", 1), ("point", 2), [0.5, 0, 0], 1e3),
        bundle.BetweenFactor(("point", 2), ("point", 3), [0.5, 0, 0], 1e3),
        bundle.BetweenFactor(("image", 1), ("image", 2), problem.cam_from_world[1], 1e2),
    ]
    options = {"linear_solver_ordering": ordering, "max_num_iterations": 5}
    expected = bundle.solve(problem, factors=factors, linear_solver_type="dense_qr")
    result = bundle.solve(problem, factors=factors, linear_solver_type=solver, **options)
    assert result.summary.backend_used == "CERES"
    np.testing.assert_allclose(
        result.iterations["cost"][:5], expected.iterations["cost"][:5], rtol=1e-5
    )
    assert result.summary.num_parameters == 3 * 20 + 4 * 8
    assert result.summary.num_information_nonzeros == count_nonzeros(problem, factors)


def count_nonzeros(problem, factors):
    """nnz(J^T J) of images with their intrinsics (8) and points (3), by marking pairs."""
    coupled = {(("image", i),) * 2 for i in range(1, problem.num_images + 1)}
    groups = [
        [("image", i + 1), ("point", p + 1)]
        for i, p in zip(problem.observation_image, problem.observation_point, strict=True)
    ]
    # An image and its camera are one block.
    groups += [[("image", n) if kind == "camera" else (kind, n) for kind, n in f.keys]
               for f in factors]  # fmt: skip
    for group in groups:
        coupled |= {(a, b) for a in group for b in group}
    size = {"image": 8, "point": 3}
    return sum(size[a[0]] * size[b[0]] for a, b in coupled)


def test_the_pattern_of_the_fused_backend_has_the_factors():
    problem = scenes.make_problem(num_images=8, num_points=30, track=3)
    x = problem.cam_from_world
    factors = [bundle.BetweenFactor(("image", 1), ("image", 8), x[7], 1.0)]
    result = bundle.solve(problem, factors=factors, gauge="none", linear_solver_type="sparse_schur")
    assert result.summary.backend_used == "FUSED"
    assert result.summary.num_information_nonzeros == count_nonzeros(problem, factors)


def test_a_gauge_that_is_asked_for_beside_factors_warns():
    problem = scenes.make_problem()
    result = bundle.solve(problem, factors=positions(problem), gauge="two_cameras")
    assert result.summary.warning_kinds == ("gauge_beside_factors",)
    np.testing.assert_array_equal(result.problem.cam_from_world[0], problem.cam_from_world[0])
    # Priors of intrinsics say nothing of the world.
    prior = bundle.PriorFactor(("camera", 1), problem.camera_params[0], 1.0)
    result = bundle.solve(problem, factors=[prior])
    assert result.options.gauge == "two_cameras"
    assert not result.summary.warning_kinds


@pytest.mark.parametrize("solver", ["dense_schur", "sparse_schur", "iterative_schur"])
def test_no_bit_depends_on_the_threads(solver):
    problem = scenes.make_problem(num_images=8, num_points=200)
    factors = positions(problem, loss="huber")
    factors += [bundle.PriorFactor(("point", 7), problem.points[6] + 0.1, 1e4, loss="cauchy")]
    options = {"linear_solver_type": solver, "deterministic": True, "backend": "fused"}
    runs = [bundle.solve(problem, factors=factors, num_threads=n, **options) for n in (1, 2, 2)]
    for run in runs[1:]:
        np.testing.assert_array_equal(run.problem.points, runs[0].problem.points)
        assert run.iterations["cost"].tolist() == runs[0].iterations["cost"].tolist()


POSE = [0, 0, 0, 1.0, 0, 0, 0]


@pytest.mark.parametrize(
    ("factor", "message"),
    [
        (bundle.PriorFactor(("image", 99), POSE, 1.0), r"there is no image 99 in the problem"),
        (bundle.PriorFactor("image", POSE, 1.0), r"expected \('image', id\).* found 'image'"),
        (bundle.PriorFactor(("frame", 1), POSE, 1.0), r"there is no frame 1 in the problem"),
        (bundle.PriorFactor(("pose", 1), POSE, 1.0), r"expected \('image', id\)"),
        (bundle.PriorFactor(("image", True), POSE, 1.0), r"expected \('image', id\)"),
        (bundle.PriorFactor(("image", 1.0), POSE, 1.0), r"expected \('image', id\)"),
        (bundle.PriorFactor(("image", 1), [1, 2, 3], 1.0), r"expected 7 numbers .*found 3"),
        (bundle.PriorFactor(("camera", 1), [800.0], 1.0), r"expected 4 numbers .*found 1"),
        (bundle.PositionFactor(("point", 1), [1, 2, 3], 1.0), r"point.*expected se3 .*found eucl"),
        (bundle.PriorFactor(("point", 1), [1, np.nan, 3], 1.0), r"finite"),
        (bundle.PriorFactor(("point", 1), [1, 2, 3], -1.0), r"positive definite"),
        (bundle.BetweenFactor(("image", 1), ("point", 1), POSE, 1.0), r"point"),
        (3, r"^factors: expected factors such as PriorFactor, found 3 at \[0\]"),
    ],
)
def test_bad_factors_are_one_line(factor, message):
    problem = scenes.make_problem()
    with pytest.raises(bundle.InputError, match=message) as caught:
        bundle.solve(problem, factors=[factor])
    assert "\n" not in str(caught.value)
    if isinstance(factor, bundle.PriorFactor):
        assert str(caught.value).startswith("factor 0, PriorFactor(")


def test_a_residual_without_a_value_is_refused():
    problem = scenes.make_problem()

    def nowhere(_values):
        return np.array([np.nan]), [np.zeros((1, 3))]

    with pytest.raises(bundle.InputError, match=r"^factor 0, FunctionFactor.*finite residual"):
        bundle.solve(problem, factors=[bundle.FunctionFactor([("point", 1)], nowhere)])
    with pytest.raises(bundle.InputError, match="factors: expected a list of factors"):
        bundle.solve(problem, factors=3)
