from __future__ import annotations

import math

import pytest
from benchmarks.measure import Spread

from benchmarks import rows


def outcome(**changes):
    return {
        "build": 0.1,
        "solve": 0.9,
        "minimizer": 0.8,
        "num_steps": 4,
        "trace": [[0.1, 300.0], [0.5, 100.0005], [0.8, 100.0]],
        "final_cost": 100.0,
        "verified_cost": 100.0,
        "peak_memory": 1_000_000,
        "notes": ["DENSE_SCHUR", ""],
        **changes,
    }


def run(failure="", **changes):
    measured = None if failure else outcome(**changes)
    return {"failure": failure, "wall": 2.0, "cpu": 3.0, "outcome": measured}


def test_a_row_is_arithmetic_on_its_runs():
    row = rows.row("p", "s", [run(), run(minimizer=1.6, solve=1.9), run()], 100.0)
    assert row.step == Spread(0.2, 0.2, 0.4)
    assert row.total == Spread(1.0, 1.0, 2.0)
    assert row.reached == (Spread(0.5, 0.5, 0.5), Spread(0.5, 0.5, 0.5))
    assert (row.gap, row.cores, row.used) == (0.0, 1.5, "DENSE_SCHUR")
    assert (row.failure, row.remark, row.doubt) == ("", "", "")


def test_gaps_are_relative_to_the_best_known_cost():
    row = rows.row("p", "s", [run()], 99.99)
    assert row.reached == (Spread(0.5, 0.5, 0.5), None)
    assert row.gap == pytest.approx(1e-4, rel=1e-3)


def test_a_solver_that_always_fails_says_why():
    row = rows.row("p", "s", [run("out of memory"), run("out of memory")], 100.0)
    assert row.failure == "out of memory"
    assert row.step is None


def test_a_repeat_that_fails_is_remarked():
    row = rows.row("p", "s", [run(), run("too slow")], 100.0)
    assert row.failure == ""
    assert row.remark == "1 of 2 runs: too slow"


def test_no_step_has_no_time():
    assert rows.row("p", "s", [run(num_steps=0)], 100.0).step is None


def test_a_cost_that_the_evaluation_denies_is_doubted_and_sets_no_mark():
    liar = run(final_cost=50.0, verified_cost=120.0)
    assert "says a final cost of 5.0" in rows.row("p", "s", [liar], 100.0).doubt
    assert rows.best_known_cost([liar, run()]) == 100.0
    assert math.isnan(rows.best_known_cost([run("broken")]))
