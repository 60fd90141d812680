"""Rules that the observations contradict, on scenes whose truth is known."""

from __future__ import annotations

import json
import shlex

import numpy as np
import pytest

import bundle
from bundle.base.words import number
from bundle.judging.findings import contradicted_rules, repaired
from bundle.judging.findings.find import find
from bundle.solving.constraints.rule_list import rules_of
from bundle.solving.headline import headline


@pytest.fixture(scope="module")
def scene():
    return bundle.synthesize(num_images=20, num_points=600, scene="drone-grid", seed=7)


@pytest.fixture(scope="module")
def refined(scene):
    return bundle.solve(scene.problem).problem


def rules(start, texts, **options):
    """Return the finding about the rules of a solve, or None."""
    result = bundle.solve(start, constraints=texts, max_num_iterations=200, **options)
    assert result.summary.termination_type == "CONVERGENCE"
    found = find(
        result.problem,
        options=result.options,
        constraints=rules_of(texts),
        start=start,
        is_minimum=True,
        given=[word for text in texts for word in ("--set", text)],
    )
    return next((one for one in found if one.kind == "rules"), None)


@pytest.mark.parametrize("sigma", [0.0005, 0.005, 0.03])
@pytest.mark.parametrize("is_refined", [True, False])
def test_a_wrong_focal_length_is_named_however_strong_its_prior(scene, refined, is_refined, sigma):
    start = refined if is_refined else scene.problem
    focal = float(scene.ground_truth.camera_params[0, 0])
    for factor in (1 + sigma, 1.5):
        found = rules(start, [f"cameras *: f prior {focal * factor} sigma {focal * sigma}"])
        assert (found is not None) == (factor == 1.5)
    assert found.evidence["pull"] > 0.4 / sigma / 1.5
    assert "--set" not in found.command


def test_the_wrong_one_of_several_rules_is_named_and_its_flag_goes(refined, scene):
    focal, k = scene.ground_truth.camera_params[0, [0, 3]]
    right, wrong = f"camera 1: f prior {focal} sigma 3", "camera 1: k prior 0.3 sigma 0.001"
    found = rules(refined, [right, wrong])
    assert found.evidence["rule"] == str(rules_of(wrong)[0])
    words = shlex.split(found.command)
    assert [words[at + 1] for at, word in enumerate(words) if word == "--set"] == [right]
    assert rules(refined, [right, f"camera 1: k prior {k} sigma 0.001"]) is None


@pytest.mark.parametrize(("sigmas", "is_named"), [(3.5, False), (9.0, True)])
def test_the_test_is_relative_to_the_noise_of_the_pixels(sigmas, is_named):
    made = bundle.synthesize(
        num_images=8, num_points=80, scene="orbit", seed=5, pixel_noise=3.0, image_size=(1280, 960)
    )
    free = bundle.solve(made.problem, function_tolerance=1e-12)
    focal = float(free.problem.camera_params[0, 0])
    sigma = float(np.sqrt(bundle.covariance(free, scale="sigma0").camera(1)[0, 0]))
    found = rules(free.problem, [f"camera 1: f prior {focal + sigmas * sigma} sigma {sigma / 50}"])
    assert (found is not None) == is_named


def test_without_rules_that_nothing_replaces_only_a_pull_is_judged(refined, monkeypatch):
    def undetermined(*_):
        raise bundle.InputError("undetermined")

    monkeypatch.setattr(repaired, "solved", undetermined)
    found = rules(refined, ["camera 1: k prior 0.3 sigma 0.001"])
    assert found.evidence["pull"] > contradicted_rules.FAR
    assert "without" not in found.sentence


def test_relative_rules_hold_at_the_start(refined):
    start = refined.replace(camera_params=refined.camera_params * [1.4, 1, 1, 1])
    assert rules(start, ["camera 1: f prior 0.5 %"]) is not None
    assert rules(refined, ["camera 1: f prior 0.5 %"]) is None


def test_a_rule_of_a_file_is_named_with_its_place(tmp_path, capsys, refined):
    from bundle.cli.main import main

    bundle.save(refined, tmp_path / "model")
    (tmp_path / "rules.txt").write_text("# lens\ncamera 1: k prior 0.3 sigma 0.001\n")
    words = ["refine", str(tmp_path / "model"), "-o", str(tmp_path / "out"), "--json", "-"]
    assert main([*words, "--constraints", str(tmp_path / "rules.txt")]) == 0
    found = json.loads(capsys.readouterr().out)["findings"][0]
    assert (found["kind"], found["command"]) == ("rules", "")
    assert "rules.txt:2)" in found["sentence"]


