"""The same pose graph by several methods: rows, what is recommended, what is refused."""

import json

import numpy as np
import pytest

import bundle
from bundle.planning.comparison import graph_comparison
from bundle.planning.comparison.graph_comparison import GraphRun, recommend_run
from tests.graphs.pose_graphs import graphs


@pytest.fixture(scope="module")
def compared():
    return bundle.compare(graphs.loop(2), repeat=1, threads=[1])


def test_every_method_is_measured_from_one_start(compared):
    names = [run.method.name for run in compared.runs]
    assert len(names) == len(set(names)) == 10
    assert {"fused amd gauss-newton", "fused natural gauss-newton", "ceres dogleg"} <= set(names)
    expected = bundle.solve(graphs.loop(2)).summary.final_cost
    for run in compared.runs:
        assert not run.failure and run.time_in_seconds > 0 and run.num_steps > 0
        np.testing.assert_allclose(run.final_cost, expected, rtol=1e-8)
        assert 0 <= compared.gap(run) < 1e-8
    assert compared.recommended in [run.method for run in compared.runs]
    assert compared.command.startswith("bundle refine INPUT -o OUTPUT")


def test_the_first_of_the_fast_ones_that_came_low_is_recommended():
    def run(name, seconds, cost, failure=""):
        method = graph_comparison.GraphMethod(
            backend="fused", trust_region_strategy_type=name, ordering="amd", num_threads=1
        )
        return GraphRun(
            method=method,
            times_in_seconds=(seconds,),
            final_cost=cost,
            chi2_final=2 * cost,
            num_steps=1,
            termination_type="CONVERGENCE",
            failure=failure,
        )

    runs = [
        run("a", 0.01, 2.0),
        run("b", 1.1, 1.0),
        run("c", 1.0, 1.0 + 1e-8),
        run("d", 0.1, np.nan, "x"),
    ]
    best, reason = recommend_run(runs)
    assert best is runs[1] and "1 method ended at a higher cost" in reason
    runs[1] = run("b", 1.3, 1.0)
    assert recommend_run(runs)[0] is runs[2]
    best, reason = recommend_run([run("d", 0.1, np.nan, "x")])
    assert best is None and "diagnose" in reason


def test_a_method_that_takes_too_long_is_a_row():
    found = bundle.compare(graphs.loop(2), backends="fused", threads=[1], timeout=1e-9, repeat=1)
    assert {run.termination_type for run in found.runs} == {"TIMEOUT"}
    assert found.recommended is None and found.command == ""


def test_losses_that_ceres_lacks_leave_it_out():
    found = bundle.compare(graphs.loop(2), loss="dcs", repeat=1, threads=[1])
    assert {run.method.backend for run in found.runs} == {"fused"}
    assert "--loss dcs" in found.command
    with pytest.raises(bundle.InputError, match=r"^backends: "):
        bundle.compare(graphs.loop(2), loss="dcs", backends=["ceres"])


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"backends": ["x"]}, "backends"),
        ({"backends": 3}, "backends"),
        ({"threads": []}, "threads"),
        ({"repeat": 0}, "repeat"),
        ({"timeout": 0}, "timeout"),
        ({"solvers": ["dense_schur"]}, "solvers"),
        ({"memory_cap": 10}, "memory_cap"),
        ({"ordering": "amd"}, "ordering"),
        ({"options": bundle.SolveOptions()}, "options"),
    ],
)
def test_wrong_arguments(arguments, name):
    with pytest.raises(bundle.InputError, match=rf"^{name}: "):
        bundle.compare(graphs.loop(2), **arguments)


def test_the_command(tmp_path, capsys):
    from bundle.cli.main import main

    source = tmp_path / "x.g2o"
    bundle.save(graphs.loop(3, num_poses=6, num_closures=3), source)
    words = ["compare", str(source), "--quiet", "--repeat", "1", "--threads", "1"]
    assert main([*words, "--json", str(tmp_path / "r.json"), "--loss", "huber"]) == 0
    said = capsys.readouterr().out
    assert "ceres gauss-newton" in said and "advice" in said
    found = json.loads((tmp_path / "r.json").read_text())
    assert found["command"] == "compare" and len(found["runs"]) == 10
    assert found["environment"]["cpu_model"] and found["environment"]["load_after"] is not None
    assert found["recommendation"]["command"].startswith(f"bundle refine {source}")
    for flags in (
        ["--solvers", "dense-schur"],
        ["--trust-regions", "dogleg"],
        ["--perturb", "0.01"],
        ["--memory-cap", "1GB"],
    ):
        assert main([*words, *flags]) == 2
        assert capsys.readouterr().err.startswith(f"error: {flags[0]}: ")
    assert main([*words[:2], str(source), *words[2:]]) == 2
    assert "one INPUT" in capsys.readouterr().err


def test_information_of_zero_has_nothing_to_compare(tmp_path, capsys):
    from bundle.cli.main import main

    graph = graphs.loop(2)
    bundle.save(graph.replace(information=0 * graph.information), tmp_path / "x.g2o")
    assert main(["compare", str(tmp_path / "x.g2o"), "--quiet"]) == 2
    said = capsys.readouterr()
    assert not said.out and "information" in said.err and said.err.count("\n") == 1
    with pytest.raises(bundle.InputError, match=r"^graph: expected information"):
        bundle.compare(graph.replace(information=0 * graph.information))
    one = graph.information.copy()
    one[1:] = 0
    assert bundle.compare(graph.replace(information=one), repeat=1).recommended is not None
