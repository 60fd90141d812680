from __future__ import annotations

import argparse
from pathlib import Path

import pytest
from benchmarks.problems import BenchmarkProblem

from benchmarks import series, solvers


def problem(**changes):
    return BenchmarkProblem(**{"name": "p", "kind": "bal", "path": Path("p.txt"), **changes})


def kinds(all_series):
    return {(one.solver.name, one.rule, one.threads) for one in all_series}


def test_a_bal_problem_is_run_by_two_rules_and_with_one_thread():
    wanted = solvers.chosen("bundle-fused-auto,gtsam")
    made = kinds(series.of_problem(problem(), wanted, 2, quick=False))
    assert made == {
        ("bundle auto", "default", 2),
        ("bundle fused auto", "default", 2),
        ("gtsam lm", "default", 2),
        ("bundle auto", "tight", 2),
        ("bundle fused auto", "default", 1),
    }
    quick = series.of_problem(problem(), wanted, 2, quick=True)
    assert {(rule, threads) for _, rule, threads in kinds(quick)} == {("default", 2)}
    alone = series.of_problem(problem(), wanted, 1, quick=False)
    assert len(alone) == len(kinds(alone))


def test_a_large_problem_has_no_tight_runs():
    made = series.of_problem(problem(num_observations=1_000_000), solvers.SOLVERS, 2, quick=False)
    assert {one.rule for one in made} == {"default"}


@pytest.mark.parametrize(
    ("name", "changes", "reason"),
    [
        ("gtsam lm", {"kind": "colmap"}, "Cal3Bundler"),
        ("bundle ceres dense-schur", {"num_images": 5000}, "more than 1000 images"),
        ("scipy trf", {"num_observations": 10**6}, "more than 100,000 observations"),
        ("bundle fused dense-schur", {"num_images": 1000, "num_observations": 10**6}, ""),
    ],
)
def test_what_a_solver_is_not_given(name, changes, reason):
    (solver,) = (solver for solver in solvers.SOLVERS if solver.name == name)
    found = solver.reason_against(problem(**changes))
    assert reason in found
    assert bool(reason) == bool(found)


def test_rounds_are_interleaved_and_the_slow_and_the_broken_leave(monkeypatch):
    walls = {"bundle auto": 1.0, "gtsam lm": 2.0 * series.REPEAT_BELOW, "scipy trf": 1.0}
    order = []

    def run(one, timeout):
        assert timeout == 7.0
        order.append(one.solver.name)
        failure = "broken" if one.solver.name == "scipy trf" else ""
        return {"failure": failure, "wall": walls[one.solver.name]}

    monkeypatch.setattr(series, "run", run)
    made = series.of_problem(problem(), solvers.chosen("gtsam,scipy"), 2, quick=True)
    runs = series.run_interleaved(made, argparse.Namespace(repeat=3, timeout=7.0))
    assert order == ["bundle auto", "gtsam lm", "scipy trf", "bundle auto", "bundle auto"]
    assert len(runs) == 5


def test_what_is_not_run_says_why():
    (gtsam,) = (solver for solver in solvers.SOLVERS if solver.name == "gtsam lm")
    run = series.run(series.Series(problem(kind="colmap"), gtsam, "default", 2), 1.0)
    assert "Cal3Bundler" in run["failure"]
    assert run["outcome"] is None
