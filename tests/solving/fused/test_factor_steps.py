"""Factors beside the observations: both backends take the same steps, which are the right ones."""

import collections
import functools

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import bundle
from bundle import _core
from bundle.interface.options import LOSSES
from tests import scenes
from tests.solving.fused.covering import covering
from tests.solving.fused.measured_steps import first_measured
from tests.solving.fused.test_same_steps_as_ceres import shuffled

KINDS = (
    "prior",
    "position",
    "between",
    "relative",
    "linear",
    "camera",
    "cameras",
    "point",
    "mixed",
)
SCENES = ("own intrinsics", "shared intrinsics", "mixed models")
SOLVERS = {
    "dense": ("dense_schur", "auto"),
    "sparse": ("sparse_schur", "auto"),
    "iterative": ("iterative_schur", "schur_jacobi"),
}
HELD = {
    "nothing": {},
    "images": {"fixed_image_ids": (1, 3)},
    "a camera": {"fixed_camera_ids": (1,)},
    "points": {"fixed_point_ids": tuple(range(1, 13))},
    "intrinsics": {"refine": "poses,points"},
    "two cameras": {"gauge": "two_cameras"},
    "all factors": {
        "fixed_image_ids": (1, 2),
        "fixed_camera_ids": (1,),
        "fixed_point_ids": (3, 5, 8),
    },
}
# How far below and above the start, by the first letter of a parameter's name: f or k.
BOUNDS = {
    "none": None,
    "focal lengths": {"f": (0.3, 0.5)},
    "distortion": {"k": (2e-4, 1e-4), "p": (1e-4, 1e-4)},
    "out of reach": {"f": (300, 3000), "k": (10, 10)},
    "start on a bound": {"f": (0, 1), "k": (1e-3, 0)},
}
FACTORS = {
    "kind": KINDS,
    "scene": SCENES,
    "loss": LOSSES,
    "solver": tuple(SOLVERS),
    "trust region": ("levenberg_marquardt", "dogleg", "subspace_dogleg"),
    "held": tuple(HELD),
    "bounds": tuple(BOUNDS),
}


def allowed(row):
    if row["trust region"] == "levenberg_marquardt":
        return True
    # Without damping a free gauge is a singular system, whose steps are all rounding.
    return row["solver"] != "iterative" and row["held"] in ("images", "two cameras", "all factors")


ROWS = covering(FACTORS, allowed, seed=2)


def problem_of(scene):
    problem = scenes.make_problem(
        num_images=6, num_points=40, shared=scene == "shared intrinsics", perturbation=1e-2
    )
    if scene != "mixed models":
        return problem
    params, models = np.zeros((6, 8)), list(problem.camera_models)
    params[:, :4] = problem.camera_params
    for image in (1, 4):
        focal, x, y, k = problem.camera_params[image]
        params[image, :5], models[image] = [focal, focal, x, y, k], "OPENCV"
    return problem.replace(camera_models=models, camera_params=params)


def spd(rng, n, scale=1.0):
    root = np.eye(n) + 0.3 * rng.standard_normal((n, n))
    return scale * root @ root.T


