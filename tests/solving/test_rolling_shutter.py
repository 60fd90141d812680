"""Solves of problems with rolling shutters against matrix exponentials and complex steps."""

import numpy as np
import pytest

import bundle
from bundle import _core
from bundle.model.residuals import linearize
from tests import rolling, scenes

MODELS = ("SIMPLE_RADIAL", "PINHOLE", "OPENCV", "OPENCV_FISHEYE", "FOV", "EUCM")
EXACT = {
    "function_tolerance": 1e-15,
    "gradient_tolerance": 1e-13,
    "parameter_tolerance": 1e-14,
    "check_solution": False,
}


def small(model="SIMPLE_RADIAL", *, direction="rows", ties=False, **changes):
    scene = {"num_images": 5, "num_points": 30, "seed": 2, "perturbation": 0, **changes}
    of = {name: scene.pop(name) for name in ("rate", "noise", "row_time") if name in scene}
    return rolling.filmed(
        scenes.make_problem(model=model, **scene), direction=direction, ties=ties, seed=3, **of
    )


@pytest.mark.parametrize("row_time", ["fixed-point", "observed"])
@pytest.mark.parametrize("direction", ["rows", "columns", ("rows", "global", "columns") * 2])
@pytest.mark.parametrize("model", MODELS)
def test_residuals_are_those_of_matrix_exponentials(model, direction, row_time):
    of = direction if isinstance(direction, str) else direction[:5]
    problem = small(model, direction=of, rate=1.5, row_time=row_time)
    expected = rolling.residuals(problem)
    found, behind = _core.reprojection_residuals(problem, 1, "auto")
    assert not behind.any()
    np.testing.assert_allclose(found, expected, atol=1e-10)
    errors, _ = bundle.reprojection_errors(problem)
    np.testing.assert_allclose(errors, np.linalg.norm(expected, axis=1), atol=1e-10)
    assert np.abs(expected - scenes.residuals(problem)).max() > 3


@pytest.mark.parametrize("rate", [0, 1e-9, 1, 3])
@pytest.mark.parametrize("row_time", ["fixed-point", "observed"])
@pytest.mark.parametrize("direction", ["rows", "columns"])
def test_derivatives_are_those_of_complex_steps(direction, row_time, rate):
    """By the implicit function theorem on the oracle's own derivatives at constant row times."""
    problem = small("OPENCV", direction=direction, row_time=row_time, rate=rate)
    rows = rolling.Rows(problem)
    observed = row_time == "observed"
    s = rows.time(problem.observation_xy) if observed else rows.fixed_point()
    found = linearize(problem)
    poses, twists = rolling.matrices(problem), problem.rolling_shutter.twist
    image = problem.observation_image

    def along(**values):
        return rows.project(s + 0j, **values).imag / 1e-30

    speed = rows.project(s + 1e-30j).imag / 1e-30
    n = np.arange(len(s))
    share = speed[n, rows.axis] / rows.size

    def at_fixed_point(by):
        if observed:
            return by
        moved = by[n, rows.axis] / rows.size / (1 - share)
        return by + speed * moved[:, None]

    for k in range(6):
        step = np.zeros((problem.num_images, 6), complex)
        step[:, k] = 1e-30j
        turned = poses + 0j
        turned[:, :3, :3] = np.array([scenes.exp(w) for w in step[:, :3]]) @ poses[:, :3, :3]
        turned[:, :3, 3] = poses[:, :3, 3] + step[:, 3:]
        by_pose = at_fixed_point(along(poses=turned))
        np.testing.assert_allclose(found.d_pose[:, :, k], by_pose, rtol=1e-7, atol=1e-6)
        by_twist = at_fixed_point(along(twists=twists + step))
        np.testing.assert_allclose(found.d_twist[:, :, k], by_twist, rtol=1e-7, atol=1e-6)
    for k in range(3):
        points = problem.points + 0j
        points[:, k] += 1e-30j
        by_point = at_fixed_point(along(points=points))
        np.testing.assert_allclose(found.d_point[:, :, k], by_point, rtol=1e-7, atol=1e-6)
    for k in range(8):
        params = problem.camera_params + 0j
        params[:, k] += 1e-30j
        by_params = at_fixed_point(along(params=params))
        np.testing.assert_allclose(found.d_params[:, :, k], by_params, rtol=1e-7, atol=1e-6)
    assert (image >= 0).all()


