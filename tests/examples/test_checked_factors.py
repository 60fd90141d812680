"""The example project whose suite checks its factors: run as a user does, with mistakes too."""

from __future__ import annotations

import importlib.metadata
import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "checked_factors"
PLUGIN = "bundle.cli.pytest_plugin"

SIGN = ("by_landmark = by_seen", "by_landmark = -by_seen")
ON_THE_WORLD = (
    "by_pose = by_seen @ np.array([[-1, 0, left], [0, -1, -forward]])",
    "by_pose = by_seen @ np.array([[-c, -s, left], [s, -c, -forward]])",
)


def run(folder: Path, *flags: str) -> tuple[int, str]:
    """Return exit code and output of the suite in a folder."""
    installed = importlib.metadata.entry_points(group="pytest11")
    known = any(entry.value == PLUGIN for entry in installed)
    plugin = [] if known else ["-p", PLUGIN]  # an environment from before the entry point
    # An editable package is imported before pytest rewrites assertions.
    quiet = ["-W", "ignore::pytest.PytestAssertRewriteWarning"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *quiet, *plugin, *flags],
        cwd=folder,
        env={k: v for k, v in os.environ.items() if not k.startswith("PYTEST_")},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=120,
    )
    return done.returncode, " ".join(done.stdout.split())


@pytest.fixture
def project(tmp_path: Path) -> Path:
    return Path(shutil.copytree(EXAMPLE, tmp_path / "project"))


def plant(project: Path, mistake: tuple[str, str]) -> None:
    path = project / "landmarks.py"
    text = path.read_text()
    assert text.count(mistake[0]) == 1
    path.write_text(text.replace(*mistake))


def test_the_package_declares_the_plugin() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["entry-points"]["pytest11"] == {"bundle": PLUGIN}


def test_the_suite_passes_and_counts_the_kinds(project: Path) -> None:
    code, out = run(project)
    assert code == 0
    assert "by kind: 1 correct" in out


@pytest.mark.parametrize(
    ("mistake", "words"),
    [(SIGN, "the sign is flipped"), (ON_THE_WORLD, "t + d")],
    ids=["sign", "frame"],
)
def test_a_mistake_fails_both_tests_with_its_name(
    project: Path, mistake: tuple[str, str], words: str
) -> None:
    plant(project, mistake)
    code, out = run(project)
    assert code == 1
    assert "2 failed" in out
    assert out.count(words) >= 2
    assert "FunctionFactor('x0', 'l0')" in out
    assert "site-packages" not in out  # the report, not a traceback


def test_without_the_flag_only_the_fixture_checks(project: Path) -> None:
    plant(project, SIGN)
    (project / "pyproject.toml").write_text("[tool.pytest.ini_options]\n")
    code, out = run(project)
    assert (code, "1 failed" in out) == (1, True)


def test_factors_of_a_problem_are_checked_and_undecided_ones_may_be_allowed(project: Path) -> None:
    (project / "test_more.py").write_text(
        """
import numpy as np
import pytest

import bundle


def wrong(values):
    return values[0] - 1, [-np.eye(3)]


@pytest.fixture
def problem():
    return bundle.synthesize(num_images=4, num_points=20).problem


def test_problem(problem):
    key = ("point", int(problem.point_ids[0]))
    bundle.solve(problem, factors=[bundle.FunctionFactor([key], wrong)])


def kink(blocks):
    return abs(blocks[0]), [np.sign(blocks[0])[None]]


def test_undecided(check_gradients):
    check_gradients(kink, [[0.0]], num_samples=1, allow_undecided=True)
    with pytest.raises(pytest.fail.Exception):
        check_gradients(kink, [[0.0]], num_samples=1)


def test_bad_input_is_that_of_the_solve():
    graph = bundle.FactorGraph()
    graph.add_variable("x", [1.0])
    graph.add_factor(bundle.FunctionFactor(["x"], lambda values: 3))
    with pytest.raises(bundle.InputError):
        graph.solve()
"""
    )
    code, out = run(project, "test_more.py")
    assert code == 1
    assert "1 failed, 2 passed" in out
    assert "the sign is flipped" in out
