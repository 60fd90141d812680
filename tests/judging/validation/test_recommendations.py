"""Recommendations on nine scenes of known truth: the small version of the campaign."""

import json

import numpy as np
import pytest

from bundle.judging.validation.validation_result import DecisionRule
from tests.campaigns import judge, judge_scenes

CLEAN = (6, 9, 16, 17, 22, 36)  # one with duplicated points, four sharings
SHIFTED = (113, 203, 283)


@pytest.fixture(scope="module")
def entries():
    found = [judge.record(judge_scenes.make(seed)) for seed in (*CLEAN, *SHIFTED)]
    return [json.loads(json.dumps(entry)) for entry in found]


def test_risk_is_that_of_the_best_candidate(entries):
    found = [judge.measures(entry) for entry in entries]
    assert max(one["risk"] for one in found) < judge.EQUIVALENT
    assert max(one["held_out_risk"] for one in found) < judge.EQUIVALENT
    assert np.quantile([one["position"] for one in found], 0.9) < 1.3
    assert not any(one["overfit"] for one in found)
    assert sum(one["exact"] for one in found) >= 4


def test_a_lens_per_image_is_vetoed_where_rows_are_shifted_and_nowhere_else(entries):
    found = [judge.measures(entry) for entry in entries]
    assert [one["vetoed"] for one in found] == [False] * len(CLEAN) + [True] * len(SHIFTED)
    assert all(one["one_lens"] for one in found if one["shifted"])
    free = [judge.decided(entry, DecisionRule(), veto=False) for entry in entries[len(CLEAN) :]]
    shares = [
        entry["candidates"][one]["share"]
        for entry, one in zip(entries[len(CLEAN) :], free, strict=True)
    ]
    assert {"each", "focal"} & set(shares)  # the errors alone mislead


def test_evidence_is_that_of_the_fits_that_are_compared(entries):
    for place, entry in enumerate(entries):
        bic = np.array([one["bic"] for one in entry["candidates"]], float)
        plain = bic[:, None] - bic
        known = np.isfinite(plain)
        shared = np.array([one["share"] in ("size", "all") for one in entry["candidates"]])
        known &= shared[:, None] & shared & ~np.eye(len(bic), dtype=bool)
        is_plain = np.allclose(np.array(entry["evidence"])[known], plain[known])
        assert is_plain == (place < len(CLEAN))  # the others are compared beside a shutter


def test_a_record_repeats_its_decision(entries):
    for entry in entries:
        assert judge.decided(entry, DecisionRule()) == entry["recommended"]
    assert "1.000 [" in judge.table(entries)
    assert len(judge.compare_rules(entries).splitlines()) == 11


@pytest.mark.parametrize("seed", [4155, 4195])  # 4 and 5 images
def test_the_criterion_tells_lenses_of_few_images_apart(seed):
    entry = judge.record(judge_scenes.make(seed))
    ignored = judge.decided(entry, DecisionRule(evidence=np.inf))
    assert judge.measures(entry, ignored)["risk"] > 1.2
    assert judge.measures(entry)["risk"] < judge.EQUIVALENT
    assert not judge.measures(entry)["overfit"]


def test_scenes_repeat_and_have_the_truth_that_they_state():
    scene = judge_scenes.make(22)
    again = judge_scenes.make(22)
    assert np.array_equal(scene.problem.observation_xy, again.problem.observation_xy)
    noise = scene.truth.observation_xy - scene.true_xy
    assert np.median(np.abs(noise)) == pytest.approx(0.6745 * scene.facts["sigma"], rel=0.25)
    perfect = judge._aligned_rms(3 * scene.centers[:, [1, 2, 0]] + 5, scene.centers)
    assert perfect == pytest.approx(0, abs=1e-9)
