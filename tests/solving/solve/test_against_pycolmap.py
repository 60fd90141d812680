"""The same models through pycolmap's bundle adjuster: same gauge, same parameters, same stop."""

import functools

import pycolmap
import pytest

import bundle

MODELS = [
    "bartoszek",
    "batmo_rigs",
    "crane_mast",
    "lund_door",
    "maupertuis",
    "video48",
    "vr_opencv",
]
# Both stop by the relative change of the cost alone.
FUNCTION_TOLERANCE = 1e-10
MAX_ITERATIONS = 300


def adjust(reconstruction, function_tolerance, max_iterations):
    """Ceres' summary of pycolmap's bundle adjustment with points eliminated densely."""
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.refine_principal_point = False
    options.ceres.auto_select_solver_type = False
    solver = options.ceres.solver_options
    solver.linear_solver_type = type(solver.linear_solver_type).DENSE_SCHUR
    solver.function_tolerance = function_tolerance
    solver.gradient_tolerance = 0
    solver.parameter_tolerance = 0
    solver.max_num_iterations = max_iterations
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in reconstruction.reg_image_ids():
        config.add_image(image_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, config, reconstruction)
    return adjuster.solve().ceres_summary


@functools.cache
def expected_of(path):
    return adjust(pycolmap.Reconstruction(path), FUNCTION_TOLERANCE, MAX_ITERATIONS)


@pytest.mark.parametrize(
    ("backend", "name"),
    [*(("fused", name) for name in MODELS), ("ceres", "batmo_rigs"), ("ceres", "maupertuis")],
)
def test_same_start_and_no_worse_end(backend, bundle_data, name):
    path = bundle_data / "colmap" / name
    expected = expected_of(path)
    result = bundle.solve(
        bundle.load(path),
        backend=backend,
        linear_solver_type="dense_schur",
        gauge="two_cameras",
        cheirality="zero",
        function_tolerance=FUNCTION_TOLERANCE,
        gradient_tolerance=0,
        parameter_tolerance=0,
        max_num_iterations=MAX_ITERATIONS,
    )
    assert result.summary.initial_cost == pytest.approx(expected.initial_cost, rel=1e-9)
    assert result.summary.final_cost <= expected.final_cost * (1 + 1e-6)
    assert result.summary.termination_type == "CONVERGENCE"
    assert result.reprojection_error_after.rmse < result.reprojection_error_before.rmse * (1 + 1e-9)
