"""Conjugate gradients without the reduced camera system: the same steps as with it."""

from __future__ import annotations

import numpy as np
import pytest

import bundle
from tests.rig_scenes import rig_problem


def solved(problem, schur_complement, **options):
    return bundle.solve(
        problem,
        **{
            "backend": "fused",
            "linear_solver_type": "iterative_schur",
            "preconditioner_type": "schur_jacobi",
            "schur_complement": schur_complement,
            "max_num_iterations": 6,
            **options,
        },
    )


# From a far start, some steps take so many products that rounding decides on five digits.
NEAR_START = {"rotation_noise": 0.05, "translation_noise": 0.002, "point_noise": 0.002}


def orbit(**options):
    return bundle.synthesize(
        **{
            "scene": "orbit",
            "num_images": 24,
            "num_points": 300,
            "mean_track_length": 5.0,
            "seed": 2,
            **NEAR_START,
            **options,
        }
    ).problem


CASES = {
    "one camera per image": (orbit(cameras="individual", camera_model="RADIAL"), {}),
    "one shared camera": (orbit(cameras="shared", camera_model="OPENCV"), {}),
    "held points": (orbit(), {"fixed_point_ids": list(range(1, 300, 7))}),
    "held images": (orbit(), {"fixed_image_ids": [1, 2, 3]}),
    "poses only": (orbit(), {"refine": ["poses", "points"]}),
    "a loss": (orbit(outlier_share=0.05), {"loss": "cauchy", "loss_scale": 2.0}),
    "a gauge": (orbit(), {"gauge": "two_cameras"}),
    "one focal length of two": (
        orbit(camera_model="OPENCV"),
        {"constraints": ["cameras *: fx/fy fixed"]},
    ),
    "all threads": (orbit(), {"num_threads": 3}),
}


def expect_equal_steps(problem, **options):
    """Conjugate gradients amplify the rounding of products, so later steps have fewer digits."""
    without, with_system = (
        solved(problem, how, **options).iterations for how in ("implicit", "explicit")
    )
    counts = [trace["linear_solver_iterations"][:4] for trace in (without, with_system)]
    np.testing.assert_array_equal(*counts)
    np.testing.assert_allclose(without["cost"][:3], with_system["cost"][:3], rtol=1e-9)
    np.testing.assert_allclose(without["cost"], with_system["cost"], rtol=1e-3)


@pytest.mark.parametrize("case", CASES)
def test_the_steps_are_those_with_the_system(case):
    problem, options = CASES[case]
    expect_equal_steps(problem, **options)


@pytest.mark.parametrize("refines_sensors", [False, True])
def test_the_steps_of_rigs(refines_sensors):
    expect_equal_steps(rig_problem(), refine_sensor_from_rig=refines_sensors)


def test_camera_models_of_different_widths():
    problem = orbit(cameras="individual", camera_model="RADIAL")
    models = list(problem.camera_models)
    models[::3] = ["SIMPLE_PINHOLE"] * len(models[::3])
    expect_equal_steps(problem.replace(camera_models=tuple(models)))


def test_observations_whose_records_are_too_many_to_keep():
    """192 bytes each: 35 MB, above the 32 MB that the elimination keeps."""
    problem = orbit(
        num_images=60,
        num_points=15_300,
        mean_track_length=12.0,
        cameras="individual",
        camera_model="RADIAL",
    )
    assert 192 * problem.num_observations > 2**25
    expect_equal_steps(problem, max_num_iterations=3)


def test_sigmas_of_observations():
    problem = orbit()
    sigma = np.random.default_rng(0).uniform(0.5, 2.0, problem.num_observations)
    expect_equal_steps(problem.replace(observation_sigma=sigma))


@pytest.mark.parametrize("preconditioner", ["identity", "jacobi", "schur_jacobi"])
def test_each_local_preconditioner(preconditioner):
    expect_equal_steps(orbit(), preconditioner_type=preconditioner)


@pytest.mark.parametrize("num_threads", [2, 5])
def test_bits_do_not_depend_on_threads(num_threads):
    problem = orbit(num_points=3000)
    one, many = (solved(problem, "implicit", num_threads=n) for n in (1, num_threads))
    np.testing.assert_array_equal(one.iterations["cost"], many.iterations["cost"])
    np.testing.assert_array_equal(one.problem.points, many.problem.points)


def test_a_reused_solver_has_the_bits_of_a_new_one():
    problem = orbit()
    options = {"backend": "fused", "linear_solver_type": "iterative_schur"}
    solver = bundle.Solver(problem, schur_complement="implicit", **options)
    solver.solve(problem)
    again = solver.solve(problem)
    new = bundle.solve(problem, schur_complement="implicit", **options)
    np.testing.assert_array_equal(again.problem.points, new.problem.points)


def test_auto_leaves_out_the_system_where_tracks_are_long():
    """A step with the system takes seconds here: each point is in a third of 900 images."""
    long_tracks = orbit(num_images=900, num_points=60, mean_track_length=180.0)
    result = bundle.solve(long_tracks, backend="fused", max_num_iterations=2)
    assert result.summary.linear_solver_type_used == "ITERATIVE_SCHUR"
    assert result.summary.preconditioner_type_used == "SCHUR_JACOBI"
    found = bundle.inspect(long_tracks)
    assert found.auto_choice == "ITERATIVE_SCHUR"
    of = {m.preconditioner: m for m in found.methods if m.backend == "FUSED"}
    without, formed = of["SCHUR_JACOBI"], of["TWO_LEVEL"]
    assert without.nnz_reduced == 0 < formed.nnz_reduced and "does not form S" in without.note
    blocks = {"reduced system", "buffers of chunks"}
    for name in blocks:
        assert without.memory_terms[name] < 0.1 * formed.memory_terms[name]
    forced = bundle.solve(
        long_tracks, backend="fused", schur_complement="explicit", max_num_iterations=0
    )
    assert forced.summary.preconditioner_type_used != "SCHUR_JACOBI"


def test_auto_keeps_the_system_where_tracks_are_short():
    result = solved(orbit(), "auto", preconditioner_type="auto")
    assert result.summary.preconditioner_type_used == "TWO_LEVEL"


@pytest.mark.parametrize("preconditioner", ["two_level", "schur_power_series_expansion"])
def test_preconditioners_that_need_the_system_are_refused(preconditioner):
    with pytest.raises(bundle.InputError, match=f"schur_complement.*{preconditioner}"):
        solved(orbit(), "implicit", preconditioner_type=preconditioner)


def test_ceres_forms_the_system_with_schur_jacobi_only():
    options = {"backend": "ceres", "max_num_iterations": 3}
    costs = [solved(orbit(), how, **options).iterations["cost"] for how in ("implicit", "explicit")]
    np.testing.assert_allclose(*costs, rtol=1e-7)
    with pytest.raises(bundle.InputError, match="schur_complement"):
        solved(orbit(), "explicit", preconditioner_type="jacobi", **options)
