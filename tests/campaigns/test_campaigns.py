"""A few rounds of each campaign; and that a campaign sees what is wrong."""

import os
import sys
import threading

import numpy as np
import pytest

import bundle
from bundle.graphs.factors import check_solve
from bundle.judging.findings.find import find
from tests.campaigns import (
    advice,
    conventions,
    covariance,
    degenerate,
    findings,
    foreign_mutants,
    gauges,
    healthy,
    jacobians,
    jobs,
    kills,
    library_mistakes,
    mutants,
    plans,
    standardized,
    step_problems,
    steps,
    two_loops,
)


def misbehave(job):
    """One way to be wrong per job."""
    if job == "print":
        print("stray", file=sys.stderr)
    elif job == "abort":
        os.abort()
    elif job == "hang":
        threading.Event().wait()
    elif job == "raise":
        raise ValueError("not an InputError")
    elif job == "two lines":
        raise OSError("one\ntwo")
    elif job == "nonsense":
        raise AssertionError("usable and NaN")
    return "fine"


def test_what_goes_wrong_is_seen():
    names = ["fine", "print", "abort", "hang", "raise", "two lines", "nonsense", "fine"]
    outcomes = jobs.run(f"{__name__}:misbehave", names, timeout=1.0)
    kinds = ["ok", "printed", "died", "died", "ValueError", "bad message", "nonsense", "ok"]
    assert [outcome.kind for outcome in outcomes] == kinds
    assert "8 jobs, 6 wrong" in jobs.summarise(outcomes)


@pytest.mark.parametrize("campaign", [mutants.campaign, degenerate.campaign])
def test_nothing_is_wrong(campaign):
    outcomes = campaign(60)
    assert [outcome for outcome in outcomes if not outcome.orderly] == []
    assert {outcome.kind for outcome in outcomes} >= {"ok"}


def test_damaged_files_of_other_programs_are_refused_or_read_as_they_are():
    found = foreign_mutants.campaign(40, seed=3)
    assert len(found) == 5
    assert all(set(verdicts) == {"refused", "equal"} for verdicts in found.values()), found


def test_kills_leave_the_old_or_the_new():
    cases = kills.campaign(10, num_points=40)
    assert [case.wrong for case in cases if case.wrong] == []
    assert {case.counts["old"] + case.counts["new"] for case in cases} == {2}


def test_healthy_blocks_are_not_accused():
    verdicts = healthy.campaign(12, seed=3)
    assert [verdict for verdict in verdicts if verdict.accusations] == []


def test_right_jacobians_are_not_accused_and_wrong_ones_caught(monkeypatch):
    monkeypatch.setattr(check_solve, "MOST_SECONDS", 5.0)  # on a busy machine, too
    rights, wrongs = jacobians.campaign(8, len(jacobians.MISTAKES), seed=7)
    imu = jacobians.imu(np.random.default_rng(7))
    rights.append(jacobians.judge(jacobians.Case(imu, "imu", frozenset({"correct"})), 7))
    assert [v for v in rights if v.verdict != "correct" or v.is_caught] == []
    assert [v for v in wrongs if not v.is_caught or not v.is_named] == []


def test_mistakes_in_the_layouts_of_libraries_are_named():
    mistakes = library_mistakes.listed()
    assert len(mistakes) >= 60
    assert {m.library for m in mistakes} == {"ceres", "gtsam", "manif", "g2o", "g2o_expmap"}
    few = [m for m in mistakes if m.kinds & {"adjoint", "inverse"}]
    some = [*mistakes[1::26], *few[::8]]
    verdicts = [conventions.judge(mistake, 3) for mistake in some]
    assert [verdict for verdict in verdicts if not verdict.is_named] == []
    rights = [conventions.judge_right(seed) for seed in range(3)]
    assert [verdict for verdict in rights if verdict.verdict == "wrong"] == []
    assert sum(verdict.verdict == "correct" for verdict in rights) >= 2


def test_covariances_are_the_dense_ones():
    found = covariance.campaign(8, seed=100)
    assert [entry for entry in found if entry.is_wrong] == []
    assert {entry.kind for entry in found} > {"singular"}  # seed 105 leaves an intrinsic free


def test_gauges_leave_minima_where_they_are():
    found = gauges.campaign(16, seed=1000)
    assert [entry for entry in found if entry.is_wrong] == []
    assert {kind for entry in found for kind in entry.kinds} >= {"rigs", "1 points", "2 points"}


def test_followed_advice_helps_and_ends(tmp_path):
    """Outliers in cameras of one lens: each order of both repairs ends at the same model."""
    steps = advice.scene_steps(50_006, tmp_path)
    assert [step for step in steps if step.faults] == []
    assert {step.kind for step in steps} == {"outliers", "shared_lens"}
    assert all(step.after < 0.3 * step.before for step in steps if "cauchy" not in step.words)


