"""`bundle check` of factors in a Python file, and of pose graphs."""

from __future__ import annotations

import json

import numpy as np
import pytest

import bundle
from tests.printed import table

FILE = """
import numpy as np

import bundle
import {helper}

limit = 3


def curve(values):
    return [values[0] ** 2 - 1], [2 * values[0][None]]


def wrong(values):
    return [values[0] ** 2 - 1], [-2 * values[0][None]]


def graph_of(*functions):
    graph = bundle.FactorGraph()
    for i in range(8):
        graph.add_variable(i, [i + 1.0])
        for function in functions:
            graph.add_factor(bundle.FunctionFactor([i], function))
    return graph


def make_graph():
    return graph_of(curve)


def make_wrong():
    return graph_of(curve, wrong)


def one_function():
    return curve, [[2.0]]


def one_factor():
    return bundle.FunctionFactor(["x"], wrong), [[2.0]]


def on_a_kink():
    return graph_of(lambda values: (abs(values[0] - 1), [[np.sign(values[0] - 1)]]))


def changing():
    return graph_of(lambda v: (np.ones(2 - (v[0][0] % 1 == 0)), [np.ones((1, 1))]))


def no_value():
    return graph_of(lambda v: (v[0] * np.nan, [np.ones((1, 1))]))


def divides():
    return graph_of(lambda v: (v[0], [[[1 / 0]]]))


def fails():
    raise KeyError("map")


def unpicklable():
    graph = graph_of(curve)
    graph.lock = __import__("threading").Lock()
    return graph
"""


@pytest.fixture
def factors(tmp_path):
    (tmp_path / "own_helper_of_a_test.py").write_text("value = 1\n")
    path = tmp_path / "my_factors.py"
    path.write_text(FILE.format(helper="own_helper_of_a_test"))
    return path


@pytest.mark.parametrize(
    ("name", "code", "words"),
    [
        ("", 0, ["8 factors"]),
        (":make_graph", 0, ["8 factors"]),
        (":make_wrong", 1, ["sign", "FunctionFactor wrong", "8 of 8"]),
        (":one_function", 0, ["10 samples"]),
        (":one_factor", 1, ["sign", "'x'"]),
        (":on_a_kink", 3, ["UNDECIDED"]),
        (":unpicklable", 0, ["8 factors"]),
    ],
)
def test_objects_of_a_file(run, factors, name, code, words):
    found, out, _ = run("check", f"{factors}{name}", "--quiet")
    assert found == code
    for word in words:
        assert word in " ".join(out.split())


@pytest.mark.parametrize(
    ("name", "words"),
    [
        (":changing", ["factor 0", "expected 1 residual", "found 2"]),
        (":no_value", ["factor 0", "finite"]),
        (":divides", ["factor 0", "ZeroDivisionError", "line"]),
        (":fails", ["fails()", "KeyError", "line"]),
        (":limit", ["expected a FactorGraph", "found 3"]),
        (":make_grap", ["make_grap", "did you mean make_graph"]),
    ],
)
def test_bad_factors_are_one_line(run, factors, name, words):
    code, out, err = run("check", f"{factors}{name}", "--quiet")
    assert (code, out) == (2, "")
    assert err.startswith("error: ")
    assert len(err.splitlines()) == 1
    for word in words:
        assert word in err


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x = (", ["SyntaxError", "line 1"]),
        ("import bundle\nimport nowhere_at_all", ["nowhere_at_all", "line 2"]),
        ("raise SystemExit(3)", ["sys.exit"]),
        ("", ["make_graph", "empty"]),
        ("def f(): pass", ["make_graph", "found f"]),
    ],
)
def test_bad_files_are_one_line(run, tmp_path, text, words):
    path = tmp_path / "bad.py"
    path.write_text(text)
    code, _, err = run("check", path, "--quiet")
    assert code == 2
    assert len(err.splitlines()) == 1
    for word in words:
        assert word in err


def test_a_missing_file(run, tmp_path):
    code, _, err = run("check", f"{tmp_path}/none.py:make_graph", "--quiet")
    assert (code, "No such file" in err) == (2, True)


def test_json_names_factor_keys_rows_and_columns(run, factors, tmp_path):
    target = tmp_path / "report.json"
    code, _, _ = run("check", f"{factors}:make_wrong", "--samples", 3, "--json", target, "--quiet")
    assert code == 1
    report = json.loads(target.read_text())
    assert (report["verdict"], report["num_checked"], report["num_factors"]) == ("wrong", 6, 16)
    (found,) = report["findings"]
    assert set(found) >= {"kind", "sentence", "command", "evidence"}
    assert (found["kind"], found["rows"], found["num_wrong"]) == ("sign", [0], 3)
    assert found["columns"] == [f"{key} [0]" for key in found["keys"]]
    assert report["headline"][0].startswith("WRONG")
    code, out, err = run("check", f"{factors}:make_wrong", "--json", "-", "--quiet")
    assert json.loads(out)["ok"] is False
    assert "WRONG" in err


def test_edges_of_a_pose_graph(run, tmp_path):
    path = tmp_path / "ring.g2o"
    angle = 2 * np.pi * np.arange(12) / 12
    poses = np.column_stack([np.cos(angle), np.sin(angle), angle])
    edges = [(k, (k + 1) % 12) for k in range(12)]
    graph = bundle.PoseGraph(
        poses=poses,
        edges=edges,
        measurements=np.tile([0.5, 0.1, 0.5], (12, 1)),
        information=np.tile(np.eye(3), (12, 1, 1)),
    )
    bundle.save(graph, path)
    code, out, _ = run("check", path, "--samples", 5, "--error", "g2o", "--quiet", "--verbose")
    assert code == 0
    assert table(out)["edge, closure"][:2] == ["correct", table(out)["edge, closure"][1]]
    assert "6 checked factors of 12" in out
    assert run("check", path, "--loss", "huber")[0] == 2
