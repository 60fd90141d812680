"""Arguments of the tests of a result in `bundle refine`, and the order of what they find."""

from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest

from bundle.checking import gradient_report, jacobians
from bundle.cli import refine
from bundle.cli import run as runs
from bundle.cli.commands import COMMANDS
from bundle.cli.main import command_parser
from bundle.cli.output import Progress
from bundle.cli.refinement import Refinement
from bundle.georeference import similarity as similarities
from bundle.interface.finding import Finding
from bundle.interface.options import SolveOptions
from bundle.io.recognition import Kind
from bundle.judging.findings import find as finding
from bundle.judging.findings.next_command import NextCommand
from bundle.reports.terminal import analyses

PROBLEM, START = SimpleNamespace(image_ids=np.array([7, 8])), object()
OPTIONS = SimpleNamespace(
    max_num_iterations=10, refine=("poses",), initial_trust_region_radius=1e4, fixed_image_ids=(7,)
)
PRIOR = SimpleNamespace(image="a.jpg")
RULE = SimpleNamespace(target=SimpleNamespace(kind="camera"))


def opened(sliced=None):
    """Return a refinement after INPUT was read."""
    words = command_parser().parse_args(["refine", "IN", "-o", "OUT"])
    progress = Progress(quiet=True)
    run = Refinement(COMMANDS["refine"], Kind.RECONSTRUCTION, words, progress, "IN")
    run.sliced, run.problem, run.options = sliced, PROBLEM, OPTIONS
    return run


def judged(
    monkeypatch, *, end="CONVERGENCE", steps=5, usable=True, sliced=None, inertial=None, warned=(),
    rule=RULE, similarity=None, kind="found", advised="",
):  # fmt: skip
    """Return the kinds of the findings, and what ``find`` was given."""
    given = {}

    def find(problem, **more):
        given.update(more, problem=problem)
        return (Finding(kind=kind, sentence="", command=advised),)

    broken = Finding(kind="broken", sentence="")
    monkeypatch.setattr(finding, "find", find)
    monkeypatch.setattr(runs, "repeated_flags", lambda _: ("--a", "1"))
    monkeypatch.setattr("bundle.cli.refinement.repeated_flags", runs.repeated_flags)

    def broken_parts(_, held=()):
        given["held"] = held
        return (broken,)

    monkeypatch.setattr(refine, "broken_parts", broken_parts)
    run = opened(sliced)
    run.known, run.constraints = SimpleNamespace(priors=(PRIOR,)), (rule,)
    run.inertial, run.measured = inertial, ()
    run.found = SimpleNamespace(
        problem=PROBLEM, initial_problem=START, options=OPTIONS, survey_checks="survey", part=None,
        similarity=similarity,
        summary=SimpleNamespace(
            termination_type=end, is_solution_usable=usable, warning_kinds=warned
        ),
        reprojection_error_before=SimpleNamespace(rmse=1.0, median=200.0),
        iterations={"cost": np.zeros(steps + 1)},
    )  # fmt: skip
    found = refine.judge(run)
    return [one.kind for one in found], given, found


def test_the_tests_are_given_the_run(monkeypatch):
    kinds, given, _ = judged(monkeypatch)
    assert kinds == ["broken", "found"]
    assert given == {
        "problem": PROBLEM, "source": "IN", "target": "OUT", "given": ("--a", "1"),
        "options": OPTIONS, "priors": (PRIOR,), "survey": "survey",
        "constraints": (RULE,), "start": START, "is_minimum": True, "held": {7, "a.jpg"},
    }  # fmt: skip


def test_poses_that_rules_or_an_imu_determine_are_not_judged_by_their_observations(monkeypatch):
    of_image = SimpleNamespace(target=SimpleNamespace(kind="image"))
    for known in ({"rule": of_image}, {"inertial": SimpleNamespace(findings=())}):
        assert judged(monkeypatch, **known)[1]["held"] == {7, 8, "a.jpg"}


def test_an_end_by_the_limit_is_no_minimum(monkeypatch):
    kinds, given, found = judged(monkeypatch, end="NO_CONVERGENCE", steps=10)
    assert kinds == ["not_converged", "broken", "found"] and given["is_minimum"] is False
    assert found[0].command == "bundle refine IN -o OUT --a 1 --max-iterations 40"
    assert judged(monkeypatch, end="NO_CONVERGENCE", steps=9)[0] == ["broken", "found"]


@pytest.mark.parametrize(
    ("kind", "flags"), [("undetermined_intrinsics", " --b 2"), ("shared_lens", "")]
)
def test_more_steps_have_the_prior_of_what_is_not_determined(monkeypatch, kind, flags):
    advised = "bundle refine IN -o OUT --b 2"
    more = {"end": "NO_CONVERGENCE", "steps": 10, "kind": kind, "advised": advised}
    found = judged(monkeypatch, **more)[2]
    assert found[0].command == f"bundle refine IN -o OUT --a 1{flags} --max-iterations 40"


