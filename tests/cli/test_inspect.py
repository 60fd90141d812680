"""`bundle inspect` from the outside."""

from __future__ import annotations

import json
import sys
import types

import pytest

from bundle import _core
from bundle.cli.main import command_parser
from bundle.planning.inspection import problem_inspection
from bundle.planning.inspection.graph_inspection import GRAPH_ORDERINGS
from tests.made_up_machine import RATES
from tests.printed import figures, table


@pytest.fixture(autouse=True)
def rates(monkeypatch):
    """Answers to the questions of the rates whether to measure them again."""
    asked = []

    def made_up(*_threads, recalibrate):
        asked.append(recalibrate)
        return RATES

    monkeypatch.setattr(problem_inspection, "problem_rates", made_up)
    return asked


@pytest.fixture
def cycle(tmp_path):
    """A cycle of six variables."""
    path = tmp_path / "cycle.txt"
    path.write_text("# six\n" + "".join(f"{i} {(i + 1) % 6}\n" for i in range(6)))
    return path


def test_report(run, model):
    code, out, _ = run("inspect", model, "--verbose")
    assert code == 0
    costs = table(out[out.index("\nmethod ") :])
    for name in ("SPARSE_SCHUR colamd", "SPARSE_NORMAL_CHOLESKY amd"):
        assert name in costs
    assert "DENSE_SCHUR natural <" in costs  # what is recommended
    assert f"bundle refine {model} -o OUTPUT" in out.replace(" \\\n    ", " ")
    assert max(map(len, out.splitlines())) <= 100


def test_json(run, model, tmp_path):
    target = tmp_path / "report.json"
    code, out, err = run(
        "inspect", model, "--quiet", "--json", target, "--threads", 1, "--refine", "poses,points"
    )
    assert (code, err) == (0, "")
    assert out
    report = json.loads(target.read_text())
    assert list(report)[:5] == ["schema", "command", "version", "input", "headline"]
    assert (report["schema"], report["command"], report["num_threads"]) == (1, "inspect", 1)
    assert report["options"]["refine"] == ["poses", "points"]
    assert report["recommended_command"].startswith(f"bundle refine {model} -o OUTPUT")
    assert "--refine poses,points" in report["recommended_command"]
    names = {method["name"] for method in report["methods"]}
    assert "SPARSE_SCHUR metis" in names
    for method in report["methods"]:
        assert method["num_unknowns"] == report["methods"][0]["num_unknowns"]
        assert method["memory_in_bytes"] > 0
        assert method["time_per_step_in_seconds"] > 0
        assert len(method["column_count_profile"]) <= 200
    best = report["methods"][report["recommended"]]
    assert report["recommendation"].startswith(best["linear_solver_type"])
    assert report["wall_time"]["total"] > 0


def test_json_on_standard_output_alone(run, model):
    code, out, _ = run("inspect", model, "--json", "-")
    assert code == 0
    assert json.loads(out)["command"] == "inspect"


def test_what_does_not_fit_is_marked(run, model, monkeypatch):
    monkeypatch.setattr(_core, "available_memory", lambda: 1e5)
    code, out, _ = run("inspect", model, "--verbose")
    assert code == 0
    costs = table(out[out.index("\nmethod ") :])
    assert costs["DENSE_SCHUR natural"][0].endswith("!")
    assert costs["ITERATIVE_SCHUR identity"][0].endswith("!")
    assert "bundle refine" not in out


def test_recalibrate(run, model, rates):
    run("inspect", model)
    run("inspect", model, "--recalibrate")
    assert rates == [False, True]


