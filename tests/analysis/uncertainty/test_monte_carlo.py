"""Covariances against the scatter of solutions over repeated noise."""

import numpy as np
from scipy import stats

import bundle
from tests.scenes import make_problem

DRAWS = 500
SOLVE = {
    "gauge": "two_cameras",
    "function_tolerance": 1e-9,
    "check_solution": False,
    "num_threads": 1,
}


def errors(truth, refined):
    """Errors of a pose (left perturbation, translation), a point and the refined intrinsics."""
    from scipy.spatial.transform import Rotation

    turn = [Rotation.from_quat(p.cam_from_world[3, :4]) for p in (truth, refined)]
    pose = refined.cam_from_world[3, 4:] - truth.cam_from_world[3, 4:]
    return {
        "pose": np.concatenate([(turn[1] * turn[0].inv()).as_rotvec(), pose]),
        "point": refined.points[5] - truth.points[5],
        "camera": (refined.camera_params - truth.camera_params)[0, [0, 3]],
    }


def blocks(cov):
    return {
        "pose": cov.pose_covariance[3],
        "point": cov.point_covariance[5],
        "camera": cov.camera_covariance[0][np.ix_([0, 3], [0, 3])],
    }


def draws(num_images, noise, settings, robust, every=1):
    """Errors of solutions of one scene under repeated noise, and covariances of some of them."""
    problem = make_problem(
        num_images=num_images, num_points=60, shared=True, noise=0, perturbation=0
    )
    exact = problem.observation_xy
    rng = np.random.default_rng(0)
    solver = bundle.Solver(problem, **SOLVE, **settings)
    found, covariances = [], []
    for draw in range(DRAWS):
        solved = solver.solve(problem.replace(observation_xy=exact + noise(rng, exact.shape)))
        found.append(errors(problem, solved.problem))
        if draw % every == 0:
            cov = bundle.covariance(solved, gauge="two_cameras", robust=robust, num_threads=1)
            covariances.append(blocks(cov))
    return found, covariances


def check(name, mean):
    size = {"pose": 6, "point": 3, "camera": 2}[name]
    low, high = stats.chi2.ppf([0.005, 0.995], size * DRAWS) / DRAWS
    assert low < mean < high, name


def gauss(rng, shape):
    return rng.standard_normal(shape)


def with_outliers(rng, shape):
    """5 % of the observations are off by ten times as much."""
    wrong = rng.random(shape[0]) < 0.05
    return rng.standard_normal(shape) * np.where(wrong, 10, 1)[:, None]


def test_mean_nees_of_gaussian_noise_is_that_of_chi_squared():
    found, covariances = draws(8, gauss, {}, "weights")
    for name in ("pose", "point", "camera"):
        both = zip(found, covariances, strict=True)
        check(name, np.mean([e[name] @ np.linalg.solve(c[name], e[name]) for e, c in both]))


def test_mean_nees_with_outliers_is_that_of_chi_squared_under_the_sandwich():
    """By its mean: a sandwich of one draw is itself an estimate, from few outliers each."""
    settings = {"loss": "huber", "loss_scale": 1.5}
    found, covariances = draws(16, with_outliers, settings, "sandwich", every=10)
    for name in ("pose", "point", "camera"):
        mean = np.mean([c[name] for c in covariances], axis=0)
        check(name, np.mean([e[name] @ np.linalg.solve(mean, e[name]) for e in found]))
