"""`bundle diagnose`: its report, its JSON, and what it refuses."""

import json

import numpy as np
import pytest

import bundle
from tests.analysis.diagnosis import blocks
from tests.scenes import scene

NAMES = {
    "nullity",
    "expected_nullity",
    "components",
    "weak_modes",
    "points_without_parallax",
    "collapsed",
    "condition_number",
}


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "model"
    path.mkdir()
    bundle.save(blocks.flat_scene(0).problem, path)
    return path


def test_report_and_json(run, model, tmp_path):
    report = tmp_path / "report.json"
    done = run("diagnose", model, "--json", report, "--quiet")
    assert (done.code, done.err) == (0, "")
    assert "height" in done.out
    found = json.loads(report.read_text())
    assert found["command"] == "diagnose"
    assert found.keys() >= NAMES
    assert (found["nullity"], found["expected_nullity"], found["ok"]) == (8, 7, False)
    (mode,) = found["weak_modes"]
    assert mode.keys() >= {"sentence", "image_ids", "camera_ids", "eigenvalue"}
    assert (mode["kind"], mode["camera_ids"]) == ("flat_scene", [1])
    (component,) = found["components"]
    assert component["image_ids"] == list(range(1, 8))


def test_json_on_standard_output_stands_alone(run, model):
    done = run("diagnose", model, "--json", "-", "--quiet")
    assert json.loads(done.out)["nullity"] == 8


@pytest.mark.parametrize(
    "flags",
    [
        ("--set", "camera 1: f prior 2 %"),
        ("--set", "cameras *: f,k fixed"),
        ("--refine", "poses,points,extra"),
    ],
)
def test_the_advice_helps(run, model, tmp_path, flags):
    report = tmp_path / "report.json"
    assert run("diagnose", model, "--json", report, "--quiet", *flags).code == 0
    found = json.loads(report.read_text())
    assert (found["nullity"], found["expected_nullity"]) == (7, 7)


@pytest.mark.parametrize(
    "flags",
    [
        ("--fix-images", "99"),
        ("--fix-points", "4000"),
        ("--fix-cameras", "5"),
        ("--set", "camera 9: f fixed"),
        ("--refine", "shape"),
    ],
)
def test_what_does_not_exist_is_one_line(run, model, flags):
    done = run("diagnose", model, "--quiet", *flags)
    assert done.code == 2
    assert done.err.startswith("error: ") and done.err.count("\n") == 1
    assert done.out == ""


def test_nothing_free_is_a_diagnosis(run, model, tmp_path):
    report = tmp_path / "report.json"
    done = run("diagnose", model, "--refine", "points", "--fix-points", "1-80", "--json", report)
    assert done.code == 0
    found = json.loads(report.read_text())
    assert (found["nullity"], found["expected_nullity"]) == (0, 0)
    assert found["condition_number"] is None


def test_no_observations_is_a_diagnosis():
    problem = scene()
    empty = problem.replace(
        observation_image=np.empty(0, int),
        observation_point=np.empty(0, int),
        observation_xy=np.empty((0, 2)),
        observation_keypoint=np.empty(0, int),
    )
    found = bundle.diagnose(empty)
    assert found.nullity == 0
    assert [entry.kind for entry in found.findings if entry.is_problem] == ["no_observations"]
