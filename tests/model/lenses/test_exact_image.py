"""A model that can be another lens is it, pixel for pixel, by formulas of the tests' own."""

import itertools

import numpy as np
import pytest

from bundle.model.lenses.exact_image import exact_params
from tests.formulas import PARAMS
from tests.model.cameras.draws import random_params
from tests.scenes import project

LENSES = [model for model in PARAMS if model != "EQUIRECTANGULAR"]
LARGER = {
    "SIMPLE_PINHOLE": {
        *("PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV"),
        *("SIMPLE_DIVISION", "DIVISION", "EUCM"),
    },
    "PINHOLE": {"OPENCV", "FULL_OPENCV", "DIVISION", "EUCM"},
    "SIMPLE_RADIAL": {"RADIAL", "OPENCV", "FULL_OPENCV"},
    "RADIAL": {"OPENCV", "FULL_OPENCV"},
    "OPENCV": {"FULL_OPENCV"},
    "SIMPLE_DIVISION": {"DIVISION"},
    "SIMPLE_FISHEYE": {
        *("FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "OPENCV_FISHEYE"),
        *("THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE"),
    },
    "FISHEYE": {"OPENCV_FISHEYE", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE"},
    "SIMPLE_RADIAL_FISHEYE": {
        *("RADIAL_FISHEYE", "OPENCV_FISHEYE", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE"),
    },
    "RADIAL_FISHEYE": {"OPENCV_FISHEYE", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE"},
    "OPENCV_FISHEYE": {"THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE"},
}


def rays():
    rng = np.random.default_rng(3)
    return np.column_stack([rng.uniform(-0.8, 0.8, (200, 2)), np.ones(200)])


def assert_same_pixels(model, params, target, found):
    assert len(found) == len(PARAMS[target])
    np.testing.assert_allclose(
        project(target, found, rays()), project(model, params, rays()), rtol=0, atol=1e-9
    )


def test_exactly_these_pairs_are_exact():
    rng = np.random.default_rng(1)
    for model, target in itertools.permutations(LENSES, 2):
        params = random_params(model, rng)
        found = exact_params(model, params, target)
        assert (found is not None) == (target in LARGER.get(model, ())), (model, target)
        if found is not None:
            assert_same_pixels(model, params, target, found)


def test_a_larger_model_becomes_a_smaller_one_that_it_is():
    rng = np.random.default_rng(2)
    for model, targets in LARGER.items():
        params = random_params(model, rng)
        for target in targets:
            there = exact_params(model, params, target)
            back = exact_params(target, there, model)
            np.testing.assert_array_equal(back, params)
            beyond = there.copy()
            only_fy = target in ("PINHOLE", "FISHEYE") or model == "SIMPLE_DIVISION"
            beyond[1 if only_fy else -2 if target == "EUCM" else -1] += 0.01
            assert exact_params(target, beyond, model) is None, (target, model)


@pytest.mark.parametrize(
    ("model", "params"),
    [
        ("THIN_PRISM_FISHEYE", [800, 790, 400, 300, 0, 0, 0.01, -0.02, 0, 0, 0.003, -0.004]),
        ("RAD_TAN_THIN_PRISM_FISHEYE", [800, 790, 400, 300, *[0] * 6, 0.01, -0.02, 0.1, 0, 0.2, 0]),
    ],
)
def test_terms_about_the_radial_polynomial_are_the_same_without_one(model, params):
    (target,) = {"THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE"} - {model}
    params = np.array(params, float)
    assert_same_pixels(model, params, target, exact_params(model, params, target))
    params[4] = 0.1
    assert exact_params(model, params, target) is None


def test_a_pinhole_does_not_become_a_fov_that_no_solve_could_leave():
    assert exact_params("PINHOLE", np.array(PARAMS["PINHOLE"]), "FOV") is None
    found = exact_params("FOV", np.array([800.0, 790, 400, 300, 0]), "PINHOLE")
    np.testing.assert_array_equal(found, [800, 790, 400, 300])
