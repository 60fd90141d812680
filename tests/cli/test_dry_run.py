"""--dry-run: the checks of a run, and what it would read, solve and write; no file changes."""

from __future__ import annotations

import json
import re
import shlex
from types import SimpleNamespace

import jsonschema
import pytest

import bundle
from bundle.cli.commands import COMMANDS
from bundle.interface.options import SolveOptions
from bundle.reports.json_schema import described_entries, report_schema
from bundle.reports.terminal.inspect import predicted
from tests.cli.test_bad_input import assert_refused, snapshot
from tests.graphs.pose_graphs import graphs
from tests.scenes import scene

WORDS = {
    "info": "IN",
    "inspect": "IN --html p.html",
    "refine": "IN -o OUT --html p.html --loss huber --json r.json",
    "compare": "IN --html p.html",
    "validate": "IN",
    "check": "IN",
    "covariance": "IN -o c.npz",
    "diagnose": "IN",
    "influence": "IN --on 'distance 1 2'",
    "plan": "IN --for 'distance 1 2'",
    "align": "IN -o OUT --reference IN",
    "merge": "IN IN -o OUT",
    "evaluate": "IN --reference IN",
    "report": "IN -o p.html",
    "triage": "IN IN",
    "vio": "IN -o p.tum",
    "convert": "IN OUT",
    "synth": "OUT",
    "demo": "OUT",
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    bundle.save(scene(3, 12), tmp_path / "IN")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_every_command_is_tried():
    assert set(WORDS) == set(COMMANDS)


@pytest.mark.parametrize("name", WORDS)
def test_nothing_is_written(run, folder, name):
    before = snapshot(folder)
    words = shlex.split(WORDS[name])
    code, out, err = run(name, *words, "--dry-run", "--quiet", "--json", "-")
    assert (code, err) == (0, "")
    assert snapshot(folder) == before
    report = json.loads(out)
    jsonschema.Draft202012Validator(report_schema()).validate(report)
    assert set(report) <= described_entries()["dry-run"]
    assert report["run"] == name
    written = " ".join(report["writes"])
    assert all(word in written for word in words if word in ("OUT", "p.html", "c.npz", "p.tum"))
    assert "IN" not in written


def test_no_file_of_a_report_is_written(run, folder):
    before = snapshot(folder)
    words = ("refine", "IN", "-o", "OUT", "--html", "p.html", "--json", "r.json", "--dry-run")
    code, _, _ = run(*words)
    assert code == 0
    assert snapshot(folder) == before


@pytest.mark.usefixtures("folder")
def test_refine_says_what_it_would_do(run):
    _, out, _ = run("refine", *shlex.split(WORDS["refine"]), "--dry-run", "--quiet")
    told = " ".join(out.split())
    assert "3 images" in told
    assert "--output OUT; --html p.html; --json r.json" in told
    assert "--loss huber" in told
    assert "per step" in told
    assert "At most 100 steps" in told
    _, out, _ = run("refine", "IN", "-o", "OUT", "--rounds", "2", "--dry-run", "--quiet")
    assert "At most 300 steps" in " ".join(out.split())
    _, part, _ = run("refine", "IN", "-o", "OUT", "--only-images", "1", "--dry-run", "--quiet")
    unknowns = [int(re.findall(r"for (\d+) unknowns", text)[0]) for text in (out, part)]
    assert 0 < unknowns[1] < unknowns[0]


@pytest.mark.parametrize(
    ("words", "error"),
    {
        "refine NONE -o OUT": "NONE",
        "refine IN -o IN2 --gps none.txt": "--gps & names",
        "refine IN -o IN2 --loops none.g2o": "none.g2o",
        "refine IN -o OUT --min-track 3": "--min-track & --rounds",
        "refine IN -o OUT --set 'camera 9: f fixed'": "camera 9",
        "refine IN -o OTHER": "OTHER & other images",
        "refine G.g2o -o OUT.g2o --rounds 2": "--rounds",
        "covariance IN -o c.npz --gauge upside": "--gauge",
        "evaluate IN --reference none.tum": "none.tum",
        "convert none.nvm OUT": "none.nvm",
    }.items(),
)
def test_what_a_run_would_refuse_is_refused(run, folder, words, error):
    bundle.save(scene(4, 12, seed=5), folder / "OTHER")
    bundle.save(graphs.loop(3), folder / "G.g2o")
    assert_refused(run(*shlex.split(words), "--dry-run", "--quiet"), *error.split(" & "))


def test_a_pose_graph_has_its_prediction(run, folder):
    bundle.save(graphs.loop(3), folder / "G.g2o")
    before = snapshot(folder)
    code, out, _ = run("refine", "G.g2o", "-o", "OUT.g2o", "--dry-run", "--quiet")
    assert (code, snapshot(folder)) == (0, before)
    assert "per step" in out
    assert "OUT.g2o" in out


def method(backend, solver, seconds, *, fits=True):
    return SimpleNamespace(
        backend=backend, linear_solver_type=solver, time_per_step_in_seconds=seconds,
        memory_in_bytes=1e6, num_unknowns=10, fits_in_memory=fits,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "auto", "seconds"),
    [
        ({}, "SPARSE_SCHUR", "2 s"),  # the faster of two orders
        ({"linear_solver_type": "dense_schur"}, "SPARSE_SCHUR", "3 s"),
        ({"backend": "ceres"}, "SPARSE_SCHUR", "5 s"),
        ({"backend": "ceres", "linear_solver_type": "sparse_schur"}, "SPARSE_SCHUR", "6 s"),
        ({}, "", "5 s"),  # the fused backend has no method
        ({"linear_solver_type": "dense_qr"}, "SPARSE_SCHUR", ""),
    ],
)
def test_the_prediction_is_that_of_the_solver_of_the_options(changes, auto, seconds):
    methods = [
        method("FUSED", "DENSE_SCHUR", 3.0), method("FUSED", "SPARSE_SCHUR", 4.0),
        method("FUSED", "SPARSE_SCHUR", 2.0, fits=False), method("", "SPARSE_SCHUR", 0.1),
        method("CERES", "DENSE_SCHUR", 5.0), method("CERES", "SPARSE_SCHUR", 6.0),
    ]  # fmt: skip
    found = SimpleNamespace(methods=methods, auto_choice=auto, num_threads=2)
    sentences = predicted(found, SolveOptions(max_num_iterations=5, **changes), 2)
    if not seconds:
        assert "not predicted" in sentences[0]
        return
    assert f"{seconds} per step" in sentences[0]
    assert ("does not fit" in sentences[0]) == (seconds == "2 s")
    assert sentences[1].startswith("At most 10 steps: ")
    assert f" {10 * int(seconds[0])} s" in sentences[1]
