"""Outliers: planted ones are found and named, sound scenes are not accused."""

import shlex

import numpy as np
import pytest

import bundle
from bundle.cli.main import command_parser
from bundle.judging.findings.find import find


def kinds(problem, **more):
    return {finding.kind for finding in find(problem, **more)}


@pytest.fixture(scope="module")
def scene():
    return bundle.synthesize(num_images=12, num_points=800, pixel_noise=0.4, seed=3)


@pytest.fixture(scope="module")
def spoiled():
    scene = bundle.synthesize(
        num_images=12, num_points=800, pixel_noise=0.4, outlier_share=0.05, seed=3
    )
    return bundle.solve(scene.problem).problem


def test_planted_outliers_are_found_and_the_command_parses(spoiled):
    found = {finding.kind: finding for finding in find(spoiled, source="a b/model")}["outliers"]
    assert found.evidence["num_outliers"] > 0.01 * spoiled.num_observations
    assert found.evidence["rmse_without"] < found.evidence["rmse"]
    words = shlex.split(found.command)
    assert words[:3] == ["bundle", "refine", "a b/model"]
    parsed = command_parser().parse_args(words[1:])
    assert parsed.loss == "cauchy" and str(parsed.num_rounds) == "3"


def test_gaussian_noise_is_no_outlier(scene):
    assert "outliers" not in kinds(bundle.solve(scene.problem).problem)


def test_followed_advice_is_not_repeated():
    start = bundle.synthesize(
        num_images=12, num_points=800, pixel_noise=0.4, outlier_share=0.05, seed=3
    ).problem
    result = bundle.solve(start, loss="cauchy")
    assert "outliers" in kinds(result.problem, options=result.options)
    assert "outliers" not in kinds(result.problem, options=result.options, rounds=3)


def test_a_model_of_five_observations_has_no_findings_and_no_error(scene):
    few = scene.problem.select(observations=np.arange(5)).problem
    assert "outliers" not in kinds(few)


def test_the_next_command_keeps_the_flags_of_this_run(spoiled):
    given = ["--loss", "huber", "--share-cameras", "all", "--fix-images", "1", "2"]
    found = find(spoiled, given=given, options=bundle.SolveOptions())
    words = shlex.split(found[0].command)
    assert words.count("--loss") == 1 and "huber" not in words
    assert words[words.index("--share-cameras") :][:2] == ["--share-cameras", "all"]
