"""Names of models and parameters, what a status means, bits, and wrong arguments."""

import numpy as np
import pycolmap
import pytest

import bundle
from tests.formulas import PARAMS
from tests.model.cameras.draws import camera, random_params, random_points

MODELS = sorted(bundle.camera_models())
COLMAP_MODELS = {name for name in pycolmap.CameraModelId.__members__ if name != "INVALID"}


def test_every_model_of_colmap_is_there():
    assert not COLMAP_MODELS - set(MODELS)
    lacking = set(MODELS) - COLMAP_MODELS
    if lacking:
        pytest.skip(f"pycolmap {pycolmap.__version__} lacks {', '.join(sorted(lacking))}")


@pytest.mark.parametrize("model", MODELS)
def test_names_and_kinds_of_parameters_agree_with_pycolmap(model):
    if model not in COLMAP_MODELS:
        pytest.skip(f"pycolmap {pycolmap.__version__} lacks {model}")
    reference = camera(model, PARAMS[model])
    names = bundle.camera_models()[model]
    assert ",".join(names) == reference.params_info.replace(" ", "")
    kinds = bundle.model.cameras.param_kinds(model)
    by_kind = {kind: [i for i, k in enumerate(kinds) if k == kind] for kind in kinds}
    assert by_kind.get("focal", []) == list(reference.focal_length_idxs())
    assert by_kind.get("principal_point", []) == list(reference.principal_point_idxs())
    assert by_kind.get("extra", []) == list(reference.extra_params_idxs())
    if hasattr(reference, "metadata_params_idxs"):
        assert by_kind.get("metadata", []) == list(reference.metadata_params_idxs())


@pytest.mark.parametrize("model", MODELS)
def test_values_are_the_same_to_the_last_bit_with_and_without_jacobians(model):
    rng = np.random.default_rng(4)
    for _ in range(5):
        params, points = random_params(model, rng), random_points(rng)
        xy, valid = bundle.project(model, params, points)
        result = bundle.project(model, params, points, jacobians=True)
        np.testing.assert_array_equal(xy, result.xy)
        np.testing.assert_array_equal(valid, result.valid)
        defined = ~np.isnan(xy).any(axis=1)
        assert np.isfinite(result.d_point[defined]).all()
        assert np.isfinite(result.d_params[defined]).all()


PERSPECTIVE = [
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "FULL_OPENCV",
    "FOV",
]


@pytest.mark.parametrize("model", PERSPECTIVE)
def test_behind_a_perspective_camera(model):
    points = np.array([[0.1, 0.2, 1.0], [-0.1, -0.2, -1.0], [0.1, 0.2, 0.0], [0.1, 0.2, np.nan]])
    xy, valid = bundle.project(model, PARAMS[model], points)
    assert valid.tolist() == [True, False, False, False]
    # The formula does not tell P from -P, so the algebraic value is that of the mirrored point.
    np.testing.assert_allclose(xy[1], xy[0])
    assert np.isnan(xy[2:]).all()


@pytest.mark.parametrize("model", MODELS)
def test_what_is_not_a_number_has_no_projection(model):
    points = np.array([[np.nan, 0.2, 1.0], [0.1, np.nan, 1.0], [0.1, 0.2, np.nan], [0, 0, 0]])
    xy, valid = bundle.project(model, PARAMS[model], points)
    assert np.isnan(xy).any(axis=1).all()
    assert not valid[2:].any()


@pytest.mark.parametrize("model", MODELS)
def test_what_has_no_projection_has_no_derivatives(model):
    points = np.array([[0.1, 0.2, np.nan], [0.1, 0.2, 1.0]])
    found = bundle.project(model, PARAMS[model], points, jacobians=True)
    for derivatives in (found.d_point, found.d_params):
        assert np.isnan(derivatives[0]).all()
        assert np.isfinite(derivatives[1]).all()


def test_wrong_arguments_are_named():
    with pytest.raises(bundle.InputError, match=r"expected 3 parameters \(f, cx, cy\)"):
        bundle.project("SIMPLE_PINHOLE", [1.0, 2.0], np.zeros((1, 3)))
    with pytest.raises(bundle.InputError, match="found 'NO_MODEL'"):
        bundle.project("NO_MODEL", [1.0], np.zeros((1, 3)))
    with pytest.raises(bundle.InputError, match=r"expected shape \(N, 3\), found \(2, 2\)"):
        bundle.project("PINHOLE", PARAMS["PINHOLE"], np.zeros((2, 2)))