def test_followed_advice_frees_what_is_held_at_a_wrong_value(tmp_path):
    (step,) = advice.scene_steps(91_012, tmp_path, advice.HELD)
    assert (step.kind, step.faults) == ("constant_points", ()) and "--fix-points" not in step.words
    assert step.after < 0.2 * step.before


def test_faults_of_advice_are_seen():
    words = ["refine", "a", "-o", "b", "--set", "camera 1: f fixed", "--rounds", "2"]
    assert advice._lost(words, [*words[:4], "--rounds", "3"]) == ["rules"]
    assert advice._lost(words, [*words, "--set", "camera 1: k fixed"]) == []
    assert advice._lost(words, words[:6]) == ["num_rounds"]
    moved = np.random.default_rng(0).normal(size=(5, 3))
    turned = moved @ np.array([[0, 1.0, 0], [-1, 0, 0], [0, 0, 1]]) * 3 + [1, 2, 3]
    np.testing.assert_allclose(advice.similar(moved, turned), turned, atol=1e-12)


@pytest.mark.parametrize(
    ("after", "repaired", "faults", "expected"),
    [
        (1.0, np.nan, (), True),
        (1.0, 0.96, ("worse",), True),
        (1.0, 0.94, ("worse",), False),
        (1.0, np.nan, ("worse",), False),  # a model without truth
        (1.0, 9.0, ("worse", "exit 2"), False),
    ],
)
def test_a_step_is_harmless_up_to_the_error_of_a_perfect_repair(after, repaired, faults, expected):
    step = advice.Step("outliers", (), 0.5, after, faults, repaired)
    assert advice.does_no_harm(step) == expected


def test_a_perfect_repair_leaves_nothing_but_noise():
    scene = findings.make(20_000, ("outliers", "positions"))
    clean = advice.without_errors(scene, np.random.default_rng(1))
    solved = bundle.solve(clean.start, num_threads=1, priors=clean.priors, align=True)
    assert find(solved.problem, options=solved.options, priors=clean.priors) == ()
    assert [one.image for one in clean.priors] == scene.truth.image_ids.tolist()


def test_two_loops(monkeypatch):
    """Every pose of each run comes, with both solves behind them."""
    monkeypatch.setattr(two_loops, "STALL", 0.01)
    for solver in (None, two_loops.sleeping, two_loops.solving):
        late = two_loops.lateness(1.1, solver) if solver else two_loops.lateness(0.05, None)
        assert np.isfinite(late).all()
        assert len(late) == (220 if solver else 10)


def test_rules_of_the_radius():
    """Ceres' rule takes Ceres' steps; good steps let others grow, bad steps lead back to it."""
    cases = [step_problems.draw(seed) for seed in (12, 24, 31, 58)]
    found = steps.campaign(cases, ("1e4", "threefold", "trusting"))
    for by in found.values():
        one, other = by["1e4"], by["threefold"]
        assert one.converged
        assert abs(one.num_steps - other.num_steps) <= 1
        np.testing.assert_allclose(other.costs[-1], one.costs[-1], rtol=1e-5)
        assert by["trusting"].costs[-1] <= one.costs[-1] * (1 + 1e-5)
    row = steps.comparison(found, "1e4")
    assert row[2:] == ["1.00", "1.00", "0", "0", "0.0e+00", "0"]
    rule = steps.Trusting()
    rule.accepted(0.99)
    assert rule.radius == 30 * 3e4
    rule.rejected()
    assert rule.radius == 3e4
    rule.accepted(0.99)
    assert rule.radius == 9e4
    rule.rejected()
    assert rule.radius == 4.5e4


def test_planted_errors_are_found_with_the_promised_power():
    """80 % of 80 errors within three standard deviations (4.5 %), 0.1 % false alarms."""
    done = [standardized.plant(seed) for seed in range(8)]
    sizes = [size for one in done for size in one.sizes]
    assert min(sizes) < 8 and max(sizes) > 100
    assert 0.665 < sum(one.num_found for one in done) / len(sizes) < 0.935
    num_clean = sum(one.num_clean for one in done)
    assert sum(one.num_false for one in done) <= 0.001 * num_clean + 3 * np.sqrt(0.001 * num_clean)


def test_errors_with_a_proposal_are_as_small_as_predicted():
    """An image, a tie, a control point and a bar, followed eight times each."""
    done = [plans.follow(seed, 8) for seed in (2, 5, 10, 14)]
    assert [one.kind for one in done] == list(plans.KINDS)
    assert all(one.predicted < 0.75 for one in done)
    for name in ("before", "after"):
        errors = np.concatenate([getattr(one, name) for one in done])
        assert 0.7 < np.sqrt((errors**2).mean()) < 1.4  # 3 standard deviations and some curvature


@pytest.mark.parametrize("seed", [1, 9])
def test_standardized_errors_leave_better_models_than_raw_ones(seed):
    """Least squares with 1 and 10 % of outliers of 3 to 200 px around an object."""
    found = standardized.compare(seed)
    assert found.standardized < 0.8 * found.raw
