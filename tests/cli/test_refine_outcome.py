"""Judgement of a refinement by what was solved: options, limits, rounds, rules, flags, survey."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

import bundle
from bundle.cli import refine_outcome
from bundle.interface.finding import Finding
from tests.scenes import make_problem

GIVEN = ("--loss", "cauchy", "--max-iterations", "5")
RULES = ("camera 1: f fixed",)


@pytest.fixture(scope="module")
def solved():
    return bundle.solve(make_problem(num_images=5, num_points=60), loss="cauchy", num_threads=1)


def judged(monkeypatch, solved, *, inertial=None, sliced=None, priors=(), **summary):
    """Return what `find` was given, and the findings."""
    seen = []
    later = Finding(kind="later", sentence="Later.")
    monkeypatch.setattr(
        refine_outcome, "find", lambda *given, **named: seen.append((given, named)) or (later,)
    )
    solved = dataclasses.replace(solved, summary=dataclasses.replace(solved.summary, **summary))
    vars(solved)["survey_checks"] = "survey"  # computed once
    asked = SimpleNamespace(source="M", target="OUT", given=GIVEN, constraints=RULES)
    known = SimpleNamespace(priors=priors) if priors else None
    opened = SimpleNamespace(
        problem=solved.initial_problem, options=solved.options, known=known, sliced=sliced
    )
    return seen, refine_outcome.judge(asked, opened, solved, inertial)


@pytest.mark.parametrize("end", ["CONVERGENCE", "NO_CONVERGENCE"])
def test_the_result_is_judged_as_it_was_solved(monkeypatch, solved, end):
    prior = object()
    solved = dataclasses.replace(solved, rounds=(1, 2))
    (((problem,), named),), _ = judged(monkeypatch, solved, priors=(prior,), termination_type=end)
    assert problem is solved.problem
    assert named == {
        "source": "M",
        "target": "OUT",
        "given": GIVEN,
        "options": solved.options,
        "rounds": 2,
        "priors": (prior,),
        "survey": "survey",
        "constraints": RULES,
        "is_minimum": end == "CONVERGENCE",
    }


def test_findings_of_an_imu_come_first_with_their_commands(monkeypatch, solved):
    findings = [
        SimpleNamespace(kind=kind, sentence="S.", flags=flags, evidence={"t": 1}, is_problem=bad)
        for kind, flags, bad in (("clock", ("--loss", "huber"), True), ("bias", (), False))
    ]
    inertial = SimpleNamespace(findings=findings)
    seen, found = judged(monkeypatch, solved, inertial=inertial)
    assert seen[0][1]["priors"] == (inertial,)
    assert [one.kind for one in found] == ["clock", "bias", "later"]
    assert found[0].command == "bundle refine M -o OUT --max-iterations 5 --loss huber"
    assert (found[0].evidence, found[0].is_problem) == ({"t": 1}, True)
    assert (found[1].command, found[1].is_problem) == ("", False)


@pytest.mark.parametrize("change", [{"is_solution_usable": False}, {"sliced": object()}])
def test_unusable_results_and_slices_are_not_judged(monkeypatch, solved, change):
    seen, found = judged(monkeypatch, solved, **change)
    assert (seen, found) == ([], ())


@pytest.mark.parametrize(
    ("most", "steps", "end", "is_found"),
    [
        (5, 5, "NO_CONVERGENCE", True),
        (5, 4, "NO_CONVERGENCE", False),  # by its time or by Ctrl-C
        (5, 5, "CONVERGENCE", False),
        (0, 0, "NO_CONVERGENCE", False),
    ],
)
def test_a_solve_at_its_limit_is_given_four_times_its_steps(solved, most, steps, end, is_found):
    ended = dataclasses.replace(
        solved,
        options=solved.options.replace(max_num_iterations=most),
        iterations={"cost": np.zeros(steps + 1)},
        summary=dataclasses.replace(solved.summary, termination_type=end),
    )
    command = refine_outcome.NextCommand("M", "OUT", GIVEN)
    found = refine_outcome.not_converged(ended, command)
    assert bool(found) == is_found
    if is_found:
        assert found[0].command == "bundle refine M -o OUT --loss cauchy --max-iterations 20"
        assert found[0].evidence == {"max_num_iterations": 5}
