"""Under limits of memory a command does its work or ends in one line, whatever fails first.

A limit of address space makes whatever asks for memory next fail: the loader, OpenBLAS, a thread's
stack, an array. The campaign of the limits in between is too long for every day; these are limits
at which one thing after the other failed badly.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import bundle
from tests.cli.conftest import command, environment
from tests.scenes import make_problem

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits as Linux has them")

MB = 10**6
MORE_CORES = max(0, len(os.sched_getaffinity(0)) - 2) if hasattr(os, "sched_getaffinity") else 0
"""Each core beyond two adds a stack and an arena of the heap."""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A BAL file and a COLMAP model."""
    folder = tmp_path_factory.mktemp("limits")
    paths = {"bal": folder / "scene.txt", "colmap": folder / "model"}
    scene = bundle.synthesize(num_images=12, num_points=300, camera_model="RADIAL", seed=1).problem
    bundle.save(scene, paths["bal"])
    bundle.save(make_problem(), paths["colmap"])
    return paths


def run(kind: int, limit: int, *arguments: Any) -> tuple[int, str]:
    def set_limit() -> None:
        resource.setrlimit(kind, (limit, limit))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

    done = subprocess.run(
        command(*arguments), env=environment(), capture_output=True, text=True, timeout=60,
        check=False, preexec_fn=set_limit,
    )  # fmt: skip
    return done.returncode, done.stderr


def expect_work_or_one_line(code: int, error: str) -> None:
    if code == 0:
        assert error == ""
        return
    assert code == 2, (code, error)
    assert error.startswith("error: not enough memory"), error
    assert error.count("\n") == 1, error


@pytest.mark.parametrize(
    ("kind", "limit"),
    [(resource.RLIMIT_AS, 1500 * MB), (resource.RLIMIT_DATA, 800 * MB)],
)
def test_a_generous_limit_changes_nothing(
    inputs: dict[str, Path], tmp_path: Path, kind: int, limit: int
) -> None:
    """1000 MB suffice on Debian 12; OpenBLAS and Python 3.13 of Debian 13 map more."""
    limit += 100 * MB * MORE_CORES
    for name, path in inputs.items():
        code, error = run(kind, limit, "refine", path, "-o", tmp_path / name, "--quiet")
        assert (code, error) == (0, "")


@pytest.mark.parametrize("limit", [60, 110, 250, 350, 450, 500, 560, 620])
def test_an_address_space_that_is_too_small_ends_in_one_line(
    inputs: dict[str, Path], tmp_path: Path, limit: int
) -> None:
    name = "colmap" if limit > 400 else "bal"
    backend = "fused" if limit % 100 else "ceres"
    arguments = ("refine", inputs[name], "-o", tmp_path / "out", "--quiet", "--backend", backend)
    expect_work_or_one_line(*run(resource.RLIMIT_AS, limit * MB, *arguments))


@pytest.mark.parametrize("limit", [20, 150, 250, 320, 400])
def test_a_data_segment_that_is_too_small_ends_in_one_line(
    inputs: dict[str, Path], tmp_path: Path, limit: int
) -> None:
    arguments = ("refine", inputs["bal"], "-o", tmp_path / "out", "--quiet")
    expect_work_or_one_line(*run(resource.RLIMIT_DATA, limit * MB, *arguments))


SOLVE_WITH_LITTLE_LEFT = """
import resource, sys
import bundle
problem = bundle.load(sys.argv[1])
bundle.solve(problem, num_threads=1)  # all modules are imported
pages = int(open("/proc/self/statm").read().split()[0])
limit = pages * resource.getpagesize() + 100_000_000
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
print(bundle.solve(problem, num_threads=1, linear_solver_type=sys.argv[2]).summary.final_cost)
"""


def test_a_sparse_fused_solve_takes_no_buffers_of_openblas(inputs: dict[str, Path]) -> None:
    """One buffer has 128 MiB, more than the limit leaves."""
    solver = "sparse_schur"
    done = subprocess.run(
        [sys.executable, "-c", SOLVE_WITH_LITTLE_LEFT, str(inputs["bal"]), solver],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert float(done.stdout) == pytest.approx(
        bundle.solve(inputs["bal"], linear_solver_type=solver).summary.final_cost, rel=1e-12
    )
