"""Covariances against the scatter of solutions over repeated noise."""

import numpy as np
import pytest
from scipy import stats

import bundle
from tests.scenes import make_problem

DRAWS = 200
SOLVE = {
    "gauge": "two_cameras",
    "function_tolerance": 1e-9,
    "check_solution": False,
    "num_threads": 1,
}


QUICK = {"function_tolerance": 1e-9, "check_solution": False, "num_threads": 1}


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


def laplace(rng, shape):
    return rng.laplace(size=shape) / np.sqrt(2)


def of_two_sigmas(rng, shape):
    return rng.standard_normal(shape) * rng.choice([0.5, 1.5], shape[0])[:, None]


HUBER = {"loss": "huber", "loss_scale": 1.0}


@pytest.mark.parametrize(
    ("track", "noise", "loss"),
    [
        (2, gauss, {}),
        (6, of_two_sigmas, {}),
        (3, laplace, {"loss": "cauchy", "loss_scale": 1.5}),
        (2, gauss, HUBER),
        (3, gauss, HUBER),
    ],
)
def test_a_sandwich_of_short_tracks_has_the_size_of_the_errors(track, noise, loss):
    """Uncorrected residuals give 2 to 4 for translations, and 3 and far more for points."""
    problem = make_problem(
        num_images=8, num_points=600 // track, track=track, shared=True, noise=0, perturbation=0
    )
    rng = np.random.default_rng(1)
    given = {"fixed_image_ids": (1, 6), "refine": ("poses", "points"), **loss, **QUICK}
    of_poses, of_points = [], []
    for _ in range(30):
        xy = problem.observation_xy + noise(rng, problem.observation_xy.shape)
        solved = bundle.solve(problem.replace(observation_xy=xy), **given).problem
        cov = bundle.covariance(solved, robust="sandwich", gauge="none", **given)
        moved = solved.cam_from_world[:, 4:] - problem.cam_from_world[:, 4:]
        of_poses += [
            moved[i] @ np.linalg.solve(cov.pose_covariance[i, 3:, 3:], moved[i]) / 3
            for i in (1, 2, 3, 4, 6, 7)
        ]
        variances = np.einsum("nii->ni", cov.point_covariance)
        of_points.append(((solved.points - problem.points) ** 2 / variances).mean())
    assert 0.75 < np.mean(of_poses) < 1.3
    assert 0.75 < np.mean(of_points) < 1.3
