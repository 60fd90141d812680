"""`bundle diagnose`: its report, its JSON, and what it refuses."""

import json

import numpy as np
import pytest

import bundle
from tests.analysis.diagnosis import blocks
from tests.reports.page.reader import Page
from tests.scenes import make_problem, scene

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


def test_an_error_of_rules_names_their_flag(run, model, tmp_path):
    # Planes without anything that holds the scale are refused, wherever their rules come from.
    rule = (
        f"points {','.join(map(str, bundle.load(model).point_ids[:9]))}: on level plane sigma 0.1"
    )
    (tmp_path / "rules.txt").write_text(rule)
    for flag, value in (("--set", rule), ("--constraints", tmp_path / "rules.txt")):
        done = run("diagnose", model, flag, value, "--quiet")
        assert (done.code, done.out) == (2, "")
        assert done.err.startswith(f"error: {flag}: expected") and done.err.count("\n") == 1


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


@pytest.fixture
def checked_model(tmp_path):
    path = tmp_path / "checked"
    path.mkdir()
    problem = make_problem(num_points=60, shared=True, perturbation=1e-3)
    bundle.save(bundle.solve(problem).problem, path)
    return path


def test_reliability_has_an_answer_entries_and_arrays(run, checked_model, tmp_path):
    report, arrays = tmp_path / "report.json", tmp_path / "r.npz"
    flags = ("--reliability", "--json", report, "-o", arrays, "--quiet")
    done = run("diagnose", checked_model, *flags)
    assert (done.code, done.err) == (0, "")
    found = json.loads(report.read_text())
    assert len(found["headline"]) <= 6 and all(len(line) <= 100 for line in found["headline"])
    entry = found["reliability"]
    expected = bundle.reliability(checked_model)
    assert entry["sum"] == pytest.approx(expected.sum) == pytest.approx(entry["dof"])
    assert entry["num_uncontrolled"] == expected.num_uncontrolled
    assert [one["image_id"] for one in entry["images"]] == [
        image.image_id for image in expected.images
    ]
    assert entry["worst"][0]["observation"] == expected.worst[0].observation
    assert not any(isinstance(one, list) and len(one) > 100 for one in entry.values())
    with np.load(arrays) as saved:
        np.testing.assert_allclose(saved["redundancy"], expected.redundancy)
    long = run("diagnose", checked_model, "--reliability", "--verbose", "--quiet")
    assert "image0.jpg" in long.out
    assert "reliability" in json.loads(run("diagnose", checked_model, "--json", "-").out)


def test_reliability_has_a_page(run, checked_model, tmp_path):
    page = tmp_path / "page.html"
    done = run("diagnose", checked_model, "--reliability", "--html", page, "--quiet")
    assert (done.code, done.err) == (0, "")
    found = bundle.reliability(checked_model)
    text = " ".join(Page(page).words)
    assert "Redundancy over the images" in text and "Errors that would go unnoticed" in text
    for one in found.worst:
        assert f"{one.least_redundancy:.3f}" in text
    assert len(found.worst) == 20
    assert run("diagnose", checked_model, "--html", page, "--quiet").code == 0
    assert "Redundancy over the images" not in " ".join(Page(page).words)


def test_delta0_scales_the_errors(run, checked_model, tmp_path):
    sizes = []
    for flags in ((), ("--delta0", "8.26")):
        report = tmp_path / "report.json"
        assert run("diagnose", checked_model, "--reliability", *flags, "--json", report).code == 0
        worst = json.loads(report.read_text())["reliability"]["worst"]
        sizes.append(worst[0]["minimal_detectable_error"])
    assert sizes[1] == pytest.approx(2 * sizes[0])


def test_the_next_command_does_not_repeat_reliability(run, tmp_path):
    problem = make_problem(num_images=6, num_points=300, shared=True, perturbation=1e-3)
    xy = problem.observation_xy.copy()
    xy[::40] += 80
    path = tmp_path / "wild"
    path.mkdir()
    bundle.save(bundle.solve(problem.replace(observation_xy=xy)).problem, path)
    done = run("diagnose", path, "--reliability", "--delta0", "3", "--quiet", "--json", "-")
    commands = [one["command"] for one in json.loads(done.out)["findings"] if one["command"]]
    assert any("bundle refine" in command for command in commands)
    assert not any("reliability" in command or "delta0" in command for command in commands)


@pytest.mark.parametrize(
    "flags", [("-o", "r.npz"), ("--delta0", "3"), ("--reliability", "--delta0=-1")]
)
def test_reliability_refuses_what_has_no_meaning(run, checked_model, tmp_path, flags, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = run("diagnose", checked_model, "--quiet", *flags)
    assert done.code == 2 and done.out == ""
    assert done.err.startswith("error: ") and done.err.count("\n") == 1
    assert not (tmp_path / "r.npz").exists()


def test_reliability_of_what_is_not_determined_is_one_line(run, model):
    done = run("diagnose", model, "--reliability", "--quiet")
    assert done.code == 2 and done.out == ""
    assert done.err.startswith("error: problem: expected") and done.err.count("\n") == 1


def test_a_graph_has_no_reliability(run, tmp_path):
    graph = tmp_path / "a.g2o"
    graph.write_text("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    done = run("diagnose", graph, "--reliability", "--quiet")
    assert done.code == 2 and done.out == "" and done.err.count("\n") == 1
    with pytest.raises(bundle.InputError, match=r"^reliability: "):
        bundle.diagnose(graph, reliability=True)
