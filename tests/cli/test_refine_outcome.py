"""Arguments of the tests of a result in `bundle refine`, and the order of what they find."""

from types import SimpleNamespace

import numpy as np
import pytest

from bundle.cli import refine_outcome
from bundle.interface.finding import Finding

PROBLEM, OPTIONS = object(), SimpleNamespace(max_num_iterations=10, refine=("poses",))


def judged(monkeypatch, *, end="CONVERGENCE", steps=5, usable=True, sliced=None, inertial=None):
    """Return the kinds of the findings, and what ``find`` was given."""
    given = {}

    def find(problem, **more):
        given.update(more, problem=problem)
        return (Finding(kind="found", sentence=""),)

    broken = Finding(kind="broken", sentence="")
    monkeypatch.setattr(refine_outcome, "find", find)
    monkeypatch.setattr(refine_outcome, "broken_parts", lambda _: (broken,))
    asked = SimpleNamespace(source="IN", target="OUT", given=("--a", "1"), constraints=("rule",))
    opened = SimpleNamespace(
        sliced=sliced, known=SimpleNamespace(priors=("prior",)), problem=PROBLEM, options=OPTIONS
    )
    solved = SimpleNamespace(
        problem=PROBLEM, options=OPTIONS, rounds=("first", "second"), survey_checks="survey",
        summary=SimpleNamespace(termination_type=end, is_solution_usable=usable),
        reprojection_error_before=SimpleNamespace(rmse=1.0),
        iterations={"cost": np.zeros(steps + 1)},
    )  # fmt: skip
    found = refine_outcome.judge(asked, opened, solved, inertial)
    return [one.kind for one in found], given, found


def test_the_tests_are_given_the_run(monkeypatch):
    kinds, given, _ = judged(monkeypatch)
    assert kinds == ["broken", "found"]
    assert given == {
        "problem": PROBLEM, "source": "IN", "target": "OUT", "given": ("--a", "1"),
        "options": OPTIONS, "rounds": 2, "priors": ("prior",), "survey": "survey",
        "constraints": ("rule",), "is_minimum": True,
    }  # fmt: skip


def test_an_end_by_the_limit_is_no_minimum(monkeypatch):
    kinds, given, found = judged(monkeypatch, end="NO_CONVERGENCE", steps=10)
    assert kinds == ["not_converged", "broken", "found"] and given["is_minimum"] is False
    assert found[0].command == "bundle refine IN -o OUT --a 1 --max-iterations 40"
    assert judged(monkeypatch, end="NO_CONVERGENCE", steps=9)[0] == ["broken", "found"]


def test_an_imu_comes_first_and_is_a_prior(monkeypatch):
    one = Finding(kind="imu_noise", sentence="")
    moved = SimpleNamespace(
        kind=one.kind, sentence="", flags=("--b",), evidence={}, is_problem=False
    )
    inertial = SimpleNamespace(findings=(moved,))
    kinds, given, found = judged(monkeypatch, end="NO_CONVERGENCE", steps=10, inertial=inertial)
    assert kinds == ["imu_noise", "not_converged", "broken", "found"]
    assert found[0].command == "bundle refine IN -o OUT --a 1 --b"
    assert given["priors"] == (inertial, "prior")


@pytest.mark.parametrize("state", [{"usable": False}, {"sliced": object()}])
def test_results_that_cannot_be_judged(monkeypatch, state):
    kinds, given, _ = judged(monkeypatch, **state)
    assert kinds == [] and given == {}
