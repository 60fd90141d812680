"""Decision between candidates from arrays of errors."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from bundle.errors import InputError
from bundle.judging.validation import judgement
from bundle.judging.validation.validation_result import Cameras, DecisionRule, decide, jackknife


def planted(levels, num_images=20, per_image=50, seed=0, spread=0.02):
    """Return errors of candidates that share their noise; a level scales all errors of one."""
    rng = np.random.default_rng(seed)
    image = np.repeat(np.arange(num_images), per_image)
    noise = rng.rayleigh(0.8, len(image))
    own = 1 + spread * rng.standard_normal((len(levels), num_images))
    return np.array(
        [level * noise * each[image] for level, each in zip(levels, own, strict=True)]
    ), image


def test_clearly_better_candidate_is_recommended_although_it_costs_more():
    errors, image = planted([1.2, 1.0, 1.0])
    decision = decide(errors, image, [10, 20, 30])
    assert decision.recommended == 1
    assert decision.is_equal.tolist() == [False, True, True]
    assert decision.differences[0] > 2 * decision.standard_errors[0] > 0


def test_relevant_but_not_significant_and_significant_but_not_relevant():
    errors, image = planted([1.03, 1.0], spread=0.3)
    decision = decide(errors, image, [10, 20])
    assert decision.recommended == 0
    errors, image = planted([1.004, 1.0], spread=0.0)
    decision = decide(errors, image, [10, 20])
    assert decision.differences[0] > 2 * decision.standard_errors[0]
    assert decision.recommended == 0
    assert decide(errors, image, [10, 20], rule=DecisionRule(threshold=0.0)).recommended == 1


def test_vetoed_candidate_takes_no_part_but_has_numbers():
    errors, image = planted([1.5, 1.0, 1.2])
    decision = decide(errors, image, [10, 20, 15], ["", "rows", ""])
    assert (decision.best, decision.recommended) == (2, 2)
    assert decision.differences[1] < 0
    assert not decision.is_equal[1]


def test_equal_costs_are_decided_by_the_score():
    errors, image = planted([1.003, 1.0])
    assert decide(errors, image, [10, 10]).recommended == int(
        np.argmin(decide(errors, image, [10, 10]).scores)
    )


def test_missing_projections_count_as_the_clip_and_one_outlier_does_not_decide():
    errors, image = planted([1.0, 1.0], spread=0.0)
    errors[0, 7] = np.nan
    errors[1, 7] = 1e9
    decision = decide(errors, image, [10, 20])
    assert decision.scores[0] == decision.scores[1]
    expected = np.sqrt(np.mean(np.minimum(errors[1], 3) ** 2))
    assert decision.scores[1] == pytest.approx(expected, rel=1e-14)


def test_jackknife_equals_its_definition():
    errors, image = planted([1.1, 1.0], num_images=7, per_image=9)
    squares = np.minimum(errors, 3) ** 2
    left = [np.sqrt(squares[:, image != i].mean(1)) for i in range(7)]
    difference = np.array([a - b for a, b in left])
    expected = np.sqrt(6 / 7 * ((difference - difference.mean()) ** 2).sum())
    found = decide(errors, image, [1, 2]).standard_errors
    assert found[0] == pytest.approx(expected, rel=1e-12)
    assert found[1] == 0


@pytest.mark.parametrize("evidence, share, refuted", [
    (10.1, 1.02, True), (9.9, 1.02, False), (10.1, 1.009, False), (np.nan, 1.02, False),
])  # fmt: skip
def test_a_candidate_is_refuted_by_evidence_and_a_better_prediction(evidence, share, refuted):
    errors, image = planted([share, 1.0], num_images=3, per_image=300, spread=0.0)
    errors[0, image == 0] *= 1.3  # three images: the difference is not significant
    errors[0, image == 1] /= 1.2
    errors[0] *= share * np.sqrt((errors[1] ** 2).mean() / (errors[0] ** 2).mean())
    criteria = np.array([[0.0, evidence], [-evidence, 0.0]])
    rule = DecisionRule(clip=100.0)
    assert decide(errors, image, [10, 20], rule=rule).recommended == 0
    decision = decide(errors, image, [10, 20], rule=rule, criteria=criteria)
    assert (decision.recommended, decision.is_equal.tolist()) == (int(refuted), [not refuted, True])
    vetoed = decide(errors, image, [10, 20], ["", "rows"], rule, criteria=criteria)
    assert vetoed.recommended == 0


def test_losses_are_not_compared_and_a_fit_without_a_criterion_is_refuted():
    fits = [SimpleNamespace(candidate=SimpleNamespace(loss=one)) for one in ("cauchy",) * 3 + ("",)]
    criteria = [(0.0, 7.0), (0.0, 2.0), (0.0, np.nan), (0.0, 1.0)]
    nan, inf = np.nan, np.inf
    expected = [[0, 5, -inf, nan], [-5, 0, -inf, nan], [inf, inf, nan, nan], [nan, nan, nan, 0]]
    np.testing.assert_array_equal(judgement.evidence_between(fits, criteria), expected)


def test_images_without_held_out_observations_do_not_count():
    errors, image = planted([1.1, 1.0], num_images=7, per_image=9)
    a, b = decide(errors, image, [1, 2]), decide(errors, image * 3 + 2, [1, 2])
    np.testing.assert_allclose(a.standard_errors, b.standard_errors, rtol=1e-14)
    one = np.array([2.0]), np.array([1.0]), np.array([5.0])
    assert jackknife(*one) == np.inf
    assert jackknife(one[1], one[1], one[2]) == 0


def test_candidates_without_a_fit():
    errors, image = planted([1.0, 1.0])
    errors[0] = np.nan
    decision = decide(errors, image, [1, 2])
    assert decision.recommended == 1
    assert np.isnan(decision.scores[0])
    with pytest.raises(InputError, match="expected a candidate"):
        decide(errors, image, [1, 2], ["", "rows"])


def test_both_limits_of_the_rule_count():
    errors, image = planted([1.05, 1.0], spread=0.0)
    errors[0, image % 20 < 10] /= 1.09
    decision = decide(errors, image, [10, 20])
    ratio = decision.differences[0] / decision.standard_errors[0]
    share = decision.differences[0] / decision.scores[1]
    for factor, recommended in ((0.99, 1), (1.01, 0)):
        many = stats.norm.isf(stats.t.sf(ratio * factor, 19))  # images without end
        rule = DecisionRule(threshold=0.0, num_standard_errors=many)
        assert decide(errors, image, [10, 20], rule=rule).recommended == recommended
        rule = DecisionRule(threshold=share * factor, num_standard_errors=0.0)
        assert decide(errors, image, [10, 20], rule=rule).recommended == recommended
    assert (DecisionRule().num_standard_errors, DecisionRule().threshold) == (2.0, 0.01)


@pytest.mark.parametrize(("num_images", "limit"), [(3, 4.527), (5, 2.869), (60, 2.043)])
def test_few_images_leave_their_standard_error_uncertain(num_images, limit):
    """A lens per image was recommended by 2.02 standard errors over five images."""
    errors, image = planted([1.2, 1.0], num_images=num_images, per_image=40)
    errors[0, image == 0] /= 1.2
    found = decide(errors, image, [10, 20])
    assert found.num_standard_errors == pytest.approx(limit, abs=1e-3)
    ratio = found.differences[0] / found.standard_errors[0]
    for factor, is_equal in ((0.99, False), (1.01, True)):
        many = stats.norm.isf(stats.t.sf(ratio * factor, num_images - 1))
        rule = DecisionRule(threshold=0.0, num_standard_errors=many)
        assert decide(errors, image, [10, 20], rule=rule).is_equal[0] == is_equal


def cameras(distance, sigma, certainties):
    """Cameras of two candidates; the second is the best."""
    return Cameras(
        distances=np.array([[0.0, distance], [distance, 0.0]]),
        sigmas=np.array([np.nan, sigma]),
        certainties=np.array(certainties, float),
    )


def chosen_by(given, rule, counts=(10, 20)):
    """Decide between a small candidate and a best one, which predicts better by D."""
    errors, image = planted([1.05, 1.0], spread=0.0)
    errors[0, image % 20 < 10] /= 1.09
    return decide(errors, image, counts, rule=rule, cameras=given)


def test_cameras_that_moved_make_a_small_difference_relevant():
    plain = chosen_by(None, DecisionRule())
    share = plain.differences[0] / plain.scores[1]

    def recommended(distance, sigma=1.0, movement=1.0, errors=0.0):
        rule = DecisionRule(threshold=share * 1.01, num_standard_errors=errors, movement=movement)
        return chosen_by(cameras(distance, sigma, [1.0, 1.0]), rule).recommended

    assert recommended(1.001) == 1
    assert recommended(0.999) == 0
    assert recommended(2.001, movement=2.0) == 1
    assert recommended(1.999, movement=2.0) == 0
    assert recommended(1.001, errors=99.0) == 0  # not significant
    assert recommended(np.nan) == recommended(1.001, sigma=np.nan) == 0


def test_an_expensive_candidate_must_predict_better_by_the_price():
    plain = chosen_by(None, DecisionRule())
    share = plain.differences[0] / plain.scores[1]

    def recommended(certainty, factor=1.01, distance=0.0, unit=1.0):
        rule = DecisionRule(threshold=share * factor / 3.0, num_standard_errors=0.0)
        return chosen_by(cameras(distance, 1.0, [unit, unit * certainty]), rule).recommended

    assert recommended(3.001) == 0
    assert recommended(2.999) == 1
    assert recommended(3.001, unit=1e-3) == 0  # positions in km
    assert recommended(2.999, unit=1e3) == 1
    assert recommended(3.001, factor=0.99) == 1
    assert recommended(3.001, distance=99.0) == 0
    assert recommended(np.nan) == 1
    rule = DecisionRule()
    assert (rule.movement, rule.expensive, rule.price) == (1.0, 3.0, 3.0)


def test_significance_counts_whatever_the_cameras_do():
    errors, image = planted([1.0005, 1.0])
    for moved in (0.0, 99.0):
        given = cameras(moved, 1.0, [1.0, 1.0])
        assert decide(errors, image, [10, 20], cameras=given).recommended == 0


def test_a_price_is_no_equality():
    plain = chosen_by(None, DecisionRule())
    share = plain.differences[0] / plain.scores[1]
    rule = DecisionRule(threshold=share / 2.0, num_standard_errors=0.0)
    paid = chosen_by(cameras(0.0, 1.0, [1.0, 9.0]), rule)
    assert paid.is_equal.tolist() == [True, True]
    assert paid.by_price.tolist() == [True, False]
    alike = DecisionRule(threshold=share * 1.01, num_standard_errors=0.0)
    assert not chosen_by(cameras(0.0, 1.0, [1.0, 9.0]), alike).by_price.any()
    significant = DecisionRule(threshold=share / 2.0, num_standard_errors=99.0)
    assert not chosen_by(cameras(0.0, 1.0, [1.0, 9.0]), significant).by_price.any()


def test_cameras_of_a_larger_lens_may_move():
    plain = chosen_by(None, DecisionRule())
    rule = DecisionRule(
        threshold=plain.differences[0] / plain.scores[1] * 1.01, num_standard_errors=0.0
    )
    moved = cameras(99.0, 1.0, [1.0, 1.0])
    assert chosen_by(moved, rule, (19, 20)).is_equal.tolist() == [False, True]
    assert chosen_by(moved, rule, (20, 20)).is_equal.tolist() == [True, True]
    assert chosen_by(moved, rule, (30, 20)).is_equal.tolist() == [True, True]


@pytest.mark.parametrize(
    ("level", "cost", "veto", "recommended"),
    [(1.02, 6, "", 1), (1.055, 6, "", 1), (1.056, 6, "", 2), (1.02, 8, "", 2), (1.02, 6, "no", 2)],
)
def test_a_smaller_lens_is_as_good_as_one_with_a_higher_score(level, cost, veto, recommended):
    # The third is worse by 0.0553 with an error of 0.06, the second by exactly 0.02.
    image = np.repeat(np.arange(16), 10)
    third = np.where(image % 2, 1.26, 0.8)
    errors = np.array([np.ones(160), np.full(160, level), third])
    decision = decide(errors, image, [10, cost, 8], ["", veto, ""])
    assert decision.scores[2] == pytest.approx(1.0553, abs=1e-4)
    assert decision.standard_errors[1] < 1e-12 and decision.standard_errors[2] > 0.05
    assert decision.recommended == recommended
    assert decision.is_equal.tolist() == [True, recommended == 1, True]