def test_an_imu_comes_first_and_is_a_prior(monkeypatch):
    one = Finding(kind="imu_noise", sentence="")
    moved = SimpleNamespace(
        kind=one.kind, sentence="", flags=("--b",), evidence={}, is_problem=False
    )
    inertial = SimpleNamespace(findings=(moved,))
    kinds, given, found = judged(monkeypatch, end="NO_CONVERGENCE", steps=10, inertial=inertial)
    assert kinds == ["imu_noise", "not_converged", "broken", "found"]
    assert found[0].command == "bundle refine IN -o OUT --a 1 --b"
    assert given["priors"] == (inertial, PRIOR)


def test_a_result_in_slices_is_not_judged(monkeypatch):
    kinds, given, _ = judged(monkeypatch, sliced=object())
    assert kinds == [] and given == {}


@pytest.mark.parametrize("is_far", [True, False])
def test_a_result_without_use_has_findings_about_its_start(monkeypatch, is_far):
    seen = []

    def of_start(measured):
        seen.append(measured)
        return Finding(kind="positions", sentence="") if is_far else None

    monkeypatch.setattr(refine, "positions_of_start", of_start)
    kinds, given, _ = judged(monkeypatch, usable=False)
    assert kinds == ["positions"] * is_far and given == {}
    warned = ("observations_behind", "too_many_behind")
    assert judged(monkeypatch, usable=False, warned=warned)[0] == (
        ["positions"] if is_far else ["far_start"]
    )
    seen = seen[:1]
    (start,) = seen
    assert (start.whole, start.options, start.priors) == (START, OPTIONS, (PRIOR,))
    assert start.command.given == ("--a", "1")


@pytest.mark.parametrize("usable", [True, False])
def test_the_start_is_the_input_moved_to_its_positions(monkeypatch, usable):
    seen = []
    monkeypatch.setattr(similarities, "moved", lambda *moved: moved)
    monkeypatch.setattr(refine, "positions_of_start", lambda one: seen.append(one.whole))
    _, given, _ = judged(monkeypatch, usable=usable, similarity="s")
    assert (given["start"] if usable else seen[0]) == (START, "s")


@pytest.mark.parametrize(
    ("radius", "advised"), [(1e4, "1"), (1.01, "1"), (1.0, "0.01"), (0.02, "0.01"), (0.01, "")]
)
@pytest.mark.parametrize("kind", ["too_many_behind", "invalid_solution"])
def test_steps_from_a_far_start_become_shorter(radius, advised, kind):
    solved = SimpleNamespace(
        options=SimpleNamespace(initial_trust_region_radius=radius),
        reprojection_error_before=SimpleNamespace(median=200.0),
        summary=SimpleNamespace(warning_kinds=("far_origin", kind)),
    )
    command = NextCommand("IN", "OUT", ("--initial-trust-region-radius", "7", "--loss", "tukey"))
    found = refine.far_start(solved, command)
    flags = f" --loss tukey --initial-trust-region-radius {advised}"
    assert found.command == (f"bundle refine IN -o OUT{flags}" if advised else "")
    assert found.is_problem and found.evidence == {"median": 200.0, "radius": radius}


def test_a_solve_that_failed_otherwise_has_no_far_start():
    summary = SimpleNamespace(warning_kinds=("no_projection", "observations_behind"))
    solved = SimpleNamespace(
        options=OPTIONS, reprojection_error_before=SimpleNamespace(median=2.0), summary=summary
    )
    assert refine.far_start(solved, NextCommand()) is None


@pytest.mark.parametrize("verdict", ["wrong", "undecided"])
def test_wrong_jacobians_replace_the_solve(monkeypatch, capsys, verdict):
    found, run = SimpleNamespace(verdict=verdict, ok=False), opened()
    run.options = SolveOptions(num_threads=3)
    monkeypatch.setattr(jacobians, "check_problem", lambda *_, **__: found)
    monkeypatch.setattr(gradient_report, "outcome", lambda _: "The verdict.")
    monkeypatch.setattr(analyses, "checked", lambda *told: told)
    told = refine._wrong_jacobians(run)
    if verdict == "undecided":
        assert told is None and (run.code, run.complaint) == (0, "")
        assert capsys.readouterr().err.startswith("note: The verdict. `bundle check`")
        return
    assert told[:3] == ("IN", PROBLEM, found)
    assert told[3]["check_gradients"] is True and told[3]["num_threads"] == 3
    assert (run.code, run.complaint) == (1, "The verdict.")


@pytest.mark.parametrize(("sliced", "imu"), [(object(), None), (None, object())])
def test_a_dry_run_does_not_predict_slices_and_an_imu(monkeypatch, sliced, imu):
    run = opened(sliced)
    run.imu = imu
    monkeypatch.setattr(run, "check", lambda: None)
    monkeypatch.setattr(refine, "on_disk", lambda _: nullcontext())
    monkeypatch.setattr(refine, "open_input", lambda _: None)
    assert refine.plan(run) == ["The cost of this kind of run is not predicted."]