def test_html(run, model, cycle, tmp_path, monkeypatch):
    written = []
    page = types.ModuleType("bundle.reports.page.inspection_page")
    page.write_inspection = lambda *arguments, **named: written.append((*arguments, named))
    monkeypatch.setitem(sys.modules, page.__name__, page)
    target = str(tmp_path / "page.html")
    assert run("inspect", model, "--html", target, "--ranks", "1,4").code == 0
    assert run("inspect", "--graph", cycle, "--html", target).code == 0
    (inspection, path, problem, options, named), (graph, _, _) = written
    assert (path, named["name"]) == (target, str(model))
    assert [row.num_processes for row in named["ranks"]] == [1, 4]
    assert inspection.methods
    assert problem.num_images == inspection.num_camera_blocks
    assert options.num_threads == 0
    assert graph.fill == 3


def test_graph(run, cycle):
    code, out, _ = run("inspect", "--graph", cycle, "--verbose")
    assert code == 0
    rows = table(out)
    assert rows["column counts"] == ["2 2 2 2 1 0"]
    assert figures(rows["flops"][0])[0] == "44"
    assert "1-5" in rows["0"]  # the first edge of fill
    assert max(map(len, out.splitlines())) <= 100


def flops(out):
    return figures(table(out)["flops"][0])[0]


def test_graph_in_another_order(run, tmp_path):
    star = tmp_path / "star.txt"
    star.write_text("".join(f"hub leaf{i}\n" for i in range(6)))
    assert flops(run("inspect", "--graph", star, "--verbose").out) == "154"
    words = ("inspect", "--graph", star, "--verbose")
    out = run(*words, "--ordering", "minimum-degree").out
    assert flops(out) == "24"
    leaves = ",".join(f"leaf{i}" for i in range(6))
    code, out, _ = run(*words, "--ordering", "landmarks-first", "--landmarks", leaves)
    assert code == 0
    assert flops(out) == "24"


def test_graph_of_poses(run, tmp_path):
    chain = tmp_path / "chain.txt"
    chain.write_text("0 1\n1 2\n")
    out = run("inspect", "--graph", chain, "--block-size", 6, "--verbose").out
    assert figures(table(out)["nonzeros"][0])[0] == "252"


def test_graph_json(run, cycle, tmp_path):
    target = tmp_path / "graph.json"
    assert run("inspect", "--graph", cycle, "--ordering", "reverse", "--json", target).code == 0
    report = json.loads(target.read_text())
    assert (report["command"], report["graph"]) == ("inspect", str(cycle))
    assert (report["ordering"], report["order"]) == ("reverse", [5, 4, 3, 2, 1, 0])
    assert report["column_counts"] == [2, 2, 2, 2, 1, 0]
    assert (report["fill"], report["flops"]) == (3, 44)
    assert [step["variable"] for step in report["steps"]] == report["order"]


def test_the_orderings_of_graphs_are_the_library_s():
    (action,) = (
        action
        for action in command_parser().commands()["inspect"]._actions
        if "--ordering" in action.option_strings
    )
    assert tuple(name.replace("-", "_") for name in action.choices) == GRAPH_ORDERINGS


def test_several_processes(run, model, tmp_path):
    report = tmp_path / "report.json"
    code, out, _ = run("inspect", model, "--ranks", "1,3", "--network", "25,2", "--json", report)
    assert code == 0
    assert "25 Gbit/s" in out
    given = json.loads(report.read_text())
    assert [row["num_processes"] for row in given["ranks"]] == [1, 3]
    assert given["network"] == {"gbit_per_second": 25, "latency_in_microseconds": 2}


@pytest.mark.parametrize(
    "words",
    [
        ("--ranks", "1,x"),
        ("--ranks", "0"),
        ("--ranks", "31"),  # points
        ("--ranks", "1", "--network", "10"),
        ("--ranks", "1", "--network", "10,-1"),
        ("--network", "10,5"),
    ],
)
def test_processes_that_cannot_be(run, model, words):
    code, out, err = run("inspect", model, *words, "--quiet")
    assert (code, out) == (2, "")
    (line,) = err.splitlines()
    assert line.startswith(("error: --ranks", "error: --network", "error: mpirun"))
