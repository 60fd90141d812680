"""Rules on the command line: --set and --constraints."""

import json

import numpy as np
import pytest

import bundle
from tests import scenes
from tests.printed import table

NAMES = ["left/a.jpg", "left/b.jpg", "right/ü 1.jpg", "right/d.jpg"]


@pytest.fixture
def model(tmp_path):
    problem = scenes.make_problem(num_images=4, num_points=25, image_names=NAMES)
    bundle.save(problem, tmp_path / "model", "colmap")
    return tmp_path / "model"


def refine(run, model, *words):
    out = model.parent / "out"
    report = ("--json", model.parent / "r.json", "--quiet", "--verbose")
    return run("refine", model, "-o", out, *report, *words)


def test_rules_of_a_file_and_of_the_command_line(run, model, backend):
    rules = model.parent / "rules.txt"
    rules.write_bytes(
        "\ufeff# the lens\r\n\r\ncameras *: f prior 0.01 %\r\n"
        'image "right/ü*": rotation fixed # tripod\r\n'.encode()
    )
    bound = float(bundle.load(model).camera_params[1, 3])
    code, out, _ = refine(
        run, model, "--constraints", rules, "--backend", backend, "--set", "camera 1: k fixed",
        "--set", f"camera 2: k in [{bound!r}, {bound + 1e-6!r}]", "--max-iterations", 20,
    )  # fmt: skip
    assert code == 0
    before, after = bundle.load(model), bundle.load(model.parent / "out")
    assert after.camera_params[0, 3] == before.camera_params[0, 3]
    np.testing.assert_allclose(
        after.cam_from_world[2, :4], before.cam_from_world[2, :4], atol=1e-15
    )
    report = json.loads((model.parent / "r.json").read_text())
    assert report["options"]["set"][0] == "camera 1: k fixed"
    assert report["options"]["constraints"] == str(rules)
    assert report["options"]["gauge"] == "NONE"
    prior, rotation, held, bounds = report["constraints"]
    assert [entry["kind"] for entry in report["constraints"]] == [
        "prior",
        "fixed",
        "fixed",
        "bounds",
    ]
    assert (prior["place"], rotation["place"]) == (f"{rules}:3", f"{rules}:4")
    assert (held["place"], bounds["place"]) == ("--set 1", "--set 2")
    assert (prior["num_parameters"], rotation["num_parameters"]) == (4, 1)
    f = before.camera_params[:, 0]
    for entry, start, end in zip(prior["priors"], f, after.camera_params[:, 0], strict=True):
        assert entry["known"] == entry["before"] == [start]
        assert entry["after"] == [end]
        assert entry["pull"] == pytest.approx(np.log(end / start) / 1e-4, rel=1e-6)
    (end,) = bounds["active_bounds"]
    assert (end["camera_id"], end["parameter"]) == (2, "k")
    assert after.camera_params[1, 3] == end["value"]
    rows = table(out)
    strongest = max(prior["priors"], key=lambda entry: abs(entry["pull"]))
    assert f"{strongest['pull']:+.2f}" in rows[f"camera {strongest['id']}"][-1]
    assert "cameras" not in rows["held"][0]


@pytest.mark.parametrize(
    ("words", "start"),
    [
        (["--set", "camera 1: f fixt"], "--set: expected"),
        (["--set", "camera 1: f fixed", "--set", "camera 1: q fixed"], "--set 2: camera 1"),
        (["--set", "camera 1: f in [1, 2]"], "--set: f of camera 1"),
        (["--set", 'image "none*": rotation fixed'], "--set: expected"),
        (["--set", "camera 1: cx prior sigma 1"], "--set: expected a prior on a refined parameter"),
        (["--set", "camera 1: f prior 2 %", "--fix-cameras", "1"], "--set: expected a prior"),
        (["--set", ""], "--set: expected TARGET"),
        (["--constraints", "nowhere.txt"], "nowhere.txt"),
        (["--constraints", ""], "--constraints: "),
    ],
)
def test_a_rule_that_does_not_fit_ends_in_one_line(run, model, words, start):
    code, out, err = refine(run, model, *words)
    assert (code, out) == (2, "")
    assert err.startswith(f"error: {start}")
    assert err.count("\n") == 1
    assert not (model.parent / "out").exists()
    assert not (model.parent / "r.json").exists()


def test_a_report_does_not_replace_the_rules(run, model):
    rules = model.parent / "r.json"
    rules.write_text("camera 1: f fixed\n")
    code, _, err = refine(run, model, "--constraints", rules)
    assert (code, rules.read_text()) == (2, "camera 1: f fixed\n")
    assert err.startswith("error: ")


def test_rounds_and_parts_take_rules(run, model):
    code, _, _ = refine(
        run, model, "--rounds", 2, "--only-images", "left/*", "--set", "cameras *: f prior 1 %",
        "--set", "image 1: rotation fixed", "--min-angle", 0,
    )  # fmt: skip
    assert code == 0
    report = json.loads((model.parent / "r.json").read_text())
    assert [entry["id"] for entry in report["constraints"][0]["priors"]] == [1, 2]
    before, after = bundle.load(model), bundle.load(model.parent / "out")
    np.testing.assert_array_equal(after.camera_params[2:], before.camera_params[2:])
    np.testing.assert_allclose(
        after.cam_from_world[0, :4], before.cam_from_world[0, :4], atol=1e-15
    )
