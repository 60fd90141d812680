"""Options: canonical forms, ranges, and agreement of the Python and the C++ definition."""

import dataclasses

import pytest

from bundle import InputError, SolveOptions, _core
from tests import scenes

# What only Python knows: "auto" of the gauge is resolved by the problem's format.
PYTHON_ONLY = {"gauge": "auto", "twist_sigma": ()}


def test_defaults_are_the_same_in_cpp():
    python = {k: v for k, v in SolveOptions().asdict().items() if k not in PYTHON_ONLY}
    cpp = _core.default_options()
    assert {"gauge"} | set(python) == set(cpp)
    for name, value in python.items():
        assert cpp[name] == (list(value) if isinstance(value, tuple) else value), name


def test_choices_are_the_same_in_cpp():
    choices = {
        field.name: [c for c in field.metadata["choices"] if (field.name, c) != ("gauge", "auto")]
        for field in dataclasses.fields(SolveOptions)
        if field.metadata["choices"]
    }
    assert choices == _core.option_choices()


def test_choices_are_taken_in_any_case_with_hyphens():
    options = SolveOptions(linear_solver_type="Sparse-Schur", loss="SOFT_L1")
    assert (options.linear_solver_type, options.loss) == ("sparse_schur", "soft_l1")
    assert options.replace(gauge="three-points").gauge == "three_points"


def test_refine_is_a_set_in_one_order():
    assert SolveOptions(refine="points, poses,points").refine == ("poses", "points")
    assert SolveOptions(refine=["principal-point"]).refine == ("principal_point",)
    assert SolveOptions(refine=()).refine == ()


def test_ids_are_sorted_and_unique():
    assert SolveOptions(fixed_point_ids=[3, 1, 3]).fixed_point_ids == (1, 3)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("linear_solver_type", "qr", "expected one of auto, dense_schur, .*, found 'qr'"),
        ("refine", "poses,planes", "refine: expected one of .*, found 'planes'"),
        ("loss_scale", 0, "loss_scale: expected more than 0, found 0"),
        ("loss_scale", float("nan"), "loss_scale: expected a finite number, found nan"),
        ("loss_scale", "wide", "loss_scale: expected a finite number, found 'wide'"),
        ("initial_trust_region_radius", 0, "initial_trust_region_radius: expected more than 0"),
        ("initial_trust_region_radius", 2e16, "initial_trust_region_radius: expected at most 1e"),
        ("max_num_iterations", -1, "max_num_iterations: expected at least 0, found -1"),
        ("max_num_iterations", 2.5, "max_num_iterations: expected a whole number, found 2.5"),
        ("max_num_iterations", 2**31, "max_num_iterations: expected at most 2147483647"),
        ("function_tolerance", -1e-9, "function_tolerance: expected at least 0"),
        ("num_threads", -1, "num_threads: expected at least 0, found -1"),
        ("fixed_image_ids", ["a"], "fixed_image_ids: expected whole numbers, found"),
        ("fixed_image_ids", [2**63], "fixed_image_ids: expected ids below 2\\^63, found"),
        ("fixed_point_ids", [-(2**63) - 1], "fixed_point_ids: expected ids below 2\\^63, found"),
    ],
)
def test_values_out_of_range_are_named(name, value, message):
    with pytest.raises(InputError, match=message):
        SolveOptions(**{name: value})


@pytest.mark.parametrize(("asked", "used"), [(1, 1), (0, None), (2**31 - 1, None)])
def test_threads_are_at_most_the_cores(solve, asked, used):
    """Ceres keeps a gradient for each thread: a slip in the number must not fill the memory."""
    result = solve(scenes.make_problem(), num_threads=asked)
    assert result.options.num_threads == (used or _core.hardware_threads())
    assert result.summary.num_threads_used == result.options.num_threads
