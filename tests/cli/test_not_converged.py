"""A solve that ends at its limit of steps, or without a usable result, says what to run next."""

import json
import shlex

import pytest

import bundle
from bundle.cli.main import main


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    made = bundle.synthesize(scene="orbit", num_images=6, num_points=80, seed=1)
    folder = tmp_path_factory.mktemp("steps") / "model"
    bundle.save(made.problem, folder)
    return folder


def findings(model, tmp_path, steps, *flags):
    report = tmp_path / "report.json"
    words = ["refine", str(model), "-o", str(tmp_path / "out"), "--quiet", "--overwrite"]
    main([*words, "--max-iterations", str(steps), "--json", str(report), *flags])
    return json.loads(report.read_text())["findings"]


def test_more_steps_are_advised_and_suffice(model, tmp_path):
    (found,) = [
        one
        for one in findings(model, tmp_path, 2, "--loss", "huber")
        if one["kind"] == "not_converged"
    ]
    words = shlex.split(found["command"])
    assert words[words.index("--max-iterations") + 1] == "8"
    assert words[words.index("--loss") + 1] == "huber"
    assert words.count("--max-iterations") == 1
    main([*words[1:], "--quiet", "--json", str(tmp_path / "again.json")])
    again = json.loads((tmp_path / "again.json").read_text())
    assert again["summary"]["termination_type"] == "CONVERGENCE"
    assert "not_converged" not in {one["kind"] for one in again["findings"]}


@pytest.mark.parametrize("steps", [0, 100])
def test_others_say_nothing(model, tmp_path, steps):
    assert "not_converged" not in {one["kind"] for one in findings(model, tmp_path, steps)}


def test_a_loss_comes_before_more_steps(tmp_path):
    made = bundle.synthesize(scene="orbit", num_images=6, num_points=200, seed=1, outlier_share=0.1)
    bundle.save(made.problem, tmp_path / "model")
    kinds = [one["kind"] for one in findings(tmp_path / "model", tmp_path, 10)]
    assert "outliers" in kinds
    assert "not_converged" not in kinds


def test_shorter_steps_are_advised_for_a_far_start_and_suffice(tmp_path):
    far = {"rotation_noise": 8.0, "translation_noise": 0.3, "point_noise": 0.3}
    made = bundle.synthesize(scene="orbit", num_images=6, num_points=120, seed=4, **far)
    bundle.save(made.problem, tmp_path / "model")
    flags = ("--threads", "1", "--loss", "cauchy")
    (found,) = findings(tmp_path / "model", tmp_path, 100, *flags)
    assert found["kind"] == "far_start" and found["is_problem"]
    words = shlex.split(found["command"])[1:]
    assert set(flags) < set(words) and words[-2:] == ["--initial-trust-region-radius", "1"]
    assert main([*words, "--quiet"]) == 0
