"""Comparisons of real solves."""

import dataclasses
import json
import math
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import bundle
from bundle.base.tables import render
from bundle.errors import InputError
from bundle.planning.comparison import process
from bundle.planning.comparison.compare_methods import compare
from bundle.planning.comparison.measured_run import Prediction
from bundle.reports.terminal.compare import compared
from bundle.reports.terminal.screen import laid_out
from tests.printed import figures
from tests.scenes import make_problem, scene

pytestmark = pytest.mark.usefixtures("unpredicted")

PROBLEM = make_problem(num_images=8, num_points=200)
QUICK = {"repeat": 1, "threads": [1], "trust_regions": ["levenberg_marquardt"]}


def test_every_method_reaches_the_same_cost():
    comparison = compare(PROBLEM, repeat=1, threads=[1])
    assert len(comparison.runs) == 2 * (3 + 2 * 2)  # doglegs of the direct solvers
    assert {run.outcome for run in comparison.runs} == {"done"}
    here = bundle.solve(PROBLEM, num_threads=1).summary.final_cost
    for run in comparison.runs:
        assert run.final_cost == pytest.approx(here, rel=1e-5)
        assert 0 <= comparison.gap(run) < 1e-5
        assert run.measurement.summary.backend_used.lower() == run.method.backend
        times = [comparison.time_to_gap(run, gap) for gap in (1e-2, 1e-3, 1e-5)]
        assert times == sorted(times)
        assert times[-1] <= run.total_time_in_seconds
        assert sum(run.measurement.breakdown.values()) == pytest.approx(run.total_time_in_seconds)
    totals = {run.method: run.total_time_in_seconds for run in comparison.runs}
    assert totals[comparison.recommendation.method] == min(totals.values())
    assert comparison.recommendation.foreseen[0] in totals
    assert not comparison.interrupted


def test_repeated_runs_are_measured_each():
    chosen = {"solvers": ["dense_schur"], "backends": ["fused"]}
    (run,) = compare(PROBLEM, **chosen, **(QUICK | {"repeat": 2})).runs
    assert len(run.measurements) == 2
    assert run.outcome == "done"


def test_runs_that_fail_are_rows(monkeypatch):
    def command(folder, request, channel):
        solver = json.loads(Path(request).read_text())["options"]["linear_solver_type"]
        if solver == "sparse_schur":
            return [sys.executable, "-c", "import os; os.abort()"]
        return original(folder, request, channel)

    original = process.worker_command
    monkeypatch.setattr(process, "worker_command", command)
    comparison = compare(PROBLEM, solvers=["sparse_schur", "dense_qr", "dense_schur"], **QUICK)
    outcomes = {run.method.name: run.outcome for run in comparison.runs}
    assert outcomes == {
        "fused SPARSE_SCHUR": "died",
        "fused DENSE_QR": "refused",
        "fused DENSE_SCHUR": "done",
        "ceres SPARSE_SCHUR": "died",
        "ceres DENSE_QR": "done",
        "ceres DENSE_SCHUR": "done",
    }
    text = render(*laid_out(compared(comparison)))
    for name, reason in (("fused SPARSE_SCHUR", "SIGABRT"), ("fused DENSE_QR", "dense_schur")):
        line = next(line for line in text.splitlines() if line.startswith(f"- {name}: "))
        assert reason in line
    done = {name for name, outcome in outcomes.items() if outcome == "done"}
    assert comparison.recommendation.method.name in done  # the fastest of them today


def test_dense_matrix_beyond_the_cap_is_a_row():
    # 900 images of 9 unknowns: S has 8100 columns and takes 525 MB.
    problem = bundle.synthesize(
        num_images=900, num_points=9000, cameras="individual", camera_model="RADIAL"
    ).problem
    comparison = compare(
        problem,
        solvers=["dense_schur", "sparse_schur"],
        memory_cap=500_000_000,
        max_num_iterations=1,
        **QUICK,
    )
    runs = {run.method.name: run for run in comparison.runs}
    for name in ("fused DENSE_SCHUR", "ceres DENSE_SCHUR"):
        assert runs[name].outcome == "out_of_memory"
        assert "500 MB" in runs[name].message
    for name in ("fused SPARSE_SCHUR", "ceres SPARSE_SCHUR"):
        assert runs[name].outcome == "done"
        assert runs[name].measurement.added_memory_in_bytes < 500_000_000
    assert render(*laid_out(compared(comparison))).count("500 MB") >= 2
    assert comparison.recommendation.method.linear_solver_type == "sparse_schur"


