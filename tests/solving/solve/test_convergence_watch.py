"""The watch speaks up about Jacobians that lie, and about nothing else.

Lying solves are made by a replica of Ceres' Levenberg-Marquardt that is fed wrong Jacobians; with
the true ones its trace is that of bundle.solve.
"""

import numpy as np
import pytest

import bundle
from bundle import _core
from tests import scenes
from tests.solving.solve import levenberg_marquardt
from tests.solving.solve.lies import CAUGHT, LIES, SCENES, UNCERTAIN, UNSEEN


def lying_trace(scene, lie, **options):
    changes, columns = SCENES[scene]
    problem = scenes.make_problem(**changes)
    return levenberg_marquardt.solve(problem, LIES[lie], columns=columns, **options).iterations


def convergence(iterations):
    return _core.watch_convergence(iterations, "test it with `bundle check`")


def watch(trace):
    return convergence({name: [step[name] for step in trace] for name in trace[0]})


@pytest.mark.parametrize("loss, loss_scale", [("trivial", 1.0), ("cauchy", 0.5), ("tukey", 4.0)])
@pytest.mark.parametrize("scene", SCENES)
def test_the_replica_with_true_jacobians_does_what_a_solve_does(
    solve, backend, scene, loss, loss_scale
):
    changes, columns = SCENES[scene]
    problem = scenes.make_problem(**changes)
    options = {"loss": loss, "loss_scale": loss_scale, "max_num_iterations": 15}
    rules = {"gauge": "none", "cheirality": "algebraic", "convergence": "ceres"}
    trace = levenberg_marquardt.solve(problem, columns=columns, **options).iterations
    exact = {"ceres": "dense_qr", "fused": "dense_schur"}[backend]
    iterations = solve(problem, linear_solver_type=exact, **rules, **options).iterations
    assert len(trace) == len(iterations["cost"]) >= 3
    # Ceres 2.2 measures steps only from the first that succeeds on.
    measured = 2 + int(np.argmax(iterations["step_is_successful"][1:]))
    for name in ("cost", "trust_region_radius", "step_norm", "relative_decrease"):
        begin = measured if name == "step_norm" else 0
        np.testing.assert_allclose(
            [step[name] for step in trace][begin:],
            iterations[name][begin:],
            rtol=1e-5,
            atol=1e-8,
            err_msg=name,
        )
    np.testing.assert_allclose([step["cost"] for step in trace], iterations["cost"], rtol=1e-6)
    assert [step["step_is_successful"] for step in trace] == list(iterations["step_is_successful"])


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("lie", CAUGHT)
def test_a_wrong_jacobian_is_noticed(lie, scene):
    trace = lying_trace(scene, lie, function_tolerance=1e-8)
    assert min(step["cost"] for step in trace) < 0.99 * trace[0]["cost"]  # the cost still falls
    sentence = watch(trace)
    assert "`bundle check`" in sentence
    assert sentence.endswith(".")
    assert "\n" not in sentence


def test_every_lie_is_known_to_be_caught_uncertain_or_unseen():
    assert set(LIES) == {*CAUGHT, *UNCERTAIN, *UNSEEN}
    caught = [bool(watch(lying_trace("arc", lie))) for lie in UNSEEN]
    assert not any(caught)  # else it belongs into another list


def test_true_jacobians_are_not_suspected():
    for scene, (changes, columns) in SCENES.items():
        problem = scenes.make_problem(**changes)
        for loss, loss_scale in (("trivial", 1.0), ("cauchy", 0.3), ("tukey", 3.0)):
            trace = levenberg_marquardt.solve(
                problem, columns=columns, loss=loss, loss_scale=loss_scale, function_tolerance=1e-10
            ).iterations
            assert watch(trace) == "", (scene, loss)


def hard_problem(rng, seed):
    """A problem that is honest and hard: bad starts, gross outliers, far points, no parallax."""
    num_images = int(rng.integers(2, 8))
    problem = scenes.make_problem(
        num_images=num_images,
        num_points=int(rng.integers(10, 40)),
        model=str(rng.choice(list(scenes.PARAMS))),
        shared=bool(rng.random() < 0.5),
        seed=seed,
        noise=float(rng.choice([0, 1e-3, 0.5, 5, 50])),
        perturbation=float(rng.choice([1e-3, 1e-2, 5e-2, 0.2, 1.0])),
        track=int(rng.integers(2, num_images)) if num_images > 3 and rng.random() < 0.5 else None,
    )
    kind = rng.choice(["as it is", "outliers", "far points", "no parallax"])
    if kind == "outliers":
        xy = problem.observation_xy.copy()
        xy[rng.random(len(xy)) < 0.2] += 500 * rng.standard_normal(2)
        return problem.replace(observation_xy=xy)
    if kind == "far points":
        points = problem.points * 10 ** rng.uniform(0, 3, (problem.num_points, 1))
        return problem.replace(points=points)
    if kind == "no parallax":
        poses = np.tile(problem.cam_from_world[0], (num_images, 1))
        poses[:, 4:] += 1e-3 * rng.standard_normal((num_images, 3))
        return problem.replace(cam_from_world=poses)
    return problem


