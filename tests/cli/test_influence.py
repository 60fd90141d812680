"""`bundle influence`: its answer, its JSON, and what it refuses."""

import json

import pytest

import bundle
from tests.scenes import make_problem


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "model"
    path.mkdir()
    problem = make_problem(num_points=60, shared=True, perturbation=1e-3)
    bundle.save(bundle.solve(problem).problem, path)
    return path


@pytest.mark.parametrize("without", ["observations", "points", "images"])
def test_the_answer_is_short_and_in_the_json(run, model, tmp_path, without):
    report = tmp_path / "report.json"
    on = "distance 3 9 / baseline 1 5"
    flags = ("--on", on, "--without", without, "--json", report, "--quiet")
    done = run("influence", model, *flags)
    assert (done.code, done.err) == (0, "")
    assert len(done.out.strip().splitlines()) <= 6
    found = json.loads(report.read_text())
    expected = bundle.influence(model, on, without=without)
    assert found["value"] == pytest.approx(expected.value)
    assert found["sigma"] == pytest.approx(expected.sigma)
    assert found["hangs_on"] == expected.hangs_on and found["without"] == without
    assert [one["what"] for one in found["changes"]] == [one.what for one in expected.changes]
    assert len(found["changes"]) <= 20 and len(found["headline"]) <= 4
    long = run("influence", model, *flags, "--verbose")
    assert expected.changes[-1].what in " ".join(long.out.split())


def test_rules_are_a_datum(run, model):
    refused = run("influence", model, "--on", "distance 3 9", "--quiet")
    assert refused.code == 2 and "scale" in refused.err
    rules = ("--set", "point 1: position prior sigma 0.01", "--set", "point 2: position fixed")
    done = run("influence", model, "--on", "distance 3 9", *rules, "--quiet")
    assert (done.code, done.err) == (0, "")


@pytest.mark.parametrize(
    "flags",
    [
        (),
        ("--on", ""),
        ("--on", "distance 3 3"),
        ("--on", "distance 3 999"),
        ("--on", "height 3 9"),
        ("--on", "f 1", "--without", "cameras"),
    ],
)
def test_bad_input_is_one_line(run, model, flags):
    done = run("influence", model, "--quiet", *flags)
    assert done.code == 2 and done.out == ""
    assert done.err.startswith("error: ") and done.err.count("\n") == 1
