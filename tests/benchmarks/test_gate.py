"""The gate of speed, on made runs."""

import pytest

from benchmarks import gate


def run(problem, solver, minimizer, failure=""):
    outcome = {
        "build": 0.1, "solve": 0.9, "minimizer": minimizer, "num_steps": 4,
        "trace": [[0.1, 300.0], [0.8, 100.0]], "final_cost": 100.0, "verified_cost": 100.0,
        "peak_memory": 1_000_000, "notes": [],
    }  # fmt: skip
    measured = None if failure else outcome
    fields = {"problem": problem, "solver": solver, "failure": failure}
    return {**fields, "wall": 1.0, "cpu": 1.0, "outcome": measured}


def test_a_lead_is_the_ratio_of_median_steps():
    runs = [run("a", gate.OURS, t) for t in (1.0, 9.0, 1.0)]
    runs += [run("a", gate.THEIRS, t) for t in (8.0, 2.0, 20.0)]
    runs += [run("b", gate.OURS, 1.0), run("b", gate.THEIRS, 1.0, failure="not installed")]
    assert gate.leads_of(runs) == {"a": pytest.approx(8.0)}


def test_only_leads_that_fell_by_more_than_the_limit_are_named():
    recorded = {"a": 10.0, "b": 10.0, "gone": 10.0}
    found = {"a": 10.0 * (1 - gate.SLOWER) - 0.1, "b": 10.0 * (1 - gate.SLOWER) + 0.1, "new": 1.0}
    assert gate.slower(found, recorded) == ["a"]
