"""The example that checks compiled cost functions: built with CMake as a user does, and run."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import bundle

EXAMPLE = Path(__file__).parents[2] / "examples" / "check_cost_function"
WARNINGS = "-Wall -Wextra -Wpedantic -Wshadow -Wconversion -Wno-sign-conversion -Werror"
BLOCKS = [[800.0, -0.1], [0.4, -0.3, 2.0]]


def run(*command: str | Path) -> str:
    """Return what a command prints; it finds CMake and Ninja beside this Python."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(
        command,
        env=os.environ | {"PATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout
    return done.stdout


def build(project: Path, folder: Path) -> None:
    """Build a project with our warnings as errors."""
    run(
        *("cmake", "-S", project, "-B", folder, "-G", "Ninja", "-DCMAKE_BUILD_TYPE=Debug"),
        *(f"-DPython_EXECUTABLE={sys.executable}", f"-DCMAKE_CXX_FLAGS={WARNINGS}"),
    )
    run("cmake", "--build", folder)


def loaded(library: Path, name: str) -> ModuleType:
    """Return a module of an extension library."""
    spec = importlib.util.spec_from_file_location(name, library)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example, whose one source also defines a module of cost functions that misbehave."""
    project = tmp_path_factory.mktemp("costs") / EXAMPLE.name
    shutil.copytree(EXAMPLE, project)
    with (project / "costs.cpp").open("a") as source:
        source.write(Path(__file__).with_name("odd_costs.cpp").read_text())
    build(project, project / "build")
    (found,) = (project / "build").glob("costs.*.so")
    return found


@pytest.fixture(scope="module")
def costs(library: Path) -> ModuleType:
    return loaded(library, "costs")


@pytest.fixture(scope="module")
def odd_costs(library: Path) -> ModuleType:
    return loaded(library, "odd_costs")


def test_the_header_is_where_get_include_says() -> None:
    assert (Path(bundle.get_include()) / "bundle" / "check.h").is_file()


def test_the_example_runs_and_its_report_names_the_mistake(costs: ModuleType) -> None:
    assert costs.__file__ is not None
    build_folder = Path(costs.__file__).parent
    printed = run("ctest", "--test-dir", build_folder, "--verbose", "--no-tests=error")
    words = " ".join(printed.split())
    assert "100% tests passed" in words
    assert "point z: the sign" in words, printed


def test_a_compiled_function_answers_as_the_formula(costs: ModuleType) -> None:
    (f, k), (x, y, z) = BLOCKS
    p = np.array([x, y]) / z
    residual, (d_camera, d_point) = costs.radial(160.0, -120.0)(BLOCKS)
    np.testing.assert_allclose(residual, f * (1 + k * p @ p) * p - [160.0, -120.0], rtol=1e-12)
    np.testing.assert_allclose(d_camera[:, 1], f * (p @ p) * p, rtol=1e-14)
    wrong = costs.radial_with_sign_error(160.0, -120.0)(BLOCKS)[1][1]
    np.testing.assert_array_equal(wrong, d_point * [1, 1, -1])


def test_where_evaluate_returns_false_there_is_no_value(costs: ModuleType) -> None:
    behind = [BLOCKS[0], [0.4, -0.3, -2.0]]
    function = costs.radial(0.0, 0.0)
    assert np.isnan(function(behind)[0]).all()
    assert bundle.check_gradients(function, behind).kinds == {"not_finite"}
    # A wide spread takes some samples behind the camera: they are skipped, the others checked.
    report = bundle.check_gradients(function, BLOCKS, radius=1.0, num_samples=20)
    assert report
    assert 0 < report.num_skipped < 20


@pytest.mark.parametrize(
    ("blocks", "message"),
    [
        (BLOCKS[:1], "cost function: expected 2 parameter blocks, found 1"),
        ([BLOCKS[0], [1.0, 2.0]], "cost function: expected block 1 to have 3 parameters, found 2"),
    ],
)
def test_blocks_of_another_size_are_refused(
    costs: ModuleType, blocks: list[list[float]], message: str
) -> None:
    with pytest.raises(bundle.InputError) as caught:
        bundle.check_gradients(costs.radial(0.0, 0.0), blocks)
    assert str(caught.value) == message


def test_blocks_that_are_no_numbers_are_refused(costs: ModuleType) -> None:
    with pytest.raises(bundle.InputError, match="found no numbers"):
        costs.radial(0.0, 0.0)([BLOCKS[0], "abc"])


def test_an_entry_that_is_never_written_is_named(odd_costs: ModuleType) -> None:
    report = bundle.check_gradients(odd_costs.forgetful(), [[2.0, 3.0]], names=[("p", ["a", "b"])])
    assert report.kinds == {"not_finite"}
    assert {name for finding in report.findings for name in finding.columns} == {"b"}


def test_an_exception_of_the_cost_function_comes_through(odd_costs: ModuleType) -> None:
    with pytest.raises(RuntimeError, match="no map loaded"):
        bundle.check_gradients(odd_costs.throwing(), [[2.0, 3.0]])


def test_no_cost_function_is_refused(odd_costs: ModuleType) -> None:
    with pytest.raises(bundle.InputError, match="found nullptr"):
        odd_costs.nothing()