@pytest.mark.parametrize("direction", ["rows", "columns", ("rows", "global", "columns") * 2])
@pytest.mark.parametrize("model", ["SIMPLE_RADIAL", "OPENCV", "RAD_TAN_THIN_PRISM_FISHEYE"])
def test_the_checker_approves_every_jacobian(model, direction):
    of = direction if isinstance(direction, str) else direction[:5]
    for row_time in ("fixed-point", "observed"):
        problem = small(model, direction=of, row_time=row_time, rate=2)
        report = bundle.check_jacobians(problem, samples_per_image=4, details=True)
        assert report.verdict == "correct", report
        assert any("twist" in name for name in report.details[0].columns)


def start_of(problem, seed=5):
    """Poses and points a little off, zero twists."""
    rng = np.random.default_rng(seed)
    poses = problem.cam_from_world.copy()
    poses[:, 4:] += 0.01 * rng.standard_normal((len(poses), 3))
    points = problem.points + 0.01 * rng.standard_normal(problem.points.shape)
    return rolling.still(problem).replace(cam_from_world=poses, points=points)


MODES = {
    "free": {},
    "free, columns": {"direction": "columns"},
    "free, observed rows": {"row_time": "observed"},
    "free, shared camera": {"shared": True},
    "free, one global": {"direction": ("rows", "global", "columns", "rows", "rows")},
    "free, huber": {"options": {"loss": "huber", "loss_scale": 0.5}},
    "free, dogleg": {"options": {"trust_region_strategy_type": "dogleg"}},
    "free, two kept": {"options": {"fixed_image_ids": (2, 4), "fixed_point_ids": (1, 2, 3)}},
    "free, wide lens": {"model": "RAD_TAN_THIN_PRISM_FISHEYE"},
    "tied": {"ties": True, "options": {"twists": "tied", "twist_sigma": (0.002, 0.01)}},
    "tied, readout": {
        "ties": True,
        "options": {"twists": "tied", "twist_sigma": (0.002, 0.01), "refine_readout": True},
    },
    "hard": {"ties": True, "options": {"twists": "hard"}},
    "hard, readout": {"ties": True, "options": {"twists": "hard", "refine_readout": True}},
    "hard, readout, shared camera": {
        "ties": True,
        "shared": True,
        "options": {"twists": "hard", "refine_readout": True},
    },
    "hard, one kept": {"ties": True, "options": {"twists": "hard", "fixed_image_ids": (3,)}},
}


@pytest.mark.parametrize("solver", ["dense_schur", "sparse_schur"])
@pytest.mark.parametrize("mode", MODES)
def test_both_backends_take_the_same_steps(mode, solver):
    scene = dict(MODES[mode])
    # More steps reach the minimum, where rounding decides what is taken.
    options = {**EXACT, "max_num_iterations": 5, **scene.pop("options", {})}
    if scene.get("ties"):
        options["refine"] = ("poses", "points")
        scene["rate"] = 0.1
    problem = start_of(small(num_points=60, **scene))
    runs = {
        backend: bundle.solve(problem, backend=backend, linear_solver_type=solver, **options)
        for backend in ("ceres", "fused")
    }
    assert runs["fused"].summary.backend_used == "FUSED"
    costs = [run.iterations["cost"] for run in runs.values()]
    count = min(map(len, costs))
    assert count >= 4
    taken = np.asarray(runs["ceres"].iterations["step_is_successful"][:count], bool)
    taken[0] = True
    np.testing.assert_allclose(costs[1][:count][taken], costs[0][:count][taken], rtol=1e-9)
    ends = [run.problem.rolling_shutter for run in runs.values()]
    np.testing.assert_allclose(ends[1].twist, ends[0].twist, atol=1e-8)
    np.testing.assert_allclose(ends[1].readout, ends[0].readout, atol=1e-8)
    last = runs["fused"].problem
    if scene.get("direction", "rows") == "rows" and "loss" not in options and "tied" not in mode:
        squares = (rolling.residuals(last) ** 2).sum()
        assert runs["fused"].summary.final_cost == pytest.approx(squares / 2, rel=1e-9)


