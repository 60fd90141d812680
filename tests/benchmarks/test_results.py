"""Results of several runs of the benchmark as one."""

from __future__ import annotations

from typing import Any

from benchmarks.results import Results


def measured(command: str, cost: float, *names: str, **tables: Any) -> Results:
    return Results(
        machine={"date": command, "load before": f"{cost}"},
        command=command,
        settings={"threads": 2},
        kinds=dict.fromkeys(names, "bal"),
        runs=[
            {"problem": name, "cost": cost, "rule": "default", "threads": 2, "solver": command}
            for name in names
        ],
        whole={name: {"bundle": [{"wall": cost}]} for name in names},
        **tables,
    )


def test_later_runs_replace_those_of_the_same_problem() -> None:
    graphs = {"intel": {"bundle": [{"total": 1.0}]}}
    first = measured("first", 1.0, "a", "b", pose_graphs=graphs)
    both = first.followed_by(measured("second", 2.0, "b", "c"))
    assert {run["problem"]: run["cost"] for run in both.runs} == {"a": 1.0, "b": 2.0, "c": 2.0}
    assert len(both.runs) == 3
    assert list(both.kinds) == ["a", "b", "c"]
    assert [both.whole[name]["bundle"][0]["wall"] for name in "abc"] == [1.0, 2.0, 2.0]
    assert both.pose_graphs == graphs
    assert ("first" in both.command, "second" in both.command) == (True, True)
    assert both.machine == {"date": "second", "load before": "1.0, 2.0"}
    assert (both.tried("a", "first"), both.tried("b", "first")) == (True, False)
