from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import bal, problems, report, solvers

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def data(scene, tmp_path):
    (tmp_path / "data" / "bal").mkdir(parents=True)
    bal.write(scene, tmp_path / "data" / "bal" / "problem-5-40-pre.txt")
    (tmp_path / "data" / "colmap" / "not_a_model").mkdir(parents=True)
    return tmp_path / "data"


def bench(data, *arguments):
    command = [sys.executable, str(ROOT / "benchmarks" / "run.py"), "--output", str(data / "out")]
    env = {**os.environ, "BUNDLE_DATA": str(data)}
    return subprocess.run([*command, *arguments], env=env, capture_output=True, text=True)


def test_problems_are_found_by_what_is_there(data):
    assert [(p.name, p.kind) for p in problems.find(data)] == [("5-40", "bal")]


def test_solvers_are_chosen_by_the_beginnings_of_their_names():
    chosen = [solver.name for solver in solvers.chosen("pycolmap-dense,gtsam")]
    assert chosen == [solvers.REFERENCE, "pycolmap dense-schur", "gtsam lm"]


def test_bundle_and_pycolmap_side_by_side(data):
    done = bench(data, "--repeat", "2", "--solvers", "pycolmap-auto,bundle-sparse")
    assert done.returncode == 0, done.stderr
    results = json.loads((data / "out" / "bench.json").read_text())
    outcomes = {run["solver"]: run["outcome"] for run in results["runs"]}
    assert set(outcomes) == {"bundle auto", "bundle sparse-schur", "pycolmap auto"}
    theirs = outcomes["pycolmap auto"]["final_cost"]
    for solver, outcome in outcomes.items():
        assert outcome is not None, (solver, done.stderr)
        assert outcome["final_cost"] == pytest.approx(theirs, rel=1e-5)
        assert outcome["verified_cost"] == pytest.approx(outcome["final_cost"], rel=1e-9)
        assert outcome["trace"][0][1] == pytest.approx(outcome["initial_cost"], rel=1e-6)
        assert outcome["trace"][-1][1] == pytest.approx(outcome["final_cost"], rel=1e-5)
    whole = results["whole"]["5-40"]
    assert {run["failure"] for runs in whole.values() for run in runs} == {""}
    assert whole["bundle refine"][-1]["final_cost"] == pytest.approx(theirs, rel=1e-5)
    assert "| pycolmap auto (DENSE_SCHUR" in (data / "out" / "bench.md").read_text()


def test_a_problem_that_is_not_there_is_an_error(data):
    done = bench(data, "--problems", "nowhere")
    assert done.returncode == 2
    assert done.stderr.startswith("error: no problem chosen")
    assert "5-40" in done.stderr


def test_the_table_goes_between_its_markers(tmp_path):
    readme = tmp_path / "README.md"
    readme.write_text(f"above\n{report.BEGIN}\nold\n{report.END}\nbelow\n")
    for _ in range(2):
        report.put_into(readme, "new\n")
        assert readme.read_text() == f"above\n{report.BEGIN}\nnew\n{report.END}\nbelow\n"


@pytest.mark.parametrize(
    "content",
    ["", report.BEGIN, report.END + report.BEGIN, 2 * (report.BEGIN + report.END)],
)
def test_a_readme_without_one_pair_of_markers_is_left_alone(tmp_path, content):
    readme = tmp_path / "README.md"
    readme.write_text(content)
    with pytest.raises(ValueError, match="expected one"):
        report.put_into(readme, "new\n")
    assert readme.read_text() == content