class Maker:
    """Factors near the values of a problem, of about the weight of some observations."""

    def __init__(self, problem, loss="trivial"):
        self.problem = problem
        self.rng = np.random.default_rng(5)
        self.loss = {"loss": loss, "loss_scale": 2.0}

    def pose(self, image):
        delta = 0.02 * self.rng.standard_normal(6)
        return _core.retract("se3", self.problem.cam_from_world[image], delta)

    def params(self, camera):
        size = len(bundle.camera_models()[self.problem.camera_models[camera]])
        params = self.problem.camera_params[camera, :size]
        return params + self.rng.standard_normal(size) * np.where(params > 10, 5, 0.01)

    def camera_information(self, camera):
        params = self.params(camera)
        sigma = np.where(params > 10, 5, 0.05)
        return spd(self.rng, len(params)) / np.outer(sigma, sigma)

    def prior(self):
        for image in (1, 4):
            key = ("image", image + 1)
            yield bundle.PriorFactor(key, self.pose(image), spd(self.rng, 6, 1e6), **self.loss)

    def position(self):
        for image in range(0, 6, 2):
            center = self.problem.projection_centers[image]
            yield bundle.PositionFactor(
                ("image", image + 1),
                center + 0.05 * self.rng.standard_normal(3),
                spd(self.rng, 3, 1e6),
                lever_arm=(0.05, -0.02, 0.1),
                **self.loss,
            )

    def between(self):
        for a, b in ((1, 3), (5, 2), (0, 4)):
            difference = _core.local_coordinates("se3", self.pose(a), self.pose(b))
            measured = _core.retract("se3", [0, 0, 0, 1.0, 0, 0, 0], difference)
            yield bundle.BetweenFactor(
                ("image", a + 1), ("image", b + 1), measured, spd(self.rng, 6, 1e6), **self.loss
            )

    def relative(self):
        for a, b in ((0, 5), (3, 2)):
            x, y = (Rotation.from_quat(self.pose(i)[:4]) for i in (a, b))
            s, t = (self.pose(i)[4:] for i in (a, b))
            turn = y * x.inv()
            measured = np.r_[turn.as_quat(), t - turn.apply(s)]
            keys = ("image", a + 1), ("image", b + 1)
            yield bundle.RelativePoseFactor(*keys, measured, spd(self.rng, 6, 1e6), **self.loss)

    def linear(self):
        poses = {("image", 2): self.pose(1), ("image", 6): self.pose(5)}
        points = {**poses, ("camera", 1): self.params(0)}
        scale = np.r_[np.full(12, 100), 1 / np.where(self.params(0) > 10, 5, 0.05)]
        root = self.rng.standard_normal((8, len(scale))) * scale  # of rank 8
        yield bundle.LinearPrior(
            root.T @ root,
            root.T @ self.rng.standard_normal(8),
            points,
            tuple(points),
            manifolds=dict.fromkeys(poses, "se3"),
            **self.loss,
        )

    def camera(self):
        for camera in {0, self.problem.num_cameras - 1}:
            key = ("camera", camera + 1)
            information = self.camera_information(camera)
            yield bundle.PriorFactor(key, self.params(camera), information, **self.loss)

    def cameras(self):
        models = self.problem.camera_models
        for a in range(self.problem.num_cameras - 1):
            if models[a] != models[a + 1]:
                continue
            information = self.camera_information(a)
            measured = self.params(a + 1) - self.params(a)
            keys = ("camera", a + 1), ("camera", a + 2)
            yield bundle.BetweenFactor(*keys, measured, information, **self.loss)

    def point(self):
        for point in (2, 4, 7, 7, 20):
            key = ("point", point + 1)
            value = self.problem.points[point] + 0.05 * self.rng.standard_normal(3)
            yield bundle.PriorFactor(key, value, spd(self.rng, 3, 1e6), **self.loss)

    def mixed(self):
        for kind in KINDS[:-1]:
            yield from getattr(self, kind)()


def bounds_of(problem, row):
    """Factors of every camera but the second, if there are more; otherwise None."""
    if BOUNDS[row["bounds"]] is None:
        return None
    bounds = {}
    for camera in {0, *range(2, problem.num_cameras)}:
        names = bundle.camera_models()[problem.camera_models[camera]]
        params = problem.camera_params[camera, : len(names)]
        below, above = np.transpose(
            [BOUNDS[row["bounds"]].get(name[0], (np.inf, np.inf)) for name in names]
        )
        bounds["camera", int(problem.camera_ids[camera])] = params - below, params + above
    return bounds


def factors_of(problem, row):
    return list(getattr(Maker(problem, row["loss"]), row["kind"])())


