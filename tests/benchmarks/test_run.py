from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import bal, measure, problems, report, series, solvers, targets

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def data(scene, tmp_path):
    (tmp_path / "data" / "bal").mkdir(parents=True)
    bal.write(scene, tmp_path / "data" / "bal" / "problem-5-40-pre.txt")
    (tmp_path / "data" / "colmap" / "not_a_model").mkdir(parents=True)
    return tmp_path / "data"


def bench(data, *arguments):
    command = [sys.executable, str(ROOT / "benchmarks" / "run.py"), "--output", str(data / "out")]
    command += ["--no-synthetic"]
    env = {**os.environ, "BUNDLE_DATA": str(data)}
    return subprocess.run([*command, *arguments], env=env, capture_output=True, text=True)


def test_problems_are_found_by_what_is_there(data):
    assert [(p.name, p.kind) for p in problems.find(data)] == [("5-40", "bal")]


def test_solvers_are_chosen_by_the_beginnings_of_their_names():
    chosen = [solver.name for solver in solvers.chosen("pycolmap-dense,gtsam,bundle-ceres-a")]
    expected = [solvers.REFERENCE, "bundle ceres auto", "pycolmap dense-schur", "gtsam lm"]
    assert chosen == expected


def test_the_names_of_solvers_differ_and_those_asked_for_by_name_exist():
    names = [solver.name for solver in solvers.SOLVERS]
    assert len(set(names)) == len(names)
    assert {*solvers.TIGHT, *solvers.SCALED, targets.PEER, *targets.CERES_SCHUR} <= set(names)
    assert {targets.FUSED, targets.FUSED_SPARSE, targets.FUSED_ITERATIVE} <= set(names)


def test_bundle_and_pycolmap_side_by_side(data):
    one_thread = ["--repeat", "1", "--threads", "1"]
    done = bench(data, *one_thread, "--solvers", "pycolmap-auto,bundle-ceres-sparse")
    assert done.returncode == 0, done.stderr
    results = json.loads((data / "out" / "bench.json").read_text())
    outcomes = {(run["solver"], run["rule"]): run["outcome"] for run in results["runs"]}
    assert set(outcomes) == {
        ("bundle auto", "default"),
        ("bundle auto", "tight"),
        ("bundle ceres sparse-schur", "default"),
        ("pycolmap auto", "default"),
        ("pycolmap auto", "tight"),
    }
    page = (data / "out" / "bench.md").read_text()
    again = bench(data, "--from-json", str(data / "out" / "bench.json"))
    assert again.returncode == 0, again.stderr
    assert (data / "out" / "bench.md").read_text() == page
    theirs = outcomes["pycolmap auto", "default"]["final_cost"]
    for solver, outcome in outcomes.items():
        assert outcome is not None, (solver, done.stderr)
        assert outcome["final_cost"] == pytest.approx(theirs, rel=1e-5)
        assert outcome["verified_cost"] == pytest.approx(outcome["final_cost"], rel=1e-9)
        assert outcome["trace"][0][1] == pytest.approx(outcome["initial_cost"], rel=1e-6)
        assert outcome["trace"][-1][1] == pytest.approx(outcome["final_cost"], rel=1e-5)
    ours = outcomes["bundle ceres sparse-schur", "default"]
    assert ours["size"] == {
        "images": 5,
        "points": 40,
        "observations": 200,
        "image_pairs": 400,
        "cameras": 5,
        "camera_columns": 3,
        "rigs": 0,
    }
    assert 0 <= ours["added_memory"] < ours["peak_memory"]
    assert results["settings"]["rates"]["dgemm"] > 1e8
    whole = results["whole"]["5-40"]
    assert {run["failure"] for runs in whole.values() for run in runs} == {""}
    assert whole["bundle refine"][-1]["final_cost"] == pytest.approx(theirs, rel=1e-5)
    assert "| pycolmap auto (DENSE_SCHUR" in (data / "out" / "benchmarks.md").read_text()
    assert "(benchmarks.md)" in (data / "out" / "bench.md").read_text()


def test_a_solver_that_is_not_there_is_a_row_that_says_so(data):
    request, answer = data / "request.json", data / "answer.json"
    (problem,) = problems.find(data)
    fields = {"path": str(problem.path), "kind": "bal", "solver": "auto", "threads": 1}
    fields |= {"backend": "no-such-backend", "memory_limit": 0, **series.STOPPING}
    request.write_text(json.dumps(fields))
    command = [sys.executable, "-m", "benchmarks.runners.bundle_", str(request), str(answer)]
    env = measure.environment(ROOT, 1)
    subprocess.run(command, env=env, check=True)
    failure = json.loads(answer.read_text())["failure"]
    assert "backend" in failure
    assert "no-such-backend" in failure


def test_a_problem_that_is_not_there_is_an_error(data):
    done = bench(data, "--only", "5-40,nowhere")
    assert done.returncode == 2
    assert done.stderr.startswith("error: no problem chosen: nowhere;")
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
