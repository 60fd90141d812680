"""Camera models against pycolmap, OpenCV and complex-step derivatives."""

import cv2
import numpy as np
import pycolmap
import pytest

import bundle
from tests import scenes

MODELS = sorted(bundle.camera_models())


def random_points(rng, count=2000):
    """Points in a wide field of view, at depths over six orders of magnitude."""
    depth = 10 ** rng.uniform(-3, 3, count)
    return np.stack([*(rng.uniform(-1.2, 1.2, (2, count)) * depth), depth], 1)


def random_params(model, rng):
    params = np.array(scenes.PARAMS[model])
    return params * rng.uniform(0.5, 1.5, params.shape)


@pytest.mark.parametrize("model", MODELS)
def test_pixels_agree_with_pycolmap(model):
    rng = np.random.default_rng(1)
    for _ in range(20):
        params = random_params(model, rng)
        points = random_points(rng)
        xy, valid = bundle.project(model, params, points)
        camera = pycolmap.Camera(model=model, width=800, height=600, params=params)
        assert valid.all()
        np.testing.assert_allclose(xy, camera.img_from_cam(points), rtol=0, atol=1e-10)


@pytest.mark.parametrize("model", MODELS)
def test_names_and_number_of_parameters_agree_with_pycolmap(model):
    camera = pycolmap.Camera(model=model, width=8, height=6, params=scenes.PARAMS[model])
    names = bundle.camera_models()[model]
    assert ", ".join(names) == camera.params_info
    kinds = bundle.cameras.param_kinds(model)
    by_kind = {kind: [i for i, k in enumerate(kinds) if k == kind] for kind in kinds}
    assert by_kind["focal"] == list(camera.focal_length_idxs())
    assert by_kind["principal_point"] == list(camera.principal_point_idxs())
    assert by_kind.get("extra", []) == list(camera.extra_params_idxs())


@pytest.mark.parametrize("model", MODELS)
def test_pixels_agree_with_opencv(model):
    rng = np.random.default_rng(2)
    params = random_params(model, rng)
    points = random_points(rng)
    focal = params[:2] if model in ("PINHOLE", "OPENCV") else params[[0, 0]]
    center = params[2:4] if model in ("PINHOLE", "OPENCV") else params[1:3]
    extra = np.zeros(4)
    distortion = params[4:] if model == "OPENCV" else params[3:]
    if model not in ("PINHOLE", "SIMPLE_PINHOLE"):
        extra[: len(distortion)] = distortion
    matrix = np.array([[focal[0], 0, center[0]], [0, focal[1], center[1]], [0, 0, 1]])
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, extra)
    xy, _ = bundle.project(model, params, points)
    np.testing.assert_allclose(xy, expected[:, 0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("model", MODELS)
def test_jacobians_agree_with_complex_step(model):
    rng = np.random.default_rng(3)
    step = 1e-30
    for _ in range(5):
        params = random_params(model, rng)
        points = random_points(rng, 500)
        result = bundle.project(model, params, points, jacobians=True)
        for j in range(3):
            moved = points.astype(complex)
            moved[:, j] += 1j * step
            expected = scenes.project(model, params, moved).imag / step
            scale = np.abs(result.d_point).max(axis=(1, 2))[:, None]
            assert (np.abs(result.d_point[:, :, j] - expected) <= 1e-12 * scale).all()
        for j in range(len(params)):
            moved = params.astype(complex)
            moved[j] += 1j * step
            expected = scenes.project(model, moved, points).imag / step
            np.testing.assert_allclose(result.d_params[:, :, j], expected, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("model", MODELS)
def test_values_are_the_same_to_the_last_bit_with_and_without_jacobians(model):
    rng = np.random.default_rng(4)
    params, points = random_params(model, rng), random_points(rng)
    xy, valid = bundle.project(model, params, points)
    result = bundle.project(model, params, points, jacobians=True)
    assert (xy == result.xy).all()
    assert (valid == result.valid).all()


@pytest.mark.parametrize("model", MODELS)
def test_behind_the_camera(model):
    points = np.array([[0.1, 0.2, 1.0], [-0.1, -0.2, -1.0], [0.1, 0.2, 0.0], [0.1, 0.2, np.nan]])
    xy, valid = bundle.project(model, scenes.PARAMS[model], points)
    assert valid.tolist() == [True, False, False, False]
    # The formula does not tell P from -P, so the algebraic value is that of the mirrored point.
    np.testing.assert_allclose(xy[1], xy[0])
    assert np.isnan(xy[2:]).all()


def test_wrong_arguments_are_named():
    with pytest.raises(bundle.InputError, match=r"expected 3 parameters \(f, cx, cy\)"):
        bundle.project("SIMPLE_PINHOLE", [1.0, 2.0], np.zeros((1, 3)))
    with pytest.raises(bundle.InputError, match="found 'NO_MODEL'"):
        bundle.project("NO_MODEL", [1.0], np.zeros((1, 3)))
    with pytest.raises(bundle.InputError, match=r"expected shape \(N, 3\), found \(2, 2\)"):
        bundle.project("PINHOLE", scenes.PARAMS["PINHOLE"], np.zeros((2, 2)))
