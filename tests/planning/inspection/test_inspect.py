"""`bundle.inspect`: every method with its counts and predictions, and one recommendation."""

from __future__ import annotations

import dataclasses
import json
import platform
import subprocess
import sys
from functools import partial

import pytest

import bundle
from bundle import _core
from bundle.planning.inspection import inspection_result
from bundle.planning.inspection.peak_memory import total
from bundle.planning.inspection.problem_time import make_scene
from tests.planning.inspection.dense_oracle import drive
from tests.printed import in_order
from tests.scenes import make_problem

ORDERINGS = ("natural", "amd", "colamd", "metis", "nesdis", "minimum_fill")


@pytest.fixture
def inspect():
    """bundle.inspect, all blocks whole."""
    return partial(bundle.inspect, gauge="none")


@pytest.fixture
def street():
    return drive(40, 400, 5)


def by_key(inspection):
    found = {(m.name, m.backend): m for m in inspection.methods}
    assert len(found) == len(inspection.methods)
    return found


def test_every_way_to_solve_is_there(inspect, street):
    found = by_key(inspect(street))
    for key in (
        ("DENSE_SCHUR natural", "FUSED"),
        ("DENSE_SCHUR natural", "CERES"),
        ("SPARSE_SCHUR amd", "FUSED"),
        ("SPARSE_SCHUR amd", "CERES"),
        ("SPARSE_SCHUR cameras_first", "CERES"),
        ("SPARSE_NORMAL_CHOLESKY amd", "CERES"),
        ("ITERATIVE_SCHUR schur_jacobi", "FUSED"),
        ("ITERATIVE_SCHUR cluster_tridiagonal", "CERES"),
    ):
        assert key in found
    assert {name.split()[1] for name, _ in found if name.startswith("SPARSE_SCHUR")} >= {*ORDERINGS}
    assert ("ITERATIVE_SCHUR cluster_jacobi", "FUSED") not in found


def test_numbers_of_a_method(inspect, street):
    inspection = inspect(street)
    assert (inspection.num_observations, inspection.num_free_points) == (2000, 400)
    assert (inspection.num_camera_columns, inspection.num_camera_blocks) == (360, 40)
    for method in inspection.methods:
        assert method.num_unknowns == 1560
        assert method.nnz_jacobian == 2000 * 2 * 12
        assert method.memory_in_bytes == total(method.memory_terms)
        assert method.time_per_step_in_seconds == total(method.time_terms) > 0
        assert all(value >= 0 for value in method.memory_terms.values())
        assert (method.nnz_factor == 0) == bool(method.preconditioner)
        if method.nnz_factor:
            assert max(method.column_count_profile) < method.num_unknowns
            assert method.cholmod_flops < method.flops
    found = by_key(inspection)
    sparse = found["SPARSE_SCHUR amd", "FUSED"]
    # Blocks up to four apart meet: 40 + 39 + 38 + 37 + 36 of them in a triangle.
    assert sparse.nnz_reduced == 81 * (2 * 190 - 40)
    assert inspection.reduced_density == sparse.nnz_reduced / 360**2
    assert found["DENSE_SCHUR natural", "FUSED"].nnz_factor == 360 * 361 // 2
    assert found["SPARSE_NORMAL_CHOLESKY amd", "CERES"].nnz_reduced == 0


def test_the_fused_backend_takes_the_cheapest_order(inspect, street):
    methods = [
        m
        for m in inspect(street).methods
        if (m.linear_solver_type, m.backend) == ("SPARSE_SCHUR", "FUSED")
    ]
    assert {m.ordering for m in methods} == {"natural", "amd", "metis", "minimum_fill"}
    (taken,) = (m for m in methods if m.is_taken)
    assert taken.flops == min(m.flops for m in methods)
    for method in methods:
        assert in_order(method.note, taken.ordering) != method.is_taken


def test_an_order_that_neither_takes_is_for_comparison(inspect, street):
    for method in inspect(street).methods:
        assert (method.backend == "") == (method.ordering in ("colamd", "nesdis"))
        assert not (method.backend == "" and method.is_taken)


def test_what_does_not_fit_is_marked_and_not_recommended(inspect, monkeypatch):
    scene = make_scene(2000, 8000, 3)
    monkeypatch.setattr(_core, "available_memory", lambda: 1.5e9)
    inspection = inspect(scene)
    found = by_key(inspection)
    dense = found["DENSE_SCHUR natural", "FUSED"]
    assert dense.memory_in_bytes > 1.5 * 8 * 18_000**2  # S, and what rounding takes from it
    assert not dense.fits_in_memory
    assert not found["DENSE_SCHUR natural", "CERES"].fits_in_memory
    assert found["SPARSE_SCHUR amd", "FUSED"].fits_in_memory
    assert inspection.methods[inspection.recommended].fits_in_memory
    assert in_order(inspection.recommendation, "DENSE_SCHUR", "3.95 GB")


