"""Where formulas break: axis, 90 degrees, folds, poles, vanishing parameters. One test each."""

import numpy as np
import pytest

import bundle
from tests.formulas import PARAMS
from tests.model.cameras.draws import camera
from tests.model.cameras.test_jacobians import TOLERANCE, exact, worst_of

FISHEYE = sorted(name for name in bundle.camera_models() if "FISHEYE" in name)
DIVISION = ["SIMPLE_DIVISION", "DIVISION"]


def project(model, params, *points):
    return bundle.project(model, params, np.array(points, float), jacobians=True)


def check_jacobian(model, params, *points):
    result = project(model, params, *points)
    pairs = []
    for n, point in enumerate(points):
        d_point, d_params = exact(model, params, point)
        pairs += [((result.d_point[n], d_point), (result.d_params[n], d_params))]
    worst, column = worst_of(model, pairs)
    assert worst <= TOLERANCE, column


@pytest.mark.parametrize("model", FISHEYE)
def test_fisheye_on_its_axis_is_a_pinhole(model):
    focal = np.array(PARAMS[model])[[0, 0] if model in FISHEYE_OF_ONE_FOCAL else [0, 1]]
    for depth in (1e-3, 1.0, 1e3):
        result = project(model, PARAMS[model], [0, 0, depth])
        np.testing.assert_allclose(result.xy[0], [400, 300])
        expected = np.diag(focal / depth)
        np.testing.assert_allclose(result.d_point[0, :, :2], expected, rtol=1e-15)
        assert (result.d_point[0, :, 2] == 0).all()


FISHEYE_OF_ONE_FOCAL = ["SIMPLE_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"]


@pytest.mark.parametrize("model", FISHEYE)
def test_fisheye_where_its_branches_meet(model):
    """The series ends at r / Z = 0.1, the ratio at 45 degrees."""
    for slope in (0.1, 1.0):
        below, above = (slope * (1 + sign * 1e-14) for sign in (-1, 1))
        points = [[0.6 * below, 0.8 * below, 1], [0.6 * above, 0.8 * above, 1]]
        result = project(model, PARAMS[model], *points)
        np.testing.assert_allclose(result.xy[0], result.xy[1], rtol=0, atol=1e-10)
        np.testing.assert_allclose(result.d_point[0], result.d_point[1], rtol=1e-11, atol=1e-9)
        check_jacobian(model, PARAMS[model], *points)


@pytest.mark.parametrize("model", FISHEYE)
def test_fisheye_through_90_degrees_without_a_break(model):
    depths = [1e-9, 1e-15, 2.3e-16, 1e-16, 0.0, -1e-16, -1e-9]
    points = [[0.6, -0.8, depth] for depth in depths]
    result = project(model, PARAMS[model], *points)
    assert result.valid.tolist() == [True, True, True, False, False, False, False]
    np.testing.assert_allclose(result.xy, np.tile(result.xy[0], (7, 1)), rtol=0, atol=1e-5)
    np.testing.assert_allclose(result.d_point, np.tile(result.d_point[0], (7, 1, 1)), atol=1e-4)
    check_jacobian(model, PARAMS[model], *points)


@pytest.mark.parametrize("model", FISHEYE)
def test_fisheye_ends_on_the_axis_behind(model):
    result = project(model, PARAMS[model], [0, 0, -1], [1e-9, 0, -1])
    assert np.isnan(result.xy[0]).all()
    assert np.isfinite(result.xy[1]).all()
    assert not result.valid.any()
    angle = np.pi - 1e-9
    simple = project("SIMPLE_FISHEYE", [800, 0, 0], [1e-9, 0, -1])
    np.testing.assert_allclose(simple.xy[0], [800 * angle, 0], rtol=1e-15)


@pytest.mark.parametrize("omega", [0.0, 1e-12, -1e-3, 0.0099999, 0.0100001, 1e-2, np.pi, 3.1415926])
def test_fov_for_any_angle(omega):
    """Pixels are COLMAP's, series and all; at pi the tangent is 1e16."""
    params = [800.0, 790.0, 400.0, 300.0, omega]
    points = [[0.3, -0.2, 1], [2e-3, 1e-3, 1], [0.0099999, 0, 1], [0.0100001, 0, 1], [3, 4, 1]]
    result = project("FOV", params, *points)
    expected = camera("FOV", params).img_from_cam(np.array(points, float))
    # Near pi the tangent magnifies the last bit of omega in COLMAP's series for the axis.
    keep = np.array([0, 3, 4]) if omega > 3 else np.arange(5)
    np.testing.assert_allclose(result.xy[keep], expected[keep], rtol=1e-15, atol=1e-10)
    assert np.isfinite(result.d_point).all()
    if omega != 0.01:  # where a step of the exact derivative leaves the piece
        check_jacobian("FOV", params, *(points[n] for n in keep))


@pytest.mark.parametrize("model", DIVISION)
def test_division_at_its_fold(model):
    """4 k r^2 = Z^2: a value on it, none beyond, derivatives that grow but stay finite."""
    params = np.array(PARAMS[model])
    params[-1] = 0.25
    result = project(model, params, [1, 0, 1], [1.0001, 0, 1], [1 - 1e-13, 0, 1])
    assert result.valid.tolist() == [True, False, True]
    assert np.isnan(result.xy[1]).all()
    np.testing.assert_allclose(result.xy[0], params[-3:-1] + np.array([params[0] * 2, 0]))
    assert np.isfinite(result.d_point[0]).all()
    assert np.isfinite(result.d_params[0]).all()
    assert result.d_point[2, 0, 0] > 1e5 * params[0]
    check_jacobian(model, params, [0.8, 0.5, 1], [0.99, 0.1, 1])


