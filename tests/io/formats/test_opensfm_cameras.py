"""Cameras of OpenSfM in pixels: portrait and landscape images, by numbers written by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from bundle import InputError
from bundle.io.formats.opensfm import _camera
from bundle.io.formats.opensfm_cameras import SfmCamera, as_model, project

TWO = {"focal_x": 0.9, "focal_y": 0.8, "c_x": 0.01, "c_y": -0.02}
ONE = {"focal": 0.9, "k1": 0.1, "k2": -0.02}


@pytest.mark.parametrize(("width", "height"), [(600, 800), (800, 600), (801, 800), (800, 800)])
def test_the_unit_is_the_longer_side(width, height):
    longer = sorted((width, height))[1]
    camera = SfmCamera("perspective", width, height, ONE)
    assert camera.size == longer
    model, params, _ = as_model(camera, "here")
    assert model == "RADIAL"
    np.testing.assert_allclose(params, [0.9 * longer, width / 2, height / 2, 0.1, -0.02])
    point = np.array([[0.2, -0.3, 2.0]])
    (u, v), r2 = (0.1, -0.15), 0.1**2 + 0.15**2
    factor = 0.9 * (1 + 0.1 * r2 - 0.02 * r2**2)
    np.testing.assert_allclose(project(camera, point), [[factor * u, factor * v]], rtol=1e-14)


@pytest.mark.parametrize(
    ("kind", "more", "model", "lens"),
    [
        ("simple_radial", {"k1": 0.1}, "OPENCV", [0.1, 0, 0, 0]),
        ("radial", {"k1": 0.1, "k2": 0.2}, "OPENCV", [0.1, 0.2, 0, 0]),
        (
            "brown",
            {"k1": 0.1, "k2": 0.2, "p1": 0.3, "p2": 0.4, "k3": 0},
            "OPENCV",
            [0.1, 0.2, 0.3, 0.4],
        ),
        (
            "brown",
            {"k1": 0.1, "k2": 0.2, "p1": 0.3, "p2": 0.4, "k3": 0.5},
            "FULL_OPENCV",
            [0.1, 0.2, 0.3, 0.4, 0.5, 0, 0, 0],
        ),
        (
            "fisheye_opencv",
            {"k1": 0.1, "k2": 0.2, "k3": 0.3, "k4": 0.4},
            "OPENCV_FISHEYE",
            [0.1, 0.2, 0.3, 0.4],
        ),
    ],
)
def test_a_portrait_lens_with_two_focal_lengths(kind, more, model, lens):
    """600 x 800: the centre (300, 400) is moved by 8 and -16 pixels."""
    found = as_model(SfmCamera(kind, 600, 800, TWO | more), "here")
    assert found.model == model
    np.testing.assert_allclose(found.params, [720, 640, 308, 384, *lens])


@pytest.mark.parametrize(
    ("model", "params", "written"),
    [
        ("RADIAL", [720.0, 300, 400, 0.1, -0.02], ONE),
        ("OPENCV", [720.0, 640, 308, 384, 0.1, 0.2, 0.3, 0.4], TWO | {"k1": 0.1, "p2": 0.4}),
        ("OPENCV_FISHEYE", [720.0, 640, 308, 384, 0.1, 0.2, 0.3, 0.4], TWO | {"k4": 0.4}),
    ],
)
def test_portrait_lenses_are_written_with_the_numbers_that_are_read(model, params, written):
    problem = SimpleNamespace(
        camera_models=(model,),
        camera_sizes=np.array([[600, 800]]),
        camera_params=np.array([params]),
    )
    found = _camera(problem, 0)
    assert (found["width"], found["height"]) == (600, 800)
    assert {name: found[name] for name in written} == pytest.approx(written)


def test_a_portrait_fisheye():
    found = as_model(SfmCamera("fisheye", 600, 800, ONE), "here")
    assert found.model == "RADIAL_FISHEYE"
    np.testing.assert_allclose(found.params, [720, 300, 400, 0.1, -0.02])


def test_a_spherical_image_is_twice_as_wide_as_high():
    found = as_model(SfmCamera("spherical", 800, 400, {}), "here")
    assert (found.model, found.params.tolist()) == ("EQUIRECTANGULAR", [800, 400])
    for size in ((400, 800), (800, 401)):
        with pytest.raises(InputError, match="twice as wide"):
            as_model(SfmCamera("spherical", *size, {}), "here")
