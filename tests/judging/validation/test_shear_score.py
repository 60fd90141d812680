"""The exact test for shear, against dense projections and planted noise, lenses and motion."""

import numpy as np
import pytest

import bundle
from bundle.judging.validation import row_test as module
from bundle.judging.validation.row_test import row_test, shear_score
from bundle.model import point_elimination
from bundle.model.cameras import param_kinds
from bundle.model.residuals import linearize, residuals
from tests.scenes import make_problem


def noisy(seed=0, shear=0.0, sigma=0.5, **options):
    """A problem at the truth with noise, and with a shear of each image [pixels]."""
    options = {"num_images": 6, "num_points": 50, "shared": True, "perturbation": 0.0, **options}
    problem = make_problem(noise=0.0, model="RADIAL", **options)
    rng = np.random.default_rng(seed)
    position = (problem.observation_xy - [400, 300]) / 400
    own = shear * rng.normal(size=problem.num_images)[problem.observation_image]
    moved = sigma * rng.normal(size=position.shape) + own[:, None] * position[:, ::-1]
    return problem.replace(observation_xy=problem.observation_xy + moved), position


def whole(problem, position):
    """Return the arguments of a test of all observations."""
    return problem, np.arange(problem.num_observations), position, linearize(problem).residual


def dense(problem, position):
    """Return ratio and degrees of freedom by projections of the whole matrix."""
    found = linearize(problem)
    n, m, count = problem.num_images, problem.num_points, problem.num_observations
    image, point = problem.observation_image, problem.observation_point
    used = [k for k, kind in enumerate(param_kinds("RADIAL")) if kind in ("focal", "extra")]
    x, y = position.T
    s = x * x + y * y
    fields = [
        (x, y), (s * x, s * y), (x, -y), (2 * x * y, s + 2 * y * y), (s + 2 * x * x, 2 * x * y),
    ]  # fmt: skip
    j = np.zeros((count, 2, 11 * n + 3 * m + len(used)))
    a = np.zeros((count, 2, n))
    for row in range(count):
        i, p = image[row], point[row]
        j[row, :, 6 * i : 6 * i + 6] = found.d_pose[row]
        j[row, :, 6 * n + 3 * p : 6 * n + 3 * p + 3] = found.d_point[row]
        for k, field in enumerate(fields):
            j[row, :, 6 * n + 3 * m + 5 * i + k] = field[0][row], field[1][row]
        j[row, :, 11 * n + 3 * m :] = found.d_params[row][:, used]
        a[row, :, i] = y[row], x[row]
    j, a = j.reshape(2 * count, -1), a.reshape(2 * count, -1)
    a /= np.linalg.norm(a, axis=0)
    norms = np.linalg.norm(j, axis=0)
    u, values, _ = np.linalg.svd(j / np.where(norms > 0, norms, 1), full_matrices=False)
    u = u[:, values > 1e-6 * values[0]]
    project = np.eye(2 * count) - u @ u.T
    f, r = a.T @ project @ a, project @ found.residual.ravel()
    variance = r @ r / (2 * count - u.shape[1])
    scores = a.T @ r
    return scores @ scores / (variance * np.trace(f)), np.trace(f) ** 2 / (f**2).sum()


@pytest.mark.parametrize("track", [None, 3])
def test_ratio_is_that_of_dense_projections(track, monkeypatch):
    problem, position = noisy(shear=0.5, track=track)
    monkeypatch.setattr(point_elimination, "_CHUNK", 7)
    found = shear_score(*whole(problem, position))
    assert found == pytest.approx(dense(problem, position), rel=1e-6)


def test_noise_alone_has_the_chi_square_and_motion_has_not():
    alone = [shear_score(*whole(*noisy(seed=seed))) for seed in range(60)]
    ratios, freedom = np.array([one.ratio for one in alone]), alone[0].freedom
    assert ratios.mean() == pytest.approx(1, abs=4 * np.sqrt(2 / freedom / 60))
    assert ratios.std() == pytest.approx(np.sqrt(2 / freedom), rel=0.35)
    moved = [shear_score(*whole(*noisy(seed=seed, shear=2.0))).ratio for seed in range(10)]
    assert min(moved) > 2 * ratios.mean()


def test_a_part_is_a_valid_test(monkeypatch):
    problem, position = noisy(num_images=12, num_points=90, shear=2.0)
    everything = shear_score(*whole(problem, position))
    monkeypatch.setattr(module, "MOST_IMAGES", 6)
    monkeypatch.setattr(module, "MOST_POINTS", 40)
    part = shear_score(*whole(problem, position))
    assert 1 < part.freedom < everything.freedom
    assert part.ratio > 2


def test_nothing_to_test():
    problem, position = noisy()
    for rows in (np.arange(0), np.arange(1)):
        found = shear_score(problem, rows, position[rows], position[rows])
        assert np.isnan(found.ratio)
        assert found.freedom == 0


def test_really_different_lenses_leave_shear_but_no_motion():
    problem = bundle.synthesize(
        scene="orbit",
        num_images=11,
        num_points=770,
        mean_track_length=3.019857004460124,
        camera_model="OPENCV",
        cameras="individual",
        pixel_noise=0.4755808024133401,
        seed=6,
    ).problem
    shared = bundle.change_camera_model(bundle.share_cameras(problem), "FULL_OPENCV").problem
    fitted = bundle.solve(
        shared, loss="cauchy", max_num_iterations=60, function_tolerance=1e-8, num_threads=1
    ).problem
    found = row_test(fitted, residuals(fitted).xy)
    assert found.shear > 3
    assert found.size > 0.01
    assert found.confirmation < 2
    assert not found.fires
