from __future__ import annotations

import math

import pytest
from benchmarks.results import Results

from benchmarks import agreement, targets


def run(solver, costs, notes=("CERES", "SPARSE_SCHUR"), problem="p"):
    outcome = {
        "build": 0.0,
        "solve": 1.0,
        "minimizer": 1.0,
        "num_steps": len(costs) - 1,
        "trace": [[float(i), cost] for i, cost in enumerate(costs)],
        "final_cost": costs[-1],
        "verified_cost": costs[-1],
        "peak_memory": 1,
        "notes": list(notes),
        "size": {},
    }
    return {
        "problem": problem,
        "solver": solver,
        "rule": "default",
        "threads": 2,
        "failure": "",
        "wall": 1.0,
        "cpu": 1.0,
        "outcome": outcome,
    }


def results(*runs):
    return Results(
        machine={},
        command="",
        settings={"threads": 2},
        kinds={run["problem"]: "bal" for run in runs},
        runs=list(runs),
        whole={},
    )


OURS = [100.0, 10.0, 1.0]


def test_the_worst_of_the_first_steps_counts():
    late = [50.0] * (agreement.FIRST + 1)
    measured = results(
        run("bundle fused sparse-schur", OURS, ("FUSED", "SPARSE_SCHUR")),
        run("bundle ceres sparse-schur", [100.0, 10.0 * (1 + 1e-6), 1.0]),
        run("bundle fused dense-schur", [*late, 3.0], ("FUSED", "DENSE_SCHUR"), "q"),
        run("bundle ceres dense-schur", [*late, 2.0], ("CERES", "DENSE_SCHUR"), "q"),
    )
    found = agreement.found(measured)
    off = pytest.approx(1e-6, rel=1e-4)
    assert dict(found.first) == {"p sparse-schur": off, "q dense-schur": 0.0}
    assert dict(found.final) == {"p sparse-schur": 0.0, "q dense-schur": pytest.approx(0.5)}
    first, final = (goal for goal in targets.of(measured) if "fused / ceres" in goal.what)
    assert "(p sparse-schur)" in first.what and not first.met
    assert "(q dense-schur)" in final.what and not final.met


def test_another_number_of_steps_is_no_agreement():
    found = agreement.found(
        results(
            run("bundle fused sparse-schur", OURS, ("FUSED", "SPARSE_SCHUR")),
            run("bundle ceres sparse-schur", OURS[:2]),
        )
    )
    assert math.isinf(found.final[0][1])


def test_ceres_auto_stands_in_if_it_took_the_same_solver():
    ours = run("bundle fused sparse-schur", OURS, ("FUSED", "SPARSE_SCHUR"))
    auto = run("bundle ceres auto", OURS)
    assert agreement.found(results(ours, auto)).first == [("p sparse-schur", 0.0)]
    other = run("bundle ceres auto", OURS, ("CERES", "DENSE_SCHUR"))
    assert agreement.found(results(ours, other)).first == []
    assert not [goal for goal in targets.of(results(ours, other)) if "fused / ceres" in goal.what]
