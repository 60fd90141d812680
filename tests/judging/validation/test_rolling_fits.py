"""Motion by prediction: the rule on planted errors, and shutters on planted motions."""

from types import SimpleNamespace
from unittest import mock

import numpy as np
import pytest
from scipy import stats

import bundle
from bundle.judging.findings.images import GAIN
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.next_command import NextCommand
from bundle.judging.validation import judgement
from bundle.judging.validation.judgement import motion_test
from bundle.judging.validation.validation_result import DecisionRule, decide
from tests.judging.validation.test_validate import QUICK, photographs

ROWS, COLUMNS = np.array([0.0, 1.0]), np.array([1.0, 0.0])


def moving(order=ROWS, size=8.0):
    """Return photographs whose images move during the readout, by `size` pixels of their height."""
    problem = photographs()
    motion = size * np.random.default_rng(7).normal(size=(problem.num_images, 2))
    place = problem.observation_xy @ order / 600 - 0.5
    moved = problem.observation_xy + motion[problem.observation_image] * place[:, None]
    return problem.replace(observation_xy=moved)


@pytest.mark.parametrize(
    ("shared", "each", "rolling", "explains", "moves"),
    [
        (1.011, 1.0, 1.0, True, True),
        (1.009, 1.0, 1.0, False, False),  # a shutter gains less than 1 %
        (1.05, 1.0, 1.009, True, True),
        (1.05, 1.0, 1.011, True, False),  # lenses per image predict better
        (1.05, 1.05, 1.0, True, True),
    ],
)
def test_a_motion_is_found_if_a_shutter_alone_predicts_as_well_as_the_best(
    shared, each, rolling, explains, moves
):
    image = np.repeat(np.arange(20), 30)
    errors = np.random.default_rng(0).uniform(0.5, 1.5, len(image))
    plain = errors * np.array([[1.2], [shared], [each]])
    gain, *found = motion_test(
        plain, errors[None] * np.array([[rolling]]), image, [0, 1], DecisionRule()
    )
    assert gain == pytest.approx(1 - rolling / shared)
    assert found == [explains, moves]


@pytest.mark.parametrize(
    ("difference", "sigmas", "lacks"),
    [
        (0.04, 4.79, True),  # Student's t of 9 degrees exceeds 4.781 with a probability of 0.001
        (0.04, 4.77, False),
        (0.0201, 100.0, True),
        (0.0199, 100.0, False),  # 1 % of the best score of 2
    ],
)
def test_a_lens_lacks_a_term_if_it_predicts_clearly_and_relevantly_worse(
    monkeypatch, difference, sigmas, lacks
):
    decided = SimpleNamespace(
        differences=np.array([0.0, difference]),
        standard_errors=np.array([0.0, difference / sigmas]),
        scores=np.array([2.0, 2.0 + difference]),
        best=0,
    )

    def decide_by(_, image, rule):
        tail = stats.norm.sf(rule.num_standard_errors)
        decided.num_standard_errors = stats.t.isf(tail, len(np.unique(image)) - 1)
        return decided

    monkeypatch.setattr(judgement, "_decision", decide_by)
    image = np.repeat(np.arange(10), 3)
    found = judgement.are_clearly_worse(np.ones((2, 30)), image, DecisionRule())
    assert found.tolist() == [False, lacks]


def test_few_images_need_no_significance_beyond_that_of_the_row_test():
    image = np.repeat(np.arange(4), 30)
    errors = np.random.default_rng(0).uniform(0.5, 1.5, len(image))
    varied = errors * np.array([1.2, 0.9, 1.1, 0.95])[image]  # 1.1 standard errors above
    for factor, explains in ((1.0, True), (0.96, False)):
        plain = np.stack([factor * varied, errors])
        decision = decide(np.stack([errors, factor * varied]), image, [1, 0])
        assert decision.differences[1] < 2 * decision.standard_errors[1]
        found = motion_test(plain, errors[None], image, [0], DecisionRule())
        assert (found.explains, found.is_motion) == (explains, explains)
        assert (found.gain > 0.01) == explains


