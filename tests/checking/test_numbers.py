"""The numbers that verdicts and sentences are made of."""

from __future__ import annotations

import numpy as np
import pytest

import bundle
from bundle.checking.evidence import Evidence
from bundle.checking.jacobian_deviation import JacobianDeviation
from bundle.checking.residual_blocks import Column
from bundle.checking.tally import EDGES, Tally


@pytest.mark.parametrize(
    ("factor", "words"), [(0.25, "4.000 times too small"), (2.5, "2.500 times too large")]
)
@pytest.mark.parametrize("sign", [1, -1])
def test_a_factor_is_named_with_its_direction(factor, words, sign):
    def function(blocks):
        return np.sin(blocks[0]), [sign * factor * np.diag(np.cos(blocks[0]))]

    report = bundle.check_gradients(function, [[0.3]])
    assert report.findings[0].kind == "factor"
    assert report.findings[0].factor == pytest.approx(sign * factor)
    assert words in report.findings[0].sentence
    assert ("sign" in report.findings[0].sentence) == (sign < 0)


def deviations(reference, deviation, uncertainty):
    reference = np.array(reference, float).reshape(-1, 1, 1)
    shape = reference.shape
    return JacobianDeviation(
        reference + np.reshape(deviation, shape), reference, np.reshape(uncertainty, shape)
    )


def test_small_entries_are_measured_by_a_thousandth_of_the_usual_size():
    found = deviations([1.0, 1.0, 1e-6], [0.0, 0.0, 1e-4], [0.0, 0.0, 0.0])
    assert found.scale.ravel() == pytest.approx([1.0, 1.0, 1e-3])
    assert found.deviation.ravel() == pytest.approx([0.0, 0.0, 0.1])
    found = deviations([1.0, 1.0, 100.0, 1e-6], np.zeros(4), np.zeros(4))
    assert found.scale.ravel() == pytest.approx([1.0, 1.0, 100.0, 1e-3]), "usual: the median"


def test_a_column_of_zeros_is_measured_by_the_others():
    reference = np.array([[[4.0, 0.0]], [[4.0, 0.0]]])
    found = JacobianDeviation(reference, reference, np.zeros_like(reference))
    assert found.scale.tolist() == [[[4.0, 4.0]], [[4.0, 4.0]]]


def test_what_the_reference_does_not_know_is_no_error():
    found = deviations([2.0, 2.0, 2.0], [0.4, 0.1, 0.1], [0.1, 0.2, np.inf])
    assert found.deviation.ravel() == pytest.approx([0.2, 0.05, 0.0])
    assert found.doubt.ravel() == pytest.approx([0.05, 0.1, np.inf])
    assert found.error.ravel() == pytest.approx([0.15, 0.0, 0.0])


@pytest.mark.parametrize(("doubt", "is_explained"), [(0.04, True), (0.1, False)])
def test_a_guess_explains_only_what_stands_clear_of_the_doubt(doubt, is_explained):
    points = np.ones((3, 1))
    wrong = deviations([1.0, 1.0, 1.0], [0.5, 0.5, 0.5], [doubt, doubt, doubt])
    evidence = Evidence(wrong, [Column("x", "x")], [], points, lambda *_: None, [0])
    assert evidence.explains(np.full((3, 1, 1), 1.5), [0]) == is_explained


def explained(analytic, doubts, guess):
    """Return True if a guess explains a column whose correct entries are 1."""
    wrong = deviations(np.ones(3), np.subtract(analytic, 1), doubts)
    evidence = Evidence(wrong, [Column("x", "x")], [], np.ones((3, 1)), lambda *_: None, [0])
    return evidence.explains(np.reshape(guess, (3, 1, 1)), [0])


def test_a_guess_is_compared_where_the_reference_is_known():
    assert explained([1.5] * 3, [0, 0, 0.5], [1.5, 1.5, 7.0])
    assert not explained([1.5] * 3, [0, 0.5, 0.5], [1.5] * 3), "half of the entries are unknown"


