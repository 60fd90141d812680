"""A solve with each camera model against pycolmap's: same start, gauge, parameters and stop."""

import functools

import numpy as np
import pycolmap
import pytest

import bundle
from tests.formulas import PARAMS
from tests.model.cameras.draws import colmap_lacks
from tests.solving.solve.test_against_pycolmap import adjust

MODELS = sorted(bundle.camera_models())
FUNCTION_TOLERANCE = 1e-13
MAX_ITERATIONS = 500


def reconstruction_of(model):
    """Ten frames of two cameras around a cloud, with noise everywhere and off in focal length."""
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_frames_per_rig, options.num_points3D = 2, 6, 120
    options.num_points2D_without_point3D = 0
    options.camera_width, options.camera_height = 800, 600
    options.camera_model_id = getattr(pycolmap.CameraModelId, model)
    options.camera_params = PARAMS[model]
    if model == "EQUIRECTANGULAR":
        options.camera_width, options.camera_height = 2000, 1000
    pycolmap.set_random_seed(1)
    reconstruction = pycolmap.synthesize_dataset(options)
    rng = np.random.default_rng(2)
    for _, image in sorted(reconstruction.images.items()):
        for point in image.points2D:
            point.xy = point.xy + rng.normal(0, 0.5, 2)
    for _, point in sorted(reconstruction.points3D.items()):
        point.xyz = point.xyz + rng.normal(0, 0.01, 3)
    for _, camera in sorted(reconstruction.cameras.items()):
        for i in camera.focal_length_idxs():
            camera.params[i] *= 1.01
    return reconstruction


@functools.cache
def problem_and_expected(model):
    reconstruction = reconstruction_of(model)
    problem = bundle.Problem.from_pycolmap(reconstruction)
    return problem, adjust(reconstruction, FUNCTION_TOLERANCE, MAX_ITERATIONS)


@pytest.mark.parametrize("model", MODELS)
def test_same_start_and_same_end_as_pycolmap(solve, model, record_property):
    if colmap_lacks(model):
        pytest.skip(f"pycolmap {pycolmap.__version__} lacks {model}")
    problem, expected = problem_and_expected(model)
    result = solve(
        problem,
        linear_solver_type="dense_schur",
        gauge="two_cameras",
        cheirality="zero",
        refine="poses,points,focal,extra",
        function_tolerance=FUNCTION_TOLERANCE,
        gradient_tolerance=0,
        parameter_tolerance=0,
        max_num_iterations=MAX_ITERATIONS,
    )
    difference = result.summary.final_cost / expected.final_cost - 1
    record_property("relative_difference_of_final_cost", float(difference))
    print(f"{model}: {difference:+.1e} of {expected.final_cost:.6g}")
    assert result.summary.initial_cost == pytest.approx(expected.initial_cost, rel=1e-9)
    assert result.summary.final_cost < 0.5 * result.summary.initial_cost
    assert abs(difference) <= 1e-6