@pytest.mark.parametrize("model", DIVISION)
@pytest.mark.parametrize("k", [0.0, 1e-300, -1e-300, 1e-17, -1e-17, -1e-9])
def test_division_with_next_to_no_distortion(model, k):
    params = np.array(PARAMS[model])
    params[-1] = k
    pinhole = PARAMS[model][:-1]
    front = [[0.3, 0.2, 1], [3, 4, 0.5], [0, 0, 2]]
    result = project(model, params, *front, [0.3, 0.2, -1], [0, 0, -1], [0, 0, 0])
    undistorted = project("SIMPLE_PINHOLE" if len(pinhole) == 3 else "PINHOLE", pinhole, *front)
    np.testing.assert_allclose(result.xy[:3], undistorted.xy, atol=1e-5)
    assert result.valid[:3].all()
    assert not result.valid[4:].any()
    # COLMAP has 2 / 0 behind the camera; the root exists unless k is zero.
    assert result.valid[3] == (k != 0)
    assert np.isnan(result.xy[3]).all() == (k == 0)


@pytest.mark.parametrize("model", DIVISION)
def test_division_beyond_90_degrees(model):
    params = np.array(PARAMS[model])
    points = [[1, 0.5, 1e-9], [1, 0.5, 0], [1, 0.5, -1e-9], [1, 0.5, -2], [1e-3, 0, -1]]
    result = project(model, params, *points)
    assert result.valid.all()
    np.testing.assert_allclose(result.xy[0], result.xy[2], atol=1e-5)
    assert (np.diff(np.abs(result.xy[:, 0])) >= -1e-5).all()
    check_jacobian(model, params, *points)


def test_eucm_at_its_edges():
    params = np.array(PARAMS["EUCM"])
    points = [[1, 0.5, 1e-12], [1, 0, 2.3e-16], [1, 0.5, -1e-12], [0, 0, 1], [1e-9, 1e-10, 1]]
    result = project("EUCM", params, *points)
    assert result.valid.tolist() == [True, True, False, True, True]
    check_jacobian("EUCM", params, *points[:3], points[4])
    np.testing.assert_allclose(result.d_params[3, :, 4:], 0)


@pytest.mark.parametrize(
    ("alpha", "beta", "point"),
    [
        (0.6, -1.0, [2, 0, 1]),  # R^2 < 0
        (0.6, -1.0, [1, 0, 1]),  # R = 0: a value, without a derivative by R
        (3.0, -0.9, [1, 0, 1]),  # m < 0
        (0.5, 1.0, [0, 0, -1]),  # m = 0
        (1.0, 1.0, [0, 0, 1]),
        (0.0, 1.0, [1, 1, 1]),
    ],
)
def test_eucm_is_valid_where_colmap_says(alpha, beta, point):
    params = [800, 790, 400, 300, alpha, beta]
    result = project("EUCM", params, point)
    expected = camera("EUCM", params).img_from_cam(np.array(point, float))
    assert result.valid[0] == (expected is not None)
    if expected is not None:
        np.testing.assert_allclose(result.xy[0], expected, rtol=1e-15)
        assert np.isfinite(result.d_point).all()
        assert np.isfinite(result.d_params).all()


def test_full_opencv_where_its_denominator_vanishes():
    params = np.array(PARAMS["FULL_OPENCV"])
    params[4:] = 0
    params[9] = -1  # 1 - s
    result = project("FULL_OPENCV", params, [1, 0, 1], [1 + 1e-9, 0, 1], [1 - 1e-9, 0, 1])
    assert result.valid.tolist() == [False, True, True]
    assert np.isnan(result.xy[0]).all()
    assert np.isfinite(result.d_point[1:]).all()
    check_jacobian("FULL_OPENCV", params, [0.999, 0.01, 1], [1.01, 0.1, 1])


def test_equirectangular_poles_and_origin():
    params = np.array([2000.0, 1000.0])
    points = [[0, 1, 0], [0, -1, 0], [0, 0, 0], [1e-12, 1, 0], [0, -3, 1e-3]]
    result = project("EQUIRECTANGULAR", params, *points)
    assert result.valid.tolist() == [True, True, False, True, True]
    expected = camera("EQUIRECTANGULAR", params).img_from_cam(np.array(points, float))
    np.testing.assert_allclose(result.xy[result.valid], expected[result.valid], rtol=1e-15)
    assert np.isfinite(result.d_point[result.valid]).all()
    check_jacobian("EQUIRECTANGULAR", params, *points[3:])


def test_equirectangular_derivatives_do_not_see_the_seam():
    points = [[1e-9, 0.2, -1], [-1e-9, 0.2, -1]]
    result = project("EQUIRECTANGULAR", [2000.0, 1000.0], *points)
    np.testing.assert_allclose(result.xy[0, 0], 2000, atol=1e-5)
    np.testing.assert_allclose(result.xy[1, 0], 0, atol=1e-5)
    np.testing.assert_allclose(result.d_point[0], result.d_point[1], rtol=1e-8, atol=1e-5)
