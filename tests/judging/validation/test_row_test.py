"""The test for motion in residuals, against regressions of single images and planted motion."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import chi2

from bundle.judging.validation import row_test as module
from bundle.judging.validation.row_test import row_test
from tests.scenes import make_problem, with_observations

HALF = 400.0  # of the longer side
CENTER = np.array([400.0, 300.0])


def scene(num_images=12, num_points=120, shared=True, **changes):
    return make_problem(num_images=num_images, num_points=num_points, shared=shared, **changes)


def noise(problem, sigma=1.0, seed=0):
    return sigma * np.random.default_rng(seed).normal(size=problem.observation_xy.shape)


def planted(problem, slopes):
    """Residuals of isotropic, anisotropic and shear slopes of each image."""
    x, y = ((problem.observation_xy - CENTER) / HALF).T
    iso, aniso, shear = slopes[problem.observation_image].T
    return np.stack([(iso + aniso) * x + shear * y, shear * x + (iso - aniso) * y], 1)


def draw(problem, scale, seed=1):
    return scale * np.random.default_rng(seed).normal(size=(problem.num_images, 3))


def test_slopes_and_errors_are_those_of_a_regression_of_an_image():
    problem = scene(num_images=3)
    r = noise(problem, seed=4) + planted(problem, draw(problem, 0.5))
    found = row_test(problem, r)
    sigma = np.median(np.hypot(*r.T)) / np.sqrt(2 * np.log(2))
    for index, image in enumerate(found.images):
        rows = (problem.observation_image == image) & (np.hypot(*r.T) < 5 * sigma)
        x, y = ((problem.observation_xy[rows] + r[rows] - CENTER) / HALF).T
        one, zero, n = np.ones(len(x)), np.zeros(len(x)), len(x)
        fields = [(one, zero), (zero, one), (-y, x), (x, y), (x, -y), (y, x)]
        a = np.stack([np.concatenate(field) for field in fields], axis=1)
        v = np.concatenate(r[rows].T)
        inverse = np.linalg.inv(a.T @ a)
        b = inverse @ a.T @ v
        scores = a * (v - a @ b)[:, None]
        scores = scores[:n] + scores[n:]
        variance = inverse @ scores.T @ scores @ inverse * n / (n - 3)
        assert found.slopes[index] == pytest.approx(b[3:], rel=1e-9)
        assert found.errors[index] == pytest.approx(np.sqrt(np.diag(variance)[3:]), rel=1e-9)


def test_slopes_vary_about_the_mean_of_their_camera():
    """Moments of DerSimonian and Laird (1986), one mean per camera."""
    rng = np.random.default_rng(0)
    camera = np.array([1, 0, 0, 1, 0, 3, 3], np.int32)
    slopes, variances = rng.normal(0, 3, (7, 3)), rng.uniform(0.5, 2, (7, 3))
    chi_squares, squares, freedom = module._variation(camera, slopes, variances)
    assert freedom == 4
    for k in range(3):
        found = scale = 0.0
        for one in (0, 1, 3):
            w, b = 1 / variances[camera == one, k], slopes[camera == one, k]
            found += (w * (b - np.average(b, weights=w)) ** 2).sum()
            scale += w.sum() - (w**2).sum() / w.sum()
        assert chi_squares[k] == pytest.approx(found) and found > freedom
        assert squares[k] == pytest.approx((found - freedom) / scale)
    calm = module._variation(camera, 1e-3 * slopes, variances)
    assert (calm[0] < 1e-4).all() and not calm[1].any()


def test_noise_alone_has_a_chi_square_and_does_not_fire():
    problem = scene(num_images=60)
    found = [row_test(problem, noise(problem, seed=seed)) for seed in range(20)]
    ratios = np.array([[one.isotropy, one.anisotropy, one.shear] for one in found])
    assert ratios.mean() == pytest.approx(1, abs=0.08)
    assert ratios.std() == pytest.approx(np.sqrt(2 / 59), rel=0.35)
    assert not any(one.fires for one in found)
    assert found[0].sigma == pytest.approx(1, rel=0.03)


def test_planted_motion_fires_with_its_size():
    problem = scene(num_images=60)
    slopes = draw(problem, np.array([0.2, 0.5, 0.7]))
    found = row_test(problem, noise(problem) + planted(problem, slopes))
    assert found.fires
    assert found.shear > 7
    assert found.deviations == pytest.approx(slopes.std(axis=0), abs=0.12)
    x2 = (((problem.observation_xy - CENTER) / HALF) ** 2).sum(1).mean()
    rms = np.sqrt(1 + (found.deviations[1:] ** 2).sum() * x2 / 2 / found.sigma**2) - 1
    assert found.size == pytest.approx(rms, rel=0.05)


@pytest.mark.parametrize("only", [0, 1])
def test_other_focal_lengths_and_other_aspect_ratios_are_no_motion(only):
    problem = scene()
    slopes = draw(problem, np.eye(3)[only])
    found = row_test(problem, noise(problem) + planted(problem, slopes))
    assert (found.isotropy, found.anisotropy)[only] > 10
    assert not found.fires


def test_anisotropy_and_shear_together_are_suspected(monkeypatch):
    problem = scene()
    assert not row_test(problem, noise(problem)).is_suspected
    r = noise(problem) + planted(problem, draw(problem, 0.3))
    found = row_test(problem, r)
    total = 11 * (found.anisotropy + found.shear)
    limit = chi2.isf(1e-4, 22)
    assert 11 * max(found.anisotropy, found.shear) < limit < total
    assert found.is_suspected and not found.fires
    monkeypatch.setattr(module, "_SIGNIFICANT", 0.99 * chi2.sf(total, 22))
    assert not row_test(problem, r).is_suspected


@pytest.mark.parametrize(("only", "found"), [(0, False), (1, True), (2, True)])
def test_other_focal_lengths_are_not_suspected(only, found):
    problem = scene()
    slopes = draw(problem, np.eye(3)[only])
    assert row_test(problem, noise(problem) + planted(problem, slopes)).is_suspected == found


def test_small_but_certain_motion_does_not_fire():
    problem = scene(num_points=3000)
    found = row_test(problem, noise(problem) + planted(problem, draw(problem, 0.2)))
    assert found.shear > 3.5
    assert found.size < module.RELEVANT
    assert not found.fires


def test_the_same_motion_in_all_images_belongs_to_the_lens():
    problem = scene()
    same = np.tile([0.5, 0.5, 0.5], (problem.num_images, 1))
    assert row_test(problem, noise(problem) + planted(problem, same)).shear < 2


def test_duplicated_points_count_once_and_outliers_do_not():
    problem = scene()
    r = noise(problem)
    twice = problem.replace(
        points=np.concatenate([problem.points, problem.points]),
        point_ids=np.arange(2 * problem.num_points),
        **{
            f"observation_{name}": np.concatenate([getattr(problem, f"observation_{name}")] * 2)
            for name in ("image", "xy", "keypoint")
        },
        observation_point=np.concatenate(
            [problem.observation_point, problem.num_points + problem.observation_point]
        ),
    )
    once = row_test(problem, r)
    assert row_test(twice, np.concatenate([r, r])).slopes == pytest.approx(once.slopes)
    far = r.copy()
    far[::50] = 300.0
    far[1::50] = np.nan
    assert row_test(problem, far).shear < 2


def test_order_and_unit_do_not_matter():
    problem = scene()
    r = noise(problem) + planted(problem, draw(problem, 0.5))
    order = np.random.default_rng(5).permutation(len(r))
    other = row_test(with_observations(problem, order), r[order])
    found = row_test(problem, r)
    assert other.shear == pytest.approx(found.shear)
    double = problem.replace(
        observation_xy=2 * problem.observation_xy, camera_sizes=2 * problem.camera_sizes
    )
    assert row_test(double, 2 * r).size == pytest.approx(found.size)
    no_size = problem.replace(camera_sizes=np.zeros((1, 2)))
    assert row_test(no_size, r).shear == pytest.approx(found.shear)


@pytest.mark.parametrize(
    "problem",
    [
        scene(shared=False),
        scene(num_images=1, track=1),
        scene(num_points=module.FEWEST_OF_IMAGE - 1),
        with_observations(scene(), np.zeros(0, int)),
    ],
    ids=["own cameras", "one image", "few observations", "none"],
)
def test_too_little_to_compare(problem):
    found = row_test(problem, noise(problem))
    assert np.isnan([found.isotropy, found.anisotropy, found.shear]).all()
    assert (found.fires, found.num_images, found.size) == (False, len(found.images), 0.0)
    assert not found.is_suspected
    still = row_test(problem, 0 * noise(problem))
    assert not still.fires and not still.is_suspected


@pytest.mark.parametrize("share", [0.99, 1.01])
def test_the_limit_of_suspicion_is_exact_with_few_images(share):
    problem = scene(num_images=3)
    slopes = planted(problem, draw(problem, [0.0, 1.0, 1.0]))

    def tested(size):
        return row_test(problem, noise(problem) + size * slopes)

    def excess(size):
        found = tested(size)
        return 2 * (found.anisotropy + found.shear) - share * chi2.isf(1e-4, 4)

    assert tested(brentq(excess, 0.0, 10.0)).is_suspected == (share > 1)


@pytest.mark.parametrize("share", [0.99, 1.01])
def test_the_exact_test_is_for_significant_shear(share):
    problem = scene(num_images=3)
    slopes = planted(problem, draw(problem, [0.0, 0.0, 1.0], seed=2))

    def tested(size):
        return row_test(problem, noise(problem) + size * slopes)

    found = tested(brentq(lambda size: 2 * tested(size).shear - share * chi2.isf(1e-4, 2), 0, 2))
    assert found.shear > module.SMALLEST_RATIO
    assert found.size > module.RELEVANT
    assert np.isfinite(found.confirmation) == (share > 1)


def test_a_ratio_that_lens_errors_reach_does_not_fire(monkeypatch):
    problem = scene(num_images=60, num_points=60)
    r = noise(problem) + planted(problem, draw(problem, 0.4))
    found = row_test(problem, r)
    assert 59 * found.shear > chi2.isf(1e-4, 59)
    assert found.shear < module.SMALLEST_RATIO
    assert found.size > module.RELEVANT
    assert not found.fires
    assert np.isnan(found.confirmation)
    monkeypatch.setattr(module, "SMALLEST_RATIO", 1.0)
    assert row_test(problem, r).confirmation > 0


@pytest.mark.parametrize(
    ("ratio", "freedom", "is_confirmed"),
    [
        (2.01, 3.0, True),  # the quantile of 0.95 is at a ratio of 2.6
        (1.99, 3.0, False),
        (1.99, 1000.0, True),
        (1.074, 1000.0, False),  # chi2_0.95(1000) = 1074.7
        (1.075, 1000.0, True),
        (np.nan, 0.0, False),
    ],
)
def test_motion_is_confirmed_by_twice_its_noise_or_by_the_quantile(ratio, freedom, is_confirmed):
    assert module._is_confirmed(module.ShearScore(ratio, freedom)) == is_confirmed