@pytest.mark.parametrize("solver", ["sparse_schur", "dense_schur", "iterative_schur"])
def test_hard_twists_have_the_same_bits_on_any_number_of_threads(solver):
    problem = start_of(small(num_points=200, ties=True, rate=0.1))
    options = {
        **{"twists": "hard", "linear_solver_type": solver, "max_num_iterations": 4},
        "refine": ("poses", "points"),
    }
    ends = [
        bundle.solve(problem, backend="fused", num_threads=threads, **options).problem
        for threads in (1, 2, 5)
    ]
    for other in ends[1:]:
        assert other.cam_from_world.tobytes() == ends[0].cam_from_world.tobytes()
        assert other.points.tobytes() == ends[0].points.tobytes()


def test_hard_twists_follow_the_poses():
    problem = start_of(small(ties=True, num_points=60, rate=0.1))
    options = {"twists": "hard", "refine": ("poses", "points"), **EXACT}
    shutter = bundle.solve(problem, **options).problem
    found = shutter.rolling_shutter
    motion = rolling.motions(shutter, found.neighbours, found.frames)
    np.testing.assert_allclose(found.twist, found.readout[0] * motion, atol=1e-12)
    assert found.readout[0] == 0.8


@pytest.mark.parametrize("backend", ["ceres", "fused"])
def test_ties_cost_what_matrix_logarithms_say(backend):
    problem = small(ties=True, rate=2)
    sigma = (0.003, 0.02)
    result = bundle.solve(
        problem,
        backend=backend,
        twists="tied",
        twist_sigma=sigma,
        max_num_iterations=0,
        refine=("poses", "points"),
    )
    shutter = problem.rolling_shutter
    motion = rolling.motions(problem, shutter.neighbours, shutter.frames)
    ties = (shutter.twist - 0.8 * motion) / np.repeat(sigma, 3)
    squares = (rolling.residuals(problem) ** 2).sum() + (ties**2).sum()
    assert result.summary.initial_cost == pytest.approx(squares / 2, rel=1e-12)


@pytest.mark.parametrize("backend", ["ceres", "fused"])
def test_global_shutters_solve_as_before_bit_for_bit(backend):
    problem = scenes.make_problem(num_points=60)
    shutter = bundle.RollingShutter(
        direction=("global",) * problem.num_cameras, twist=np.zeros((problem.num_images, 6))
    )
    options = {"backend": backend, "num_threads": 1}
    plain = bundle.solve(problem, **options)
    same = bundle.solve(problem.replace(rolling_shutter=shutter), **options)
    for name in ("cam_from_world", "points", "camera_params"):
        assert np.array_equal(getattr(plain.problem, name), getattr(same.problem, name))
    assert np.array_equal(plain.iterations["cost"], same.iterations["cost"])
    # Twists of zero that are not refined give the residuals of a global shutter.
    rolls = shutter.replace(direction=("rows",) * problem.num_cameras)
    found = bundle.reprojection_errors(problem.replace(rolling_shutter=rolls))[0]
    assert np.array_equal(found, bundle.reprojection_errors(problem)[0])


def test_a_row_that_is_read_twice_does_not_count():
    """The image moves faster than the readout: g . c >= 1."""
    problem = small(num_points=20, noise=0)
    shutter = problem.rolling_shutter
    twist = np.zeros_like(shutter.twist)
    twist[:, 0] = -1.9  # radians per frame height: 1.9 x the focal length over 600 rows
    fast = problem.replace(rolling_shutter=shutter.replace(twist=twist))
    errors, _ = bundle.reprojection_errors(fast)
    assert np.isnan(errors).any()
    twist[:, 0] = 40  # more than a radian from the middle row
    errors, _ = bundle.reprojection_errors(
        problem.replace(rolling_shutter=shutter.replace(twist=twist))
    )
    assert np.isnan(errors).mean() > 0.5
    for backend in ("ceres", "fused"):
        run = bundle.solve(fast, backend=backend, max_num_iterations=3)
        assert np.isfinite(run.summary.final_cost)


