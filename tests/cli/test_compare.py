"""`bundle compare` from the outside."""

from __future__ import annotations

import json
import shlex
import signal
import subprocess

import pytest

import bundle
from bundle.interface.environment import Environment
from tests.cli.conftest import command, environment
from tests.planning.comparison.conftest import unpredicted  # noqa: F401
from tests.printed import figures
from tests.reports.page.reader import Page

pytestmark = pytest.mark.usefixtures("unpredicted", "idle")

QUICK = ("--repeat", 1, "--threads", 1, "--trust-regions", "levenberg-marquardt")


@pytest.fixture
def idle(monkeypatch):
    """Tests run beside each other: on a busy machine nothing is recommended."""
    monkeypatch.setattr(Environment, "is_busy", lambda *_: False)


def test_table_recommendation_and_command_line(run, model):
    code, out, err = run("compare", model, *QUICK)
    assert code == 0
    for name in ("fused", "ceres"):
        for solver in ("DENSE", "SPARSE", "ITERATIVE"):
            assert f"{name} {solver}_SCHUR" in out
    assert f"bundle refine {model} -o OUTPUT" in out.replace(" \\\n    ", " ")
    assert "ceres ITERATIVE_SCHUR" in err.splitlines()[-1]
    assert figures(err.splitlines()[-1]) == ["6", "6", "1"]  # the last of six, on one thread
    report = out[: out.index("bundle refine")]  # a path in the command may be longer
    assert max(map(len, report.splitlines())) <= 100


def test_recommended_command_runs(run, model, tmp_path):
    out = run("compare", model, *QUICK, "--solvers", "dense-schur", "--backends", "fused").out
    line = out[out.index("bundle refine") :].split("\n\n")[0].replace("\\\n", " ")
    words = line.replace("OUTPUT", str(tmp_path / "refined.txt")).split()
    assert run(*words[1:]).code == 0


def test_json_alone_on_standard_output(run, model):
    code, out, err = run("compare", model, *QUICK, "--solvers", "dense-schur", "--json", "-")
    report = json.loads(out)
    assert code == 0
    assert report["command"] == "compare"
    assert [one["outcome"] for one in report["runs"]] == ["DONE", "DONE"]
    assert report["inputs"][0]["path"] == str(model)
    assert ["1", "2", "1"] in map(figures, err.splitlines())


def test_two_models_are_told_of_the_command_that_compares_them(run, model, tmp_path):
    other = tmp_path / "a b"
    run("convert", model, other)
    err = run("compare", model, other, *QUICK, "--solvers", "dense-schur").err
    (note,) = (line for line in err.splitlines() if line.startswith("note: "))
    assert note.endswith(f"bundle evaluate {model} --reference '{other}'")
    assert err.index(note) < err.index("DENSE_SCHUR")
    assert run(*shlex.split(note.partition(": bundle ")[2])).code == 0
    assert "note" not in run("compare", model, *QUICK, "--solvers", "dense-schur").err


def test_quiet(run, model):
    arguments = ("--solvers", "dense-schur", "--backends", "fused", "--quiet")
    assert run("compare", model, *QUICK, *arguments).err == ""


def test_nothing_usable_is_1(run, model):
    code, out, _ = run("compare", model, *QUICK, "--solvers", "cgnr", "--backends", "fused")
    assert code == 1
    assert "bundle refine" not in out


def test_report_must_not_replace_an_input(run, model):
    code, _, err = run("compare", model, "--json", model)
    assert code == 2
    assert str(model) in err
    assert bundle.load(model).num_observations == 120


def test_html_page(run, model, tmp_path):
    page = tmp_path / "page.html"
    arguments = ("--solvers", "dense-schur", "--backends", "fused", "--html", page)
    assert run("compare", model, *QUICK, *arguments).code == 0
    text = Page(page).text
    assert "fused DENSE_SCHUR" in text
    assert "bundle refine" in text


def test_ctrl_c_ends_with_what_is_there(model):
    with subprocess.Popen(
        command("compare", model, "--repeat", 100), env=environment(), text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    ) as process:  # fmt: skip
        for line in process.stderr:
            if line.startswith("4 of "):
                process.send_signal(signal.SIGINT)
                break
        out, err = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "Traceback" not in err
    assert "fused DENSE_SCHUR" in out
    assert ("bundle refine" in out) != ("the machine was busy" in out)
    assert "interrupted" in out