def test_ctrl_c_keeps_what_is_there():
    def progress(at):
        if at.stage.startswith("3 of "):
            raise KeyboardInterrupt

    comparison = compare(PROBLEM, progress=progress, **QUICK)
    assert comparison.interrupted
    assert [run.outcome for run in comparison.runs] == ["done"] * 2 + ["not_run"] * 4
    assert comparison.recommendation.method in {run.method for run in comparison.runs[:2]}
    text = render(*laid_out(compared(comparison)))
    assert all(run.message in " ".join(text.split()) for run in comparison.runs[2:])


def test_what_auto_took_is_told():
    comparison = compare(PROBLEM, solvers=["auto", "cgnr"], backends=["auto"], **QUICK)
    text = render(*laid_out(compared(comparison)))
    notes = {line.split(":")[0]: line for line in text.splitlines() if line.startswith("- ")}
    assert "fused DENSE_SCHUR" in notes["- auto AUTO"]
    assert "ceres CGNR" in notes["- auto CGNR"]


def test_several_problems_give_profiles(tmp_path, monkeypatch):
    cost = Prediction(
        ordering="", num_unknowns=0, nnz_reduced=0, nnz_factor=0, flops=0, memory_in_bytes=0,
        time_per_step_in_seconds=0.5, fits_in_memory=True,
    )  # fmt: skip

    def predict(_, __, methods):
        return dict.fromkeys(methods, cost)

    monkeypatch.setattr("bundle.planning.comparison.work.predict", predict)
    path = tmp_path / "scene.txt"
    bundle.save(scene(), path)
    stages = []
    comparison = compare(
        [path, PROBLEM],
        solvers=["dense_schur", "iterative_schur"],
        backends=["fused"],
        progress=lambda at: stages.append(at.stage),
        **QUICK,
    )
    plan = next(k for k, stage in enumerate(stages) if "solves" in stage)
    assert re.match(r"4 solves, 20(\.0)? s at 10 steps each; .*bundle evaluate", stages[plan])
    assert stages[plan + 1].startswith("1 of 4: ")
    assert [problem.name for problem in comparison.problems] == [str(path), "problem 2"]
    assert len(comparison.profiles) == 3 * 2
    for gap in (1e-2, 1e-3, 1e-5):
        dense, iterative = (one for one in comparison.profiles if one.gap == gap)
        assert dense.num_problems == 2
        assert dense.share(1) + iterative.share(1) >= 1
        assert dense.share(math.inf) == 1
    text = render(*laid_out(compared(comparison)))
    heads = [figures(line)[:2] for line in text.splitlines() if "within" in line]
    assert ["2", "1e-3"] in heads
    assert max(map(len, text.splitlines())) <= 100


def test_json_has_what_refine_says_of_each_run():
    comparison = compare(PROBLEM, solvers=["dense_schur", "dense_qr"], backends=["fused"], **QUICK)
    report = compared(comparison).json()
    assert json.loads(json.dumps(report, allow_nan=False)) == report
    assert (report["schema"], report["command"]) == (1, "compare")
    assert report["inputs"] == [
        {
            "path": None,
            "format": "memory",
            "num_cameras": 8,
            "num_images": 8,
            "num_points": 200,
            "num_observations": 1600,
        }
    ]
    dense, refused = report["runs"]
    assert dense["method"]["linear_solver_type"] == "DENSE_SCHUR"
    (measurement,) = dense["measurements"]
    assert measurement["summary"]["final_cost"] == dense["final_cost"] == report["best_costs"][0]
    steps = [entry["iteration"] for entry in measurement["iterations"]]
    assert steps == list(range(len(steps)))
    assert refused["outcome"] == "REFUSED"
    assert refused["measurements"] == []
    assert refused["gap"] is None
    assert report["recommendation"]["method"] == dense["method"]


def test_bad_problems_are_refused_before_anything_runs(tmp_path):
    with pytest.raises(InputError, match="problems: expected at least one problem, found 0"):
        compare([])
    empty = dataclasses.replace(
        PROBLEM,
        observation_image=np.empty(0, np.int32),
        observation_point=np.empty(0, np.int32),
        observation_xy=np.empty((0, 2)),
        observation_keypoint=np.empty(0, np.int32),
    )
    with pytest.raises(InputError, match="problem 2: expected observations to refine, found "):
        compare([PROBLEM, empty])
    with pytest.raises(OSError, match="nothing-here"):
        compare(tmp_path / "nothing-here")
    with pytest.raises(InputError, match="repeat: expected at least 1, found 0"):
        compare(PROBLEM, repeat=0)