@pytest.mark.parametrize(("order", "gain"), [(ROWS, 1.35), (COLUMNS, 0.31)])
def test_motion_vetoes_a_lens_per_image_and_chooses_the_lens_beside_a_shutter(order, gain):
    found = bundle.validate(moving(order), **QUICK)
    assert found.row_test.is_suspected and found.row_test.fires
    assert [bool(one.vetoed) for one in found.candidates] == [False, False, True, True]
    chosen = found.candidates[found.recommended]
    assert (chosen.camera_model, chosen.share) == ("SIMPLE_RADIAL", "size")
    assert found.verdict == "vetoed"
    assert any("rolling shutter" in sentence for sentence in found.headline)
    (finding,) = found.findings
    assert finding.kind == "motion"
    # Poses absorb the difference of a small motion along columns from one along rows.
    assert "with a shutter by rows" in finding.sentence
    assert f"by {found.row_test.deviations[1:].max():.2g} px" in finding.sentence
    assert finding.evidence["gain"] == pytest.approx(gain, abs=0.05)
    pays = gain > GAIN
    assert finding.command == (f"{found.command} --rolling-shutter rows" if pays else "")
    assert ("It is uncertain" in finding.sentence) != pays
    # The scores are those beside a shutter, the errors of the table those without.
    assert found.sigma == pytest.approx(0.4, rel=0.15)
    assert chosen.score < 0.9 * chosen.held_out_rmse / found.sigma / np.sqrt(2)
    assert found.row_test.gain > 0.1


def test_still_images_are_fitted_without_a_shutter(monkeypatch):
    monkeypatch.setattr(judgement, "rolling_fits", None)
    found = bundle.validate(photographs(), **QUICK)
    assert not found.row_test.is_suspected and not found.row_test.fires
    assert np.isnan(found.row_test.gain)
    assert found.findings == ()


@pytest.mark.parametrize(("radial", "fires"), [(0.0, True), (0.03, False)])
def test_lenses_that_differ_in_more_than_fx_by_fy_are_no_motion(radial, fires):
    problem, rng = photographs(), np.random.default_rng(3)
    factor = 1 + np.c_[np.zeros(10), 0.01 * rng.normal(size=10)][problem.observation_image]
    k = radial * rng.normal(size=10)[problem.observation_image]
    offset = problem.observation_xy - [400, 300]
    factor += (k * (offset**2).sum(axis=1) / 400**2)[:, None]
    given = problem.replace(observation_xy=[400, 300] + offset * factor)
    found = bundle.validate(given, **QUICK)
    assert found.row_test.is_suspected
    assert (found.row_test.gain > 0.05) == fires
    assert found.row_test.fires == fires
    chosen = found.candidates[found.recommended]
    assert chosen.share == ("size" if fires else "each")


@pytest.mark.parametrize("change", ["sizes", "poses", "rolling"])
def test_no_shutter_is_tried_where_none_can_be_added(change):
    problem, options = moving(), {}
    if change == "sizes":
        problem = bundle.share_cameras(problem).replace(camera_sizes=np.zeros((1, 2)))
        options = {"camera_models": "SIMPLE_RADIAL,OPENCV", "share": "input", "num_folds": 3}
    elif change == "poses":
        options = {**QUICK, "refine_sets": [["points", "focal", "extra"]]}
    else:
        shutter = bundle.RollingShutter(
            direction=("rows",) * problem.num_cameras, twist=np.zeros((problem.num_images, 6))
        )
        problem, options = problem.replace(rolling_shutter=shutter), QUICK
    found = bundle.validate(problem, **options)
    assert found.row_test.fires == (change != "rolling")
    assert np.isnan(found.row_test.gain)


def test_a_focal_length_per_image_starts_at_the_shared_lens():
    """The fit of a larger set of lenses is no worse than that of a smaller one."""
    problem = photographs(num_images=6)
    params = problem.camera_params.copy()
    params[:, 0] *= np.linspace(0.6, 1.6, len(params))  # a start whose mean is better
    found = bundle.validate(
        problem.replace(camera_params=params), camera_models="OPENCV", share="size,focal,each",
        num_folds=3, losses="trivial",
    )  # fmt: skip
    shared, focal, each = found.candidates
    assert [one.share for one in found.candidates] == ["size", "focal", "each"]
    assert each.fitted_rmse < focal.fitted_rmse < shared.fitted_rmse


def test_the_order_is_that_of_the_residuals():
    """A measured order decides; without one, rows."""
    for parts, order in (((1.0, 1.6), "columns"), ((1.6, 1.0), "rows"), ((1.0, 1.4), "rows")):
        with mock.patch.object(judgement, "direction", lambda _, parts=parts: (*parts, 1.0)):
            assert judgement.read_order(Measured(whole=moving(), command=NextCommand())) == order
