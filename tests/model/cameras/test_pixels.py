"""Pixels and validity against pycolmap, OpenCV and formulas, over the whole field of view."""

import cv2
import mpmath
import numpy as np
import pycolmap
import pytest

import bundle
from tests import formulas, scenes
from tests.model.cameras.draws import camera, colmap_lacks, random_params, random_points, rounding

MODELS = sorted(bundle.camera_models())
TOLERANCE = 1e-10  # pixels


@pytest.mark.parametrize("model", MODELS)
def test_pixels_and_validity_agree_with_pycolmap(model, record_property):
    """To 1e-10 px, or to 8 units in the last place of the input where these are worth more."""
    if colmap_lacks(model):
        pytest.skip(f"pycolmap {pycolmap.__version__} lacks {model}")
    rng = np.random.default_rng(1)
    worst, strict, total = 0.0, 0, 0
    for _ in range(20):
        params, points = random_params(model, rng), random_points(rng)
        result = bundle.project(model, params, points, jacobians=True)
        expected = camera(model, params).img_from_cam(points)
        np.testing.assert_array_equal(result.valid, np.isfinite(expected).all(axis=1))
        seen = result.valid
        bound = 8 * rounding(result, params, points) + colmap_cancellation(model, params, points)
        error = np.abs(result.xy - expected)
        assert (error[seen] <= np.maximum(TOLERANCE, bound[seen])).all()
        sharp = seen & (bound < TOLERANCE).all(axis=1)
        worst = max(worst, error[sharp].max())
        strict, total = strict + sharp.sum(), total + seen.sum()
    record_property("worst_difference_px", float(worst))
    print(f"{model}: {worst:.1e} px over {strict} of {total} points; looser for the others")
    assert worst <= TOLERANCE
    assert strict > 0.6 * total


def colmap_cancellation(model, params, points):
    """Digits that COLMAP's Z + sqrt(Z^2 - 4 k r^2) loses behind a division model, in pixels."""
    if "DIVISION" not in model:
        return np.zeros((len(points), 2))
    z, square = points[:, 2], (points[:, :2] ** 2).sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(z * z - 4 * params[-1] * square)
        lost = 4 * np.finfo(float).eps * (np.abs(z) + root) / np.abs(z + root)
        xy, _ = bundle.project(model, params, points)
    return np.where(z < 0, lost, 0)[:, None] * np.abs(xy - params[-3:-1])


@pytest.mark.parametrize("model", [name for name in MODELS if "DIVISION" in name])
def test_division_models_behind_the_camera_lose_no_digits(model):
    """Where COLMAP's own form cancels, against 50 digits."""
    rng = np.random.default_rng(5)
    for _ in range(100):
        params = random_params(model, rng)
        params[-1] = rng.choice([-1, 1]) * 10 ** rng.uniform(-9, -1)
        point = np.array([*rng.uniform(-1, 1, 2), -rng.uniform(0.9, 3)])
        result = bundle.project(model, params, point[None], jacobians=True)
        with mpmath.workdps(50):
            exact = formulas.project(
                model, [*map(mpmath.mpf, params)], *map(mpmath.mpf, point), formulas.MPMATH
            )
        if not result.valid[0]:
            assert isinstance(exact[0], mpmath.mpc)
            continue
        bound = 8 * rounding(result, params, point[None])[0]
        assert (np.abs(result.xy[0] - [float(x) for x in exact]) <= bound).all()


@pytest.mark.parametrize("model", MODELS)
def test_pixels_agree_with_formulas_where_the_lens_cannot_see(model):
    """Beyond 90 degrees and behind the camera, as far as the formula goes."""
    rng = np.random.default_rng(7)
    for _ in range(5):
        params, points = random_params(model, rng), random_points(rng)
        result = bundle.project(model, params, points, jacobians=True)
        hidden = ~result.valid & ~np.isnan(result.xy).any(axis=1)
        expected = scenes.project(model, params, points)
        bound = np.maximum(1e-9, 32 * rounding(result, params, points))
        assert (np.abs(result.xy - expected)[hidden] <= bound[hidden]).all()
        if "FISHEYE" in model:  # everything but the axis behind the camera
            assert (hidden == (points[:, 2] < 0)).all()


def opencv_pixels(model, params, points):
    """OpenCV's model of this lens, or None."""
    single = model.startswith("SIMPLE") or model in ("RADIAL", "RADIAL_FISHEYE")
    focal, rest = (params[[0, 0]], params[1:]) if single else (params[:2], params[2:])
    matrix = np.array([[focal[0], 0, rest[0]], [0, focal[1], rest[1]], [0, 0, 1]])
    coefficients = np.zeros(4)
    if model in ("OPENCV", "FULL_OPENCV"):
        coefficients = rest[2:]
    elif model in ("SIMPLE_RADIAL", "RADIAL") or "FISHEYE" in model:
        coefficients[: len(rest) - 2] = rest[2:]
    if "FISHEYE" in model:
        given = points[:, None], np.zeros(3), np.zeros(3), matrix, coefficients
        return cv2.fisheye.projectPoints(*given)[0][:, 0]
    return cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, coefficients)[0][:, 0]


SHARED_WITH_OPENCV = [
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "FULL_OPENCV",
    "SIMPLE_FISHEYE",
    "FISHEYE",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "OPENCV_FISHEYE",
]


@pytest.mark.parametrize("model", [name for name in SHARED_WITH_OPENCV if name in MODELS])
def test_pixels_agree_with_opencv(model):
    rng = np.random.default_rng(2)
    params = random_params(model, rng)
    points = random_points(rng)
    # cv2.fisheye takes |theta| < 1e-8 for the axis itself, an error of up to 1e-8 f.
    slope = np.hypot(points[:, 0], points[:, 1]) / points[:, 2]
    points = points[(points[:, 2] > 0) & (slope < 2) & (slope > 1e-7)]
    assert len(points) > 600
    xy, _ = bundle.project(model, params, points)
    np.testing.assert_allclose(xy, opencv_pixels(model, params, points), rtol=0, atol=1e-9)