@functools.cache
def solves(number):
    """A row by Ceres, by Ceres otherwise, and by the fused backend."""
    row = ROWS[number]
    problem = problem_of(row["scene"])
    factors = factors_of(problem, row)
    solver, preconditioner = SOLVERS[row["solver"]]
    options = {
        "bounds": bounds_of(problem, row),
        "linear_solver_type": solver,
        "preconditioner_type": preconditioner,
        "trust_region_strategy_type": row["trust region"],
        "loss": row["loss"],
        "loss_scale": 1.0 if row["loss"] == "trivial" else 20.0,
        "gauge": "none",
        "max_num_iterations": 10,
        "function_tolerance": 1e-12,
        "num_threads": 2,
        **HELD[row["held"]],
    }
    exact = solver != "iterative_schur"
    witness = {**options, "linear_solver_type": "dense_qr"} if exact else options
    return (
        bundle.solve(problem, factors=factors, backend="ceres", **options),
        bundle.solve(shuffled(problem), factors=factors[::-1], backend="ceres", **witness),
        bundle.solve(problem, factors=factors, backend="fused", **options),
    )


TRACES = ("cost", "gradient_max_norm", "step_norm", "trust_region_radius")


def deviation(found, expected, name, n):
    """Differences of the iterations, in units of the largest value where values are rounding."""
    unmeasured = first_measured(expected.iterations)
    found, expected = (np.asarray(x.iterations[name][:n], float) for x in (found, expected))
    unit = np.abs(expected)
    if name in ("gradient_max_norm", "step_norm"):
        unit = np.maximum(unit, 1e-3 * unit.max())
    result = np.abs(found - expected) / np.maximum(unit, 1e-300)
    if name == "step_norm":
        result[:unmeasured] = 0
    return result


def num_comparable(number):
    """Iterations over which the rounding of Ceres itself stays well below the tolerance."""
    expected, other, _ = solves(number)
    n = min(len(expected.iterations["cost"]), len(other.iterations["cost"]))
    same = (
        expected.iterations["step_is_successful"][:n] == other.iterations["step_is_successful"][:n]
    )
    for name in TRACES:
        same &= deviation(other, expected, name, n) < 1e-10
    return n if same.all() else int(np.argmin(same))


def is_comparable_to_the_end(number):
    return num_comparable(number) == len(solves(number)[0].iterations["cost"])


@pytest.mark.parametrize("number", range(len(ROWS)), ids=lambda n: "-".join(ROWS[n].values()))
def test_same_steps_as_ceres(number):
    expected, _, found = solves(number)
    n = num_comparable(number)
    assert n > 0
    for name in TRACES:
        assert deviation(found, expected, name, n).max() < 1e-9, name
    names = [
        f"num_{what}{suffix}"
        for what in ("parameter_blocks", "parameters", "residual_blocks", "residuals")
        for suffix in ("", "_reduced")
    ]
    for name in [*names, "num_factors", "num_information_nonzeros", "schur_structure_given"]:
        assert getattr(found.summary, name) == getattr(expected.summary, name), name
    assert found.summary.fixed_cost == pytest.approx(expected.summary.fixed_cost, rel=1e-12)
    np.testing.assert_allclose(found.factor_costs_before, expected.factor_costs_before, rtol=1e-12)
    if is_comparable_to_the_end(number):
        assert found.active_bounds == expected.active_bounds


def reached_bounds(number):
    """Bounds on which both backends end and no parameter starts, as far as they are comparable."""
    row, (expected, other, found) = ROWS[number], solves(number)
    if not is_comparable_to_the_end(number):
        return set()
    problem = expected.initial_problem
    ends = set(found.active_bounds) & set(expected.active_bounds) & set(other.active_bounds)
    assert bool(ends) <= (row["bounds"] not in ("none", "out of reach"))
    bounds, ids = bounds_of(problem, row), problem.camera_ids.tolist()
    reached = set()
    for key, name, side in ends:
        camera = ids.index(key[1])
        j = bundle.camera_models()[problem.camera_models[camera]].index(name)
        if problem.camera_params[camera, j] != bounds[key][side == "upper"][j]:
            reached.add((key, name, side))
    return reached


