"""The compared methods, and their command lines."""

import argparse

import pytest

from bundle import _core
from bundle.cli.option_flags import add_fields, options_given
from bundle.errors import InputError
from bundle.interface.options import SolveOptions
from bundle.planning.comparison.measured_run import expand
from bundle.planning.comparison.recommendation import command_line

CORES = _core.hardware_threads()


def test_defaults_are_the_schur_solvers_of_both_backends():
    names = [method.name for method in expand()]
    regions = {"ITERATIVE": [""], "DENSE": ["", " dogleg", " subspace-dogleg"]}
    assert names == [
        f"{backend} {solver}_SCHUR{region}"
        for backend in ("fused", "ceres")
        for solver in ("DENSE", "SPARSE", "ITERATIVE")
        for region in regions.get(solver, regions["DENSE"])
    ]
    assert {method.num_threads for method in expand()} == {CORES}


def test_every_combination_once():
    methods = expand(
        solvers=["DENSE-SCHUR", "iterative_schur"],
        preconditioners=["jacobi", "schur-jacobi"],
        orderings=["points-first", "automatic"],
        backends=["ceres"],
        trust_regions=["levenberg-marquardt"],
        threads=[1, 0, CORES, 10_000],
    )
    counts = {1, CORES}
    assert len(methods) == len(set(methods)) == len(counts) * 2 * (1 + 2)
    assert {method.num_threads for method in methods} == counts
    direct = [method for method in methods if not method.is_iterative]
    assert {method.preconditioner_type for method in direct} == {"auto"}
    assert "ceres ITERATIVE_SCHUR JACOBI automatic" in {method.name for method in methods}


def test_doglegs_of_iterative_solvers_run_only_when_nothing_else_is_asked():
    asked = {"backends": ["fused"], "solvers": ["iterative_schur"]}
    assert [method.name for method in expand(**asked)] == ["fused ITERATIVE_SCHUR"]
    (only,) = expand(**asked, trust_regions=["dogleg"])  # a row that says why it is refused
    assert only.name == "fused ITERATIVE_SCHUR dogleg"


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"solvers": ["qr"]}, "linear_solver_type: expected one of auto, dense_schur"),
        ({"backends": []}, "backend: expected at least one value to compare, found 0"),
        ({"threads": [-1]}, "num_threads: expected at least 0, found -1"),
    ],
)
def test_what_does_not_exist_is_refused(asked, words):
    with pytest.raises(InputError, match=words):
        expand(**asked)


def test_command_line_brings_the_options_back():
    options = SolveOptions(
        backend="fused",
        linear_solver_type="iterative_schur",
        preconditioner_type="schur_power_series_expansion",
        loss="soft_l1",
        loss_scale=1 / 3,
        num_threads=2,
        deterministic=True,
        refine=("poses", "principal_point"),
        fixed_image_ids=(3, 1, 7),
    )
    line = command_line(options, "a scene.txt", "out")
    begin, words = line.split(" -o out ")
    assert begin == "bundle refine 'a scene.txt'"
    parser = argparse.ArgumentParser()
    add_fields(parser, SolveOptions)
    assert options_given(parser.parse_args(words.split()), SolveOptions) == options
