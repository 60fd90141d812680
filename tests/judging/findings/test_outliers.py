"""Outliers: planted ones are found and named, sound scenes are not accused."""

import shlex
from types import SimpleNamespace

import numpy as np
import pytest

import bundle
from bundle.cli.main import command_parser
from bundle.judging.findings.find import find
from bundle.judging.findings.next_command import NextCommand
from bundle.judging.findings.outliers import outliers


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
    assert parsed.loss == "cauchy" and parsed.num_rounds is None  # nothing is deleted first


def test_gaussian_noise_is_no_outlier(scene):
    assert "outliers" not in kinds(bundle.solve(scene.problem).problem)


def test_each_step_of_the_advice_is_given_once():
    start = bundle.synthesize(
        num_images=12, num_points=800, pixel_noise=0.4, outlier_share=0.05, seed=3
    ).problem
    result = bundle.solve(start, loss="cauchy")
    found = {one.kind: one for one in find(result.problem, options=result.options)}["outliers"]
    words = shlex.split(found.command)
    parsed = command_parser().parse_args(words[1:])
    assert (parsed.num_rounds, parsed.min_angle) == (3, 0.0)
    assert float(parsed.max_error) == pytest.approx(6 * 2**0.5 * found.evidence["scale"], rel=0.05)
    assert "outliers" not in kinds(result.problem, options=result.options, rounds=3)


def judged(errors, *, loss="cauchy", rounds=0, scale=1.0):
    """Return the finding about these errors, in surroundings of this scale."""
    errors = np.asarray(errors, float)
    measured = SimpleNamespace(
        counted=np.ones(len(errors), bool),
        errors=errors,
        local_scale=np.full(len(errors), scale),
        scale=scale,
        options=SimpleNamespace(loss=loss),
        rounds=rounds,
        command=NextCommand(),
    )
    return outliers(measured)


@pytest.mark.parametrize(
    ("far", "others", "is_found"),
    [
        ([6.001] * 3, [1.0] * 400, True),  # 108.04 of 508: 21.3 %
        ([6.0] * 3, [1.0] * 400, False),  # not beyond 6 scales
        ([20.0] * 2, [1.0] * 400, False),  # two
        ([7.0] * 3, [1.0] * 588, True),  # 147 of 735: 20.0 %
        ([7.0] * 3, [1.0] * 589, False),
        ([7.0] * 3, [1.0] * 27, True),  # 30 observations
        ([7.0] * 3, [1.0] * 26, False),
    ],
)
def test_limits_of_the_test(far, others, is_found):
    found = judged([*far, *others], loss="trivial")
    assert (found is not None) == is_found
    if found is not None:
        share = np.sum(np.square(far)) / np.sum(np.square([*far, *others]))
        assert found.evidence["cost_share"] == pytest.approx(share)
        assert found.evidence["num_outliers"] == 3


@pytest.mark.parametrize("loss", ["trivial", "huber", "soft_l1"])
def test_losses_whose_influence_stays_are_replaced(loss):
    assert "--loss cauchy" in judged([50.0] * 10 + [1.0] * 100, loss=loss).command


@pytest.mark.parametrize("loss", ["cauchy", "tukey", "arctan"])
def test_a_group_is_deleted_in_its_gap_and_a_tail_stays(loss):
    healthy = [1.0] * 100
    group = judged([12.01] * 5 + [7.0] * 5 + healthy, loss=loss)
    assert shlex.split(group.command)[5:] == [
        *("--rounds", "3", "--max-error", "8.5", "--min-angle", "0")
    ]
    assert "5 observations above 8.5 px" in group.sentence
    assert judged([12.01] * 4 + [7.0] * 5 + healthy, loss=loss) is None
    assert judged([12.0] * 5 + [7.0] * 5 + healthy, loss=loss) is None
    assert judged([12.01] * 5 + [7.0] * 5 + healthy, loss=loss, rounds=1) is None
    small = judged([1.0] * 10 + [0.02] * 100, loss=loss, scale=0.02)
    assert "--max-error 0.5 " in small.command


def test_a_model_of_five_observations_has_no_findings_and_no_error(scene):
    few = scene.problem.select(observations=np.arange(5)).problem
    assert "outliers" not in kinds(few)


def test_the_next_command_keeps_the_flags_of_this_run(spoiled):
    given = ["--loss", "huber", "--share-cameras", "all", "--fix-images", "1", "2"]
    found = find(spoiled, given=given, options=bundle.SolveOptions())
    words = shlex.split(found[0].command)
    assert words.count("--loss") == 1 and "huber" not in words
    assert words[words.index("--share-cameras") :][:2] == ["--share-cameras", "all"]
