"""Headline and findings of comparisons with known times, costs, minima and loads."""

import dataclasses
import shlex

import numpy as np
import pytest

from bundle.base.tables import render
from bundle.interface.options import SolveOptions
from bundle.planning.comparison.recommendation import recommend
from bundle.reports.terminal.compare import compared
from bundle.reports.terminal.compare_verdict import findings, headline, sigmas
from bundle.reports.terminal.screen import laid_out
from tests.planning.comparison.fakes import (
    CERES,
    DENSE,
    ENVIRONMENT,
    ITERATIVE,
    SPARSE,
    comparison,
    done,
    failed,
    measurement,
)
from tests.printed import figures


def judged(*runs, **changes):
    made = comparison(*runs, **changes)
    return dataclasses.replace(made, recommendation=recommend(made))


def at(run, minimum, distance):
    return dataclasses.replace(run, minimum=minimum, distance_in_sigmas=distance)


def kinds(made):
    return [finding.kind for finding in findings(made)]


def commands_of(made):
    return [section.command for section in compared(made).sections if section.command]


def repeated(method, *totals):
    return dataclasses.replace(
        done(method), measurements=tuple(measurement(total) for total in totals)
    )


def test_recommendation_leads_with_its_spread_and_its_ties():
    made = judged(
        repeated(DENSE, 1.0, 1.1, 1.2), repeated(SPARSE, 1.15, 1.3, 1.4), repeated(CERES, 2, 3, 4)
    )
    first = headline(made)[0]
    assert figures(first) == ["1.1", "1", "1.2", "3"]
    assert first.startswith("Recommended: fused DENSE_SCHUR") and "fused SPARSE_SCHUR" in first
    assert "ceres" not in first
    assert kinds(made) == []


def test_start_at_its_minimum_is_said_first_with_the_command():
    def flat(method, start):
        costs = {**measurement().iterations, "cost": np.array([start, 100, 100, 100.0])}
        return dataclasses.replace(done(method), measurements=(measurement(iterations=costs),))

    made = judged(flat(DENSE, 100.05), flat(CERES, 100.05), options=SolveOptions(loss="huber"))
    assert headline(made)[0] == (
        "The input is at its minimum; compare from a perturbed start with --perturb."
    )
    (finding,) = findings(made)
    assert finding.kind == "at-minimum"
    assert finding.evidence["start_gap"] == pytest.approx(5e-4)
    words = shlex.split(finding.command)
    assert words[:5] == ["bundle", "compare", "scene 0.txt", "--perturb", "0.001"]
    assert words[-2:] == ["--loss", "huber"]
    assert kinds(judged(flat(DENSE, 100.2))) == []
    perturbed = judged(flat(DENSE, 100.05), perturb=1e-4)
    assert "--perturb 0.0001" in headline(perturbed)[0]
    assert "--perturb 0.001" in findings(perturbed)[0].command


def test_several_minima_are_grouped_and_none_is_recommended():
    made = judged(
        at(done(DENSE, 1.0, 100.0), 0, 0.0),
        at(done(SPARSE, 0.1, 100.05), 1, 7.5),
        at(done(ITERATIVE, 3.0, 100.05), 1, 7.5),
        at(done(CERES, 2.0, 100.0), 0, 0.01),
    )
    assert made.recommendation is None
    assert [[run.method for run in runs] for runs in made.minima(0)] == [
        [DENSE, CERES], [SPARSE, ITERATIVE],
    ]  # fmt: skip
    (first,) = headline(made)
    assert figures(first) == ["2"] and "no method is recommended" in first
    text = render(*laid_out(compared(made)), width=100)
    rows = [line.split() for line in text.splitlines()]
    assert ["1", "fused", "DENSE_SCHUR", "1.000", "2", "100", "0"] in rows
    assert ["2", "fused", "SPARSE_SCHUR", "0.100", "2", "100.05", "7.5"] in rows
    report = compared(made).json()
    assert [run["minimum"] for run in report["runs"]] == [0, 1, 1, 0]
    assert report["recommendation"] is None and report["headline"] == [first]


def test_one_minimum_names_the_largest_distance():
    made = judged(at(done(DENSE), 0, 0.0), at(done(CERES, 2.0), 0, 0.25), failed(SPARSE))
    assert figures(headline(made)[1]) == ["2", "0.25"]
    lost = judged(at(done(DENSE), 0, 0.0), at(done(CERES, 2.0, 150.0), -1, 90.0))
    assert "did not converge" in headline(lost)[-1] and figures(headline(lost)[-1]) == ["1"]
    flipped = dataclasses.replace(at(done(CERES, 2.0), 0, 0.25), num_points_elsewhere=3)
    assert figures(headline(judged(at(done(DENSE), 0, 0.0), flipped))[1]) == ["2", "0.25", "3"]
    assert lost.recommendation.method == DENSE


def test_a_method_at_an_unknown_minimum_is_not_recommended():
    made = judged(at(done(DENSE, 5.0), 0, 0.0), at(done(CERES, 1.0, 100.01), -1, 90.0))
    assert made.recommendation.method == DENSE


def test_an_early_stop_is_a_finding():
    made = judged(at(done(DENSE, 1.0, 100.05), 0, 31.0), at(done(CERES, 2.0), 0, 0.0))
    (finding,) = findings(made)
    assert finding.kind == "early-stop" and figures(finding.sentence)[0] == "31"
    assert "--function-tolerance 1e-08" in finding.command


def test_an_unfinished_solve_is_a_finding():
    stopped = dataclasses.replace(measurement().summary, termination_type="NO_CONVERGENCE")
    run = dataclasses.replace(done(DENSE), measurements=(measurement(summary=stopped),))
    made = judged(run)
    (finding,) = findings(made)
    assert finding.kind == "not-converged" and finding.evidence == {"num_steps": 3}
    assert "No recommendation" in headline(made)[0] and "--max-iterations" in headline(made)[0]
    assert commands_of(made) == []


def test_a_busy_machine_is_a_finding():
    busy = dataclasses.replace(ENVIRONMENT, load_before=5.2)
    made = judged(done(DENSE), environment=busy)
    (finding,) = findings(made)
    assert finding.kind == "busy-machine" and figures(finding.sentence) == ["5.2", "2", "2"]
    assert "No recommendation" in headline(made)[0] and "fused DENSE_SCHUR" in headline(made)[0]
    assert commands_of(made) == []
    assert commands_of(judged(done(DENSE))) == [made.recommendation.command]


def test_problems_with_several_minima_do_not_decide():
    runs = [
        at(done(DENSE, 1.0), 0, 0.0), at(done(CERES, 2.0), 0, 0.0),
        at(done(DENSE, 9.0, problem=1), 0, 0.0), at(done(CERES, 1.0, problem=1), 1, 5.0),
    ]  # fmt: skip
    made = judged(*runs)
    assert made.recommendation.method == DENSE
    assert "scene 1.txt" in headline(made)[-1]


def test_nothing_usable():
    made = judged(failed(DENSE))
    assert headline(made) == ["No method has a usable solution."]
    assert findings(made) == []


@pytest.mark.parametrize(
    ("distance", "text"),
    [(0.0, "0"), (1e-6, "<0.01"), (0.123, "0.12"), (31.4, "31"), (5e9, "5e+09")],
)
def test_sigmas(distance, text):
    assert sigmas(distance) == text
    assert sigmas(float("nan")) == "-"