def test_a_guess_leaves_a_hundred_thousandth_of_deviation_and_jacobian():
    for analytic, close, off in ((1.5, 1e-6, 1e-4), (1e-3, 1e-9, 1e-6), (1e3, 1e-3, 1e-1)):
        assert explained([analytic] * 3, [0] * 3, [analytic + close] * 3)
        assert not explained([analytic] * 3, [0] * 3, [analytic + off] * 3)


def test_the_worst_entries_are_of_several_columns():
    tally = Tally([Column("x", "x"), Column("y", "y")], tolerance=0.01)
    reference = np.ones((20, 1, 2))
    off = np.linspace(1, 2, 20)[:, None, None] * [1, 0.1]
    tally.add(JacobianDeviation(reference + off, reference, 0 * reference), np.arange(20))
    assert sorted(entry.column for entry in tally.worst) == [0, 0, 0, 1, 1, 1]
    assert [entry.error for entry in tally.worst[:2]] == pytest.approx([2.0, 1 + 18 / 19])


def test_a_few_numbers_in_single_precision_are_called_so():
    matrix = np.random.default_rng(1).normal(size=(3, 3))
    report = bundle.check_gradients(
        lambda b: (matrix @ b[0], [matrix.astype(np.float32)]), [[0.3, 0.2, 0.7]], num_samples=2
    )
    assert report.kinds == {"float_precision"}


def test_an_entry_is_wrong_or_undecided_but_not_both():
    tally = Tally([Column("x", "x")], tolerance=0.01)
    # Right; wrong beyond its doubt; within its doubt; without a reference.
    tally.add(deviations([1.0] * 4, [0, 0.5, 0.1, 0.5], [0, 0.1, 0.2, np.inf]), np.arange(4))
    assert tally.num_entries.tolist() == [4]
    assert tally.num_wrong.tolist() == [1]
    assert tally.num_undecided.tolist() == [2]
    assert not tally.is_undecided(0), "half of the entries"
    tally.add(deviations([1.0], [0.1], [0.2]), np.arange(1))
    assert tally.num_undecided.tolist() == [3] and tally.is_undecided(0), "three of five"


def test_a_histogram_counts_every_entry_with_the_last_bin_for_infinity():
    tally = Tally([Column("x", "x")], tolerance=0.01)
    tally.add(deviations([1.0] * 3, [0.0, 3e-9, np.inf], [0.0] * 3), np.arange(3))
    tally.add(deviations([1.0] * 2, [2e-9, 20.0], [0.0] * 2), np.arange(2))
    found = {edge: count for edge, count in zip(EDGES, tally.histogram, strict=False) if count}
    assert found == {0.0: 1, 1e-9: 2, 10.0: 2}


def test_a_slope_that_only_tiny_steps_show_is_not_accused():
    """Steps beyond 0 find the slope of log |x| on both sides together, which is nearly 0."""

    def logarithm(blocks):
        intensity, exposure = blocks
        return np.log(np.abs(intensity)) + exposure, [np.diag(1 / intensity), np.ones((2, 1))]

    blocks = [np.array([1e-12, 3e-11]), np.array([0.3])]
    assert bundle.check_gradients(logarithm, blocks).verdict != "wrong"

    def wrong(blocks):
        residual, (by_intensity, by_exposure) = logarithm(blocks)
        return residual, [1.01 * by_intensity, by_exposure]

    assert bundle.check_gradients(wrong, blocks).verdict == "wrong"


@pytest.mark.parametrize(("amplitude", "kind"), [(0.1, "small_part"), (1.5, "large_part")])
def test_an_error_without_a_pattern_is_named_by_its_size(amplitude, kind):
    matrix = np.array([[1.0, 2.0], [-1.5, 1.0]])

    def function(blocks):
        (x,) = blocks
        other = np.cos(100 * x[0] + np.array([[0.0, 1.0], [2.0, 4.0]]))
        return matrix @ x, [matrix + amplitude * other]

    assert bundle.check_gradients(function, [[0.3, 0.2]]).kinds == {kind}


def test_a_factor_close_to_one_is_named():
    def function(blocks):
        return np.sin(blocks[0]), [1.0005 * np.diag(np.cos(blocks[0]))]

    (finding,) = bundle.check_gradients(function, [[0.3]]).findings
    assert (finding.kind, finding.factor) == ("factor", pytest.approx(1.0005, rel=1e-6))