def test_a_small_world_is_solved_in_its_own_unit():
    problem = start_of(small(num_points=60))
    tiny = problem.replace(
        cam_from_world=problem.cam_from_world * np.r_[np.ones(4), np.full(3, 1e-6)],
        points=problem.points * 1e-6,
    )
    ends = [bundle.solve(one, gauge="two_cameras", **EXACT) for one in (problem, tiny)]
    assert ends[1].summary.final_cost == pytest.approx(ends[0].summary.final_cost, rel=1e-9)
    big, small_twist = (end.problem.rolling_shutter.twist for end in ends)
    scale = np.repeat([1, 1e6], 3)
    np.testing.assert_allclose(small_twist * scale, big, atol=1e-6)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"refine_readout": True}, "refine_readout: valid only with twists=tied or hard"),
        ({"twists": "tied"}, "twist_sigma"),
        ({"twists": "tied", "twist_sigma": (1, 0)}, "two numbers above 0"),
        ({"twists": "tied", "twist_sigma": "1"}, "two numbers above 0"),
        ({"twists": "tied", "twist_sigma": (1, 1), "gauge": "none"}, "smaller world"),
        ({"twists": "loose"}, "twists"),
    ],
)
def test_bad_requests_are_one_line(options, words):
    with pytest.raises(bundle.InputError, match=words) as error:
        bundle.solve(small(ties=True), **options)
    assert "\n" not in str(error.value)


def test_ties_need_neighbours_times_and_readouts():
    problem = small(ties=True)
    shutter = problem.rolling_shutter
    options = {"twists": "tied", "twist_sigma": (1, 1)}
    for changes, words in (
        ({"neighbours": None}, "times and neighbours"),
        ({"frames": None}, "times and neighbours"),
        ({"readout": None}, "readout"),
        ({"frames": np.zeros(5)}, "order of time"),
    ):
        with pytest.raises(bundle.InputError, match=words):
            bundle.solve(problem.replace(rolling_shutter=shutter.replace(**changes)), **options)
    with pytest.raises(bundle.InputError, match="without rolling shutters"):
        bundle.solve(problem.replace(rolling_shutter=None), **options)


@pytest.mark.parametrize("places", [0, 1])
def test_attitudes_and_one_position_do_not_hold_the_scale(places):
    problem = start_of(small(ties=True, num_points=60))
    down = -rolling.matrices(problem)[:, :3, 2]
    priors = [
        bundle.GravityPrior(int(image), one, 1.0)
        for image, one in zip(problem.image_ids, down, strict=True)
    ]
    priors += [
        bundle.PositionPrior(int(image), centre, 0.05)
        for image, centre in zip(
            problem.image_ids[:places], problem.projection_centers[:places], strict=True
        )
    ]
    options = {"priors": priors, "twists": "tied", "twist_sigma": (0.002, 0.01), "align": False}
    with pytest.raises(bundle.InputError, match="smaller world"):
        bundle.solve(problem, gauge="none", **options)
    found = bundle.solve(problem, **options)
    assert found.options.gauge == "two_cameras"
    a, b = found.problem.projection_centers, problem.projection_centers
    assert np.linalg.norm(np.ptp(a, axis=0)) == pytest.approx(
        np.linalg.norm(np.ptp(b, axis=0)), rel=0.1
    )


def test_priors_hold_the_scale_of_tied_twists():
    problem = start_of(small(ties=True, num_points=60))
    priors = [
        bundle.PositionPrior(name, centre, 0.05)
        for name, centre in zip(problem.image_names, problem.projection_centers, strict=True)
    ]
    result = bundle.solve(problem, priors=priors, twists="tied", twist_sigma=(0.002, 0.01), **EXACT)
    assert result.options.gauge == "none"
    assert result.summary.is_solution_usable