def hard_options(rng):
    strategy, solver = [
        ("levenberg_marquardt", "dense_schur"),
        ("levenberg_marquardt", "sparse_schur"),
        ("levenberg_marquardt", "iterative_schur"),
        ("levenberg_marquardt", "cgnr"),
        ("dogleg", "dense_schur"),
        ("subspace_dogleg", "dense_qr"),
    ][rng.integers(6)]
    loss = str(rng.choice(["trivial", "huber", "soft_l1", "cauchy", "arctan", "tukey"]))
    scale = float(rng.choice([0.2, 1, 5]))
    return {
        "trust_region_strategy_type": strategy,
        "linear_solver_type": solver,
        "loss": loss,
        "loss_scale": 1.0 if loss == "trivial" else scale,
        "function_tolerance": float(rng.choice([1e-6, 1e-12, 0.0])),
        "gauge": str(rng.choice(["none", "two_cameras", "three_points"])),
        "cheirality": str(rng.choice(["zero", "algebraic"])),
        "num_threads": 1,
    }


@pytest.mark.parametrize(("batch", "backend"), [(0, "auto"), (1, "ceres")])
def test_honest_problems_however_hard_are_not_suspected(batch, backend):
    oscillated = 0
    for seed in range(75 * batch, 75 * (batch + 1)):
        rng = np.random.default_rng(seed)
        result = bundle.solve(hard_problem(rng, seed), backend=backend, **hard_options(rng))
        assert not suspicions(result), seed
        accepted = result.iterations["step_is_successful"]
        oscillated += np.count_nonzero(np.diff(accepted.astype(int))) > 4
    assert oscillated >= 7  # some were hard indeed


def suspicions(result):
    return [kind for kind in result.summary.warning_kinds if kind.startswith("suspicious_")]


REAL_OPTIONS = [
    {},
    {"loss": "tukey", "loss_scale": 4.0},
    {"loss": "cauchy", "linear_solver_type": "sparse_schur"},
    {"linear_solver_type": "iterative_schur", "gauge": "three_points"},
    {"trust_region_strategy_type": "dogleg", "linear_solver_type": "dense_schur"},
    {
        "trust_region_strategy_type": "subspace_dogleg",
        "linear_solver_type": "sparse_schur",
        "loss": "soft_l1",
        "loss_scale": 0.5,
    },
]

REAL_DATA = [
    *(f"colmap/{name}" for name in ("bartoszek", "batmo_rigs", "crane_mast", "lund_door")),
    *(f"colmap/{name}" for name in ("maupertuis", "video48", "vr_opencv")),
    *(f"bal/problem-{name}-pre.txt.bz2" for name in ("16-22106", "21-11315", "49-7776")),
]