def test_the_design_compares_what_it_says():
    numbers = range(len(ROWS))
    assert len(ROWS) < 90
    ends = [len(solves(n)[0].iterations["cost"]) for n in numbers]
    # 0.9 with Ceres 2.1; with Ceres 2.2 on Debian 13 0.66 to 0.76, from run to run.
    assert np.mean([is_comparable_to_the_end(n) for n in numbers]) > 0.5
    assert min(ends) > 3
    # Factors matter: they are a good part of the cost.
    shares = [
        solves(n)[0].factor_costs_before.sum() / solves(n)[0].summary.initial_cost for n in numbers
    ]
    assert np.median(shares) > 0.005
    # So do bounds: steps end on some of them, with every solver, trust region and kind of factor.
    active = [ROWS[n] for n in numbers if reached_bounds(n)]
    assert len(active) > 0.4 * len(ROWS)
    for name in ("kind", "scene", "loss", "solver", "trust region"):
        counts = collections.Counter(row[name] for row in active)
        # With Ceres 2.2, whose runs differ, a kind may be left with one.
        assert min(counts[value] for value in FACTORS[name]) >= 1, name
    bounds = collections.Counter(row["bounds"] for row in active)
    assert min(bounds[name] for name in ("focal lengths", "distortion", "start on a bound")) > 5


def residuals(problem, factors, x):
    """Residuals of observations and position factors, by SciPy, at x = (poses, points)."""
    n = problem.num_images
    poses, points = x[: 6 * n].reshape(n, 6), x[6 * n :].reshape(-1, 3)
    rotation = Rotation.from_rotvec(poses[:, :3]) * Rotation.from_quat(
        problem.cam_from_world[:, :4]
    )
    image = problem.observation_image
    in_camera = rotation[image].apply(points[problem.observation_point]) + poses[image, 3:]
    parts = []
    for i in range(n):
        mine = image == i
        params = problem.camera_params[problem.image_camera[i]]
        parts.append((scenes.project("SIMPLE_RADIAL", params, in_camera[mine])
                      - problem.observation_xy[mine]).ravel())  # fmt: skip
    for factor in factors:
        kind, number = factor.keys[0]
        root = np.linalg.cholesky(factor.information).T
        if kind == "image":
            antenna = rotation[number - 1].inv().apply(factor.lever_arm - poses[number - 1, 3:])
            parts.append(root @ (antenna - factor.position))
        else:
            parts.append(root @ (points[number - 1] - factor.value))
    return np.concatenate(parts)


@pytest.mark.parametrize("backend", ["fused", "ceres"])
def test_the_optimum_is_that_of_scipy(backend):
    problem = scenes.make_problem(num_images=4, num_points=15)
    maker = Maker(problem)
    factors = []
    for image in range(4):
        center = problem.projection_centers[image] + 0.05 * maker.rng.standard_normal(3)
        factors.append(
            bundle.PositionFactor(
                ("image", image + 1), center, spd(maker.rng, 3, 1e4), lever_arm=(0.1, 0.2, -0.1)
            )
        )
    for point in (0, 3):
        value = problem.points[point] + 0.02 * maker.rng.standard_normal(3)
        factors.append(bundle.PriorFactor(("point", point + 1), value, spd(maker.rng, 3, 1e4)))
    result = bundle.solve(
        problem,
        factors=factors,
        refine="poses,points",
        backend=backend,
        function_tolerance=1e-14,
        parameter_tolerance=1e-12,
    )
    start = np.zeros((4, 6))
    start[:, 3:] = problem.cam_from_world[:, 4:]
    x = np.concatenate([start.ravel(), problem.points.ravel()])
    assert result.summary.initial_cost == pytest.approx(
        0.5 * np.sum(residuals(problem, factors, x) ** 2), rel=1e-11
    )
    best = least_squares(lambda x: residuals(problem, factors, x), x, xtol=1e-14, ftol=1e-14)
    assert result.summary.final_cost == pytest.approx(best.cost, rel=1e-9)
    np.testing.assert_allclose(result.problem.points.ravel(), best.x[24:], atol=1e-5)
    costs = 0.5 * residuals(problem, factors, best.x)[2 * problem.num_observations :] ** 2
    np.testing.assert_allclose(result.factor_costs_after, costs.reshape(-1, 3).sum(1), rtol=1e-3)