def test_an_estimated_plane_through_points_of_a_hill_is_named(refined):
    off = refined.points[:50] - refined.points[:50].mean(axis=0)
    spread = np.linalg.svd(off, compute_uv=False)[2] / np.sqrt(50)
    ids = ",".join(map(str, refined.point_ids[:50]))
    for sigma in (2 * spread, spread / 300):
        found = rules(refined, [f"points {ids}: on plane sigma {sigma}"], gauge="two_cameras")
        assert (found is not None) == (sigma < spread)
    assert "(plane)" in found.sentence


def test_a_right_rule_is_not_blamed_for_a_lens_that_is_too_small():
    made = bundle.synthesize(
        num_images=14, num_points=500, scene="drone-grid", camera_model="opencv", seed=4
    )
    small = bundle.change_camera_model(made.problem, "SIMPLE_RADIAL").problem
    focal = float(made.ground_truth.camera_params[0, 0])
    assert rules(small, [f"camera 1: f prior {focal} sigma {focal / 3000}"]) is None


def test_a_rule_is_not_blamed_for_the_gauge_that_contradicts_it(refined):
    place = refined.projection_centers[3] + 5.0
    text = f"image {refined.image_ids[3]}: position prior {place.tolist()} sigma 0.01"
    assert rules(refined, [text]) is None


def test_of_a_large_model_only_a_pull_is_judged(refined, scene, monkeypatch):
    monkeypatch.setattr(repaired, "is_affordable", lambda *_: False)
    k = scene.ground_truth.camera_params[0, 3] + 0.3
    weak, strong = (
        rules(refined, [f"camera 1: k prior {k} sigma {sigma}"]) for sigma in (0.001, 0.00001)
    )
    assert weak.evidence["pull"] > contradicted_rules.FAR
    assert "ends" in weak.sentence
    assert strong is None


def test_a_wrong_plane_is_named_after_rounds_have_deleted_what_it_bent(tmp_path, capsys, refined):
    from bundle.cli.main import main

    bundle.save(refined, tmp_path / "model")
    ids = ",".join(map(str, refined.point_ids[:50]))
    words = ["refine", str(tmp_path / "model"), "-o", str(tmp_path / "out"), "--overwrite"]
    words += ["--gauge", "two-cameras", "--rounds", "3", "--json", "-"]
    assert main([*words, "--set", f"points {ids}: on plane sigma 0.005"]) == 0
    report = json.loads(capsys.readouterr().out)
    first = next(one for one in report["findings"] if one["kind"] == "rules")
    assert any("fitted the input" in sentence for sentence in report["headline"])
    assert main([*shlex.split(first["command"])[1:], "--overwrite", "--json", "-"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert [one["kind"] for one in report["findings"] if one["kind"] == "rules"] == []
    assert not any("fitted the input" in sentence for sentence in report["headline"])


@pytest.mark.parametrize("is_wrong", [False, True])
def test_the_headline_of_rounds_compares_factors_with_the_input(refined, is_wrong):
    focal = float(refined.camera_params[0, 0]) * (1.4 if is_wrong else 1)
    texts = [f"camera 1: f prior {focal} sigma 1"]
    once, rounds = (bundle.solve_rounds(refined, num_rounds=n, constraints=texts) for n in (0, 2))
    start = float(once.factor_costs_before.sum())
    assert rounds.rounds[0].initial_factor_cost == pytest.approx(start, rel=1e-12)
    assert once.initial_factor_cost is None
    said = [one for one in headline(rounds) if "cost of the rules falls" in one]
    assert len(said) == is_wrong
    assert all(f"{number(start)} ->" in one for one in said)


def test_deleted_outliers_did_not_fit_the_input():
    made = bundle.synthesize(num_images=12, num_points=200, seed=1, outlier_share=0.05)
    for start in (made.problem, made.ground_truth):
        result = bundle.solve_rounds(start, num_rounds=2, loss="cauchy")
        assert result.deleted_for_error[0] > 20
        assert not any("fitted the input" in one for one in headline(result))