def test_where_nothing_fits(inspect, street, monkeypatch):
    monkeypatch.setattr(_core, "available_memory", lambda: 1e3)
    inspection = inspect(street)
    assert inspection.recommended == -1
    assert not any(method.fits_in_memory for method in inspection.methods)
    assert inspection.recommendation


def test_recommendation(inspect, street):
    inspection = inspect(street)
    best = inspection.methods[inspection.recommended]
    assert best.is_taken
    assert best.time_per_step_in_seconds == min(
        m.time_per_step_in_seconds for m in inspection.methods if m.is_taken and m.fits_in_memory
    )
    assert in_order(inspection.recommendation, best.linear_solver_type, "S", "21 %")


def test_recommendation_where_all_images_share_points(inspect):
    inspection = inspect(make_scene(4, 30, 4))
    assert inspection.reduced_density == 1.0
    assert in_order(inspection.recommendation, "S", "100 %")
    assert "e+0" not in inspection.recommendation.split(",")[0]


@pytest.mark.parametrize(("refine", "taken"), [("poses", {"FUSED"}), ("points", set())])
def test_nothing_to_eliminate(inspect, street, refine, taken):
    inspection = inspect(street, refine=refine)
    by_ceres = [one for one in inspection.methods if one.backend == "CERES"]
    assert [one.linear_solver_type for one in by_ceres] == ["SPARSE_NORMAL_CHOLESKY"]
    assert by_ceres[0].nnz_factor > 0
    assert {one.backend for one in inspection.methods} - {"CERES", ""} == taken
    assert inspection.methods[inspection.recommended].backend in (taken or {"CERES"})


def test_nothing_refined(inspect, street):
    with pytest.raises(
        bundle.InputError, match="refine: expected observations of the refined parameters"
    ):
        inspect(street, refine=())


def test_tracks_too_long_for_the_fused_backend(inspect, street, monkeypatch):
    monkeypatch.setattr(_core, "MAX_TRACK_LENGTH", 4)
    assert {method.backend for method in inspect(street).methods} == {"CERES"}


def test_threads_and_fixed_blocks(inspect, street):
    inspection = inspect(street, num_threads=1, fixed_image_ids=(0,), refine=("poses", "points"))
    assert inspection.num_threads == 1
    assert inspection.num_camera_columns == 39 * 6


_MEASURE = """
import ctypes, json, sys
from pathlib import Path
import bundle
from bundle.planning.inspection.problem_time import make_scene

def status(field):
    return 1024 * int(Path("/proc/self/status").read_text().split(field + ":")[1].split()[0])

scene = make_scene(60, 12_000, 5)
ctypes.CDLL(None).malloc_trim(0)  # what has been freed so far would hide what is taken
Path("/proc/self/clear_refs").write_text("5")
before = status("VmRSS")
bundle.solve(scene, backend=sys.argv[1], linear_solver_type=sys.argv[2], num_threads=1,
             max_num_iterations=2)
print(json.dumps(status("VmHWM") - before))
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="its allocator was measured")
@pytest.mark.parametrize(
    ("backend", "solver"),
    [
        ("fused", "dense_schur"),
        ("ceres", "sparse_schur"),
        ("ceres", "sparse_normal_cholesky"),
    ],
)
def test_memory_is_what_a_solve_takes(inspect, backend, solver):
    """Coarser than the 25 % of benchmarks/predictions.py: allocators differ."""
    done = subprocess.run(
        [sys.executable, "-c", _MEASURE, backend, solver],
        capture_output=True,
        text=True,
        check=True,
    )
    measured = json.loads(done.stdout)
    (method,) = (
        m
        for m in inspect(make_scene(60, 12_000, 5), num_threads=1).methods
        if m.is_taken
        and (m.backend, m.linear_solver_type) == (backend.upper(), solver.upper())
        and m.ordering != "cameras_first"
    )
    assert method.memory_in_bytes == pytest.approx(measured, rel=0.4)


@pytest.mark.parametrize(("more", "is_said"), [(1.0, False), (1.04, False), (1.06, True)])
def test_flops_are_compared_where_two_digits_differ(more, is_said):
    (chosen, *_) = (one for one in bundle.inspect(make_problem()).methods if one.flops)
    rival = dataclasses.replace(chosen, linear_solver_type="OTHER", flops=more * chosen.flops)
    text = inspection_result.explain([chosen, rival], 0, 1.0)
    assert ("1.1 times the flops" in text) == is_said and "OTHER" in text and "as long" in text