@pytest.mark.parametrize("name", REAL_DATA)
def test_real_data_is_not_suspected(bundle_data, name):
    """Both backends take the same steps: they take turns with the options, as the models do."""
    problem = bundle.load(bundle_data / name)
    large = problem.num_observations > 20000
    first = REAL_DATA.index(name)
    for number in (first % 6,) if large else range(first % 2, 6, 2):
        options, backend = REAL_OPTIONS[number], ("fused", "ceres")[(number + first // 2) % 2]
        result = bundle.solve(
            problem, backend=backend, max_num_iterations=10 if large else 30, **options
        )
        assert not suspicions(result), options


def steps(radii, accepted, predicted, quality, *, gradient=None, length=None, cost=1e3):
    """A trace of steps; arrays may be numbers."""
    n = len(radii)
    predicted, quality = np.broadcast_to(predicted, n), np.broadcast_to(quality, n)
    trace = {
        "iteration": np.arange(n + 1),
        "cost": np.full(n + 1, cost),
        "cost_change": np.append(0, predicted * quality),
        "gradient_max_norm": np.ones(n + 1) if gradient is None else gradient,
        "step_norm": np.append(0, predicted if length is None else length),
        "relative_decrease": np.append(0, quality),
        "trust_region_radius": np.append(radii, radii[-1]),
        "linear_solver_iterations": np.zeros(n + 1, int),
        "step_is_successful": np.append(True, np.broadcast_to(accepted, n)),
        "iteration_time_in_seconds": np.zeros(n + 1),
        "cumulative_time_in_seconds": np.zeros(n + 1),
    }
    return {name: np.asarray(values).tolist() for name, values in trace.items()}


RADII = np.array([1.0, 1 / 2, 1 / 8, 1 / 64, 1 / 1024, 1 / 2**15])


@pytest.mark.parametrize(
    "predicted, quality, suspicious",
    [
        pytest.param(RADII, -0.4, True, id="rises in proportion"),
        pytest.param(RADII, 0.0005, True, id="falls, too little"),
        pytest.param(RADII, 1 - 3 * RADII, False, id="recovers as R falls"),
        pytest.param(RADII, 1 - 300 * RADII, False, id="recovers late, as strong curvature has it"),
        pytest.param(
            RADII, 0.9 - 1e-4 / RADII, False, id="jumps by the same however short the step"
        ),
        pytest.param(RADII, -0.01 / RADII, False, id="saturates"),
        pytest.param(1.0, -0.4, False, id="steps that R does not shorten"),
        pytest.param(1e-9 * RADII, -0.4, False, id="rounding errors"),
    ],
)
def test_rejected_steps(predicted, quality, suspicious):
    assert bool(convergence(steps(RADII, False, predicted, quality))) == suspicious


ACCEPTED = 0.6 ** np.arange(12)


@pytest.mark.parametrize(
    "quality, gradient, suspicious",
    [
        pytest.param(0.05, np.ones(13), True, id="one slope, not the promised one"),
        pytest.param(1 - 0.9 * ACCEPTED, np.ones(13), False, id="quality recovers as R falls"),
        pytest.param(0.05, 0.6 ** np.arange(13), False, id="the gradient falls: convergence"),
        pytest.param(
            0.05, 3.0 ** (np.arange(13) % 2), False, id="the gradient jumps: a singular point"
        ),
    ],
)
def test_accepted_steps_that_get_shorter(quality, gradient, suspicious):
    trace = steps(ACCEPTED, True, ACCEPTED, quality, gradient=gradient)
    assert bool(convergence(trace)) == suspicious


def linear_tail(rate, quality, radius_growth, num_steps=12):
    """Steps whose error, gradient and length shrink by `rate` at a constant quality."""
    k = np.arange(num_steps + 1)
    return steps(
        1e4 * radius_growth ** k[:-1],
        True,
        rate ** (2 * k[:-1]),
        quality,
        gradient=rate**k,
        length=rate ** k[:-1],
    )


@pytest.mark.parametrize(
    "rate, quality, radius_growth, suspicious",
    [
        pytest.param(1 / 2, 1 - 1 / 4, 1.14, True, id="a column 2 times too large"),
        pytest.param(2 / 3, 1 - 4 / 9, 1.0, True, id="a column 3 times too large"),
        pytest.param(0.78, 0.4, 0.99, True, id="a column 2 times too small"),
        pytest.param(0.9, 1.9, 3.0, False, id="a robust loss, stiffer than the cost"),
        pytest.param(0.5, 1.5, 3.0, False, id="a robust loss, mildly"),
        pytest.param(0.5, 0.5, 1.0, False, id="overshooting, with large residuals"),
        pytest.param(0.5, 1.0, 1.0, False, id="damped, the model right"),
        pytest.param(1 / 3, 8 / 9, 1.0, False, id="damped, the cost stiffer"),
        pytest.param(0.57, 1.0, 3.0, False, id="inexact steps"),
        pytest.param(0.97, 0.61, 1.01, False, id="a curved valley"),
        pytest.param(1e-3, 1.0, 3.0, False, id="quadratic convergence"),
    ],
)
def test_linear_convergence(rate, quality, radius_growth, suspicious):
    trace = linear_tail(rate, quality, radius_growth)
    assert bool(convergence(trace)) == suspicious


def test_steps_that_do_not_shrink_as_the_error_does_are_no_tail():
    # Points that go to infinity double their depth: r = 1 / z has q = 3/4 at l = 1/2, honestly.
    trace = linear_tail(1 / 2, 3 / 4, 1.14)
    trace["step_norm"] = [2.0**k for k in range(len(trace["cost"]))]
    assert convergence(trace) == ""


def test_oscillating_damping_is_not_suspected():
    rng = np.random.default_rng(0)
    for _ in range(300):
        accepted = rng.random(40) < 0.6
        quality = np.where(accepted, rng.uniform(0.002, 2, 40), rng.uniform(-5, 0, 40))
        radii = 1e4 * np.cumprod(np.where(accepted, rng.uniform(1, 3, 40), rng.choice([0.5, 0.25])))
        predicted = 10.0 ** rng.uniform(-3, 3, 40)
        assert convergence(steps(radii, accepted, predicted, quality)) == ""


def test_nothing_is_said_of_nothing():
    trace = steps(RADII, False, RADII, -0.4)
    assert convergence({name: [] for name in trace}) == ""
    assert convergence({name: values[:1] for name, values in trace.items()}) == ""
    broken = {**trace, "cost_change": [float("nan")] * 7, "relative_decrease": [float("inf")] * 7}
    assert convergence(broken) == ""


def test_arrays_of_different_lengths_are_refused():
    trace = steps(RADII, False, RADII, -0.4)
    with pytest.raises(bundle.InputError, match="cost: expected 7 values, found 6"):
        convergence({**trace, "cost": trace["cost"][1:]})
