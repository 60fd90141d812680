"""Hypotheses about wrong columns, on both sides of each of their limits."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.checking import classify, column_signatures, row_signatures
from bundle.checking.evidence import Evidence, join_names
from bundle.checking.gradient_report import GradientCheckerSummary
from bundle.checking.jacobian_deviation import JacobianDeviation
from bundle.checking.residual_blocks import Block, Column
from bundle.checking.sample_check import _Check

TOLERANCE = 1e-7


def evidence(analytic, reference, uncertainty=None, points=None):
    """Return the evidence of Jacobians (K, R, N), all of whose columns are wrong."""
    analytic, reference = np.array(analytic, float), np.array(reference, float)
    doubt = np.zeros_like(reference) if uncertainty is None else np.array(uncertainty, float)
    count, _, width = reference.shape
    return Evidence(
        JacobianDeviation(analytic, reference, doubt, TOLERANCE),
        [Column(f"x {j}", "x") for j in range(width)],
        [Block("x", 0, width)],
        np.ones((count, width)) if points is None else np.array(points, float),
        lambda *_: None,
        list(range(width)),
        TOLERANCE,
    )


@pytest.mark.parametrize(
    ("names", "phrase"),
    [
        (["f"], "f"),
        (["x 0", "x 1"], "x 0 and 1"),
        (["x 0", "x 2", "y", "x 1"], "x 0, 2, y and x 1"),
    ],
)
def test_names_are_joined_without_repetition(names, phrase):
    assert join_names(names) == phrase


@pytest.mark.parametrize(("left", "is_explained"), [(0.99e-5, True), (1.01e-5, False)])
def test_a_guess_leaves_a_share_of_the_deviation(left, is_explained):
    given = evidence([[[3.0]]], [[[1.0]]])
    assert given.explains(np.array([[[3.0 + 2 * left]]]), [0]) == is_explained


@pytest.mark.parametrize(("left", "is_explained"), [(0.99e-5, True), (1.01e-5, False)])
def test_a_small_column_is_explained_by_its_own_size(left, is_explained):
    """A column of a thousandth is no zero: the remainder is compared with it, too."""
    given = evidence([[[1e-3]]], [[[1.0]]])
    assert given.explains(np.array([[[1e-3 * (1 + left)]]]), [0]) == is_explained
    tiny = evidence([[[1e-6]]], [[[1.0]]])
    assert not tiny.explains(np.zeros((1, 1, 1)), [0])


@pytest.mark.parametrize(("doubt", "is_explained"), [(0.0099, True), (0.0101, False)])
def test_a_deviation_is_ten_times_its_doubt(doubt, is_explained):
    given = evidence([[[1.1]]], [[[1.0]]], [[[doubt]]])
    assert given.explains(np.array([[[1.1]]]), [0]) == is_explained


@pytest.mark.parametrize(("unknown", "is_explained"), [(2, True), (3, False)])
def test_half_of_the_entries_are_known(unknown, is_explained):
    doubt = np.zeros((4, 1, 1))
    doubt[:unknown] = 0.11  # above a tenth
    given = evidence(np.full((4, 1, 1), 2.0), np.ones((4, 1, 1)), doubt)
    assert given.explains(np.full((4, 1, 1), 2.0), [0]) == is_explained


def test_rows_of_zeros_in_a_column_that_is_right_elsewhere():
    right = np.random.default_rng(1).normal(size=(4, 3, 3))
    given = right.copy()
    given[:, 1, 0] = 0.0  # in all points
    given[0, 1, 1] = 0.0  # in one
    given[:, 1, 2], given[:, 2, 2] = 0.0, 2.0  # and other rows are wrong
    found = evidence(given, right)
    column_signatures.zero_entries(found)
    assert [(one.kind, one.columns, one.rows) for one in found.findings] == [
        ("missing_term", ("x 0",), (1,))
    ]
    assert found.wrong == [1, 2]


@pytest.mark.parametrize(
    ("factor", "kind", "num_wrong", "has_note"),
    [(2.0, "factor", 2, True), (2.0, "factor", 1, False), (-1.0, "sign", 2, False)],
)
def test_weights_may_multiply_the_jacobians_only(factor, kind, num_wrong, has_note):
    right = np.random.default_rng(1).normal(size=(4, 3, 2))
    given = right.copy()
    given[..., :num_wrong] *= factor
    found = evidence(given, right)
    found.wrong = list(range(num_wrong))
    column_signatures.factors(found)
    (finding,) = found.findings
    assert (finding.kind, finding.factor) == (kind, factor)
    assert ("weights" in finding.sentence) == has_note


@pytest.mark.parametrize(("width", "is_square"), [(3, True), (2, False)])
def test_transposed_blocks(width, is_square):
    right = np.random.default_rng(1).normal(size=(4, 3, width))
    found = evidence(right.transpose(0, 2, 1).reshape(right.shape), right)
    searches = [column_signatures.column_major, column_signatures.transposed]
    searches[not is_square](found)
    assert found.findings == []
    searches[is_square](found)
    assert [one.kind for one in found.findings] == ["transposed"]
    assert ("in memory" in found.findings[0].sentence) != is_square


@pytest.mark.parametrize("part", [1.0, 0.9])
def test_swapped_blocks(part):
    """Two groups hold each other's Jacobians, or only a part of them."""
    rng = np.random.default_rng(0)
    reference = rng.normal(size=(4, 3, 4))
    given = evidence(part * reference[..., [2, 3, 0, 1]], reference)
    given.columns = [Column(f"{name} {j}", name) for name in "ab" for j in range(2)]
    classify.swapped_blocks(given)
    assert [one.kind for one in given.findings] == ["swapped_blocks"] * (part == 1.0)


@pytest.mark.parametrize("is_one_factor", [True, False])
def test_factors_that_differ_from_point_to_point(is_one_factor):
    """One number for each point is a factor; other numbers for its rows are none."""
    rng = np.random.default_rng(1)
    reference = rng.normal(size=(4, 3, 2))
    factor = rng.uniform(2, 3, (4, 1 if is_one_factor else 3, 1))
    given = evidence(factor * reference, reference)
    column_signatures.varying_factors(given)
    assert [one.kind for one in given.findings] == ["factor"] * is_one_factor


def test_adjoints_of_twists_are_those_of_matrices():
    """hat(ad(x) y) is the commutator of hat(x) and hat(y)."""
    rng = np.random.default_rng(2)
    values, others = rng.normal(size=(2, 3, 6))
    yielded = row_signatures._algebras(
        evidence(np.ones((3, 2, 6)), np.ones((3, 2, 6)), None, values)
    )
    found = [ad for columns, ad, name in yielded if name == "SE(3)" and columns == list(range(6))]

    def hat(turn, move):
        matrix = np.zeros((4, 4))
        matrix[:3, :3] = np.cross(turn, -np.eye(3))
        matrix[:3, 3] = move
        return matrix

    orders = ((slice(0, 3), slice(3, 6)), (slice(3, 6), slice(0, 3)))
    for matrices, (turn, move) in zip(found, orders, strict=True):
        for ad, x, y in zip(matrices, values, others, strict=True):
            one, other = hat(x[turn], x[move]), hat(y[turn], y[move])
            bracket = hat((ad @ y)[turn], (ad @ y)[move])
            np.testing.assert_allclose(bracket, one @ other - other @ one, atol=1e-12)


def test_probes_of_the_gradient_checker_are_counted():
    some = np.zeros((1, 1))
    probes = [
        # agreed, its Jacobian if it did not give up; is the Jacobian wrong?
        *((True, some, False), (False, some, False), (False, None, False)),
        *((True, some, True), (False, some, True)),
    ]
    analytic = np.array([[[float(is_wrong)]] for *_, is_wrong in probes])
    space = JacobianDeviation(1 + analytic, np.ones((5, 1, 1)), np.zeros((5, 1, 1)), TOLERANCE)
    checker = [(agreed, found, None, "") for agreed, found, _ in probes]
    summary = _Check._summary(SimpleNamespace(tolerance=TOLERANCE), space, checker)
    assert summary == GradientCheckerSummary(
        num_probes=5, num_agreed=2, num_false_alarms=1, num_gave_up=1, num_overlooked=1
    )


@pytest.mark.parametrize(("size", "ratio"), [(0.9e-12, 1.0), (1.1e-12, 5.0)])
def test_a_row_of_rounding_has_no_factor(size, ratio):
    reference = np.array([[1.0, size], [0.0, 0.0]])
    found = column_signatures._ratios(reference * [2.0, 5.0], reference, 0)
    assert found == pytest.approx([2.0, ratio], rel=1e-9)
    assert column_signatures._ratios(0 * reference, 0 * reference, 0).tolist() == [1.0, 1.0]


@pytest.mark.parametrize(("factor", "has_note"), [(1.0005, False), (1.002, True)])
def test_swapped_rows_with_other_weights(factor, has_note):
    right = np.random.default_rng(0).normal(size=(4, 3, 2))
    found = evidence(right[:, [1, 0, 2]] * [[1.0], [factor], [1.0]], right)
    row_signatures.rows(found)
    assert ("before the weights" in found.findings[0].sentence) == has_note


def test_a_row_that_is_there_twice_is_no_order():
    right = np.random.default_rng(0).normal(size=(4, 3, 2))
    exchanged = evidence(right[:, [1, 0, 2]], right)
    row_signatures.rows(exchanged)
    assert [one.kind for one in exchanged.findings] == ["swapped_rows"]
    twice = evidence(right[:, [1, 1, 2]], right)
    row_signatures.rows(twice)
    assert twice.findings == []


@pytest.mark.parametrize("exponent", [1, -1])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("mean", "slope", "is_found"),
    [
        (1 + 0.9e-3, 0.0, True),
        (1 + 1.1e-3, 0.0, False),
        (1 - 0.9e-3, 0.0, True),
        (1 - 1.1e-3, 0.0, False),
        (1.0, 0.9e-3, True),
        (1.0, 1.1e-3, False),
    ],
)
def test_a_factor_is_a_parameter_to_a_thousandth(exponent, sign, mean, slope, is_found):
    rng = np.random.default_rng(1)
    right = rng.normal(size=(5, 2, 2))
    value = np.array([1.5, 2.0, 0.5, -3.0, 4.0])
    constant = sign * (mean + slope * np.linspace(-0.5, 0.5, 5))
    analytic = right.copy()
    analytic[..., 0] *= (constant * value**exponent)[:, None]
    given = evidence(analytic, right, points=np.stack([value, np.ones(5)], axis=1))
    given.wrong = [0]
    column_signatures.parameter_factors(given)
    assert [one.kind for one in given.findings] == ["scaled_by_parameter"] * is_found
    if is_found:
        verb = "multiplied" if exponent == 1 else "divided"
        minus = "" if sign == 1 else "minus "
        assert f"x 0: {verb} by {minus}x 0, " in given.findings[0].sentence


@pytest.mark.parametrize(("spread", "is_found"), [(2e-9, True), (0.5e-9, False)])
def test_a_parameter_that_stands_still_tells_nothing(spread, is_found):
    right = np.random.default_rng(2).normal(size=(4, 2, 1))
    value = 1 + spread * np.linspace(0, 1, 4)
    given = evidence(1.0005 * right, right, points=value[:, None])
    column_signatures.parameter_factors(given)
    assert bool(given.findings) == is_found


DEGREES = 180 / np.pi


@pytest.mark.parametrize(
    ("ratios", "kind"),
    [
        ([1.0, DEGREES, 1.0], "degrees"),
        ([1.0, 1 / DEGREES, DEGREES], "degrees"),
        ([2.0, DEGREES, 1.0], "whitening"),
        ([2.0, 3.0, 1.0], "whitening"),
    ],
)
def test_rows_with_factors_are_weights_or_degrees(ratios, kind):
    right = np.random.default_rng(3).normal(size=(4, 3, 2))
    given = evidence(right * np.array(ratios)[:, None], right)
    row_signatures.whitening(given)
    assert [one.kind for one in given.findings] == [kind]


@pytest.mark.parametrize(("width", "is_one"), [(3, True), (2, False)])
def test_one_matrix_is_judged_by_columns_that_others_predict(width, is_one):
    """A row that depends on the first parameter alone leaves M open without it."""
    right = np.random.default_rng(4).normal(size=(5, 2, width))
    right[:, 1, 1:] = 0.0
    given = np.array([[1.0, 0.5], [-0.3, 2.0]]) @ right
    assert row_signatures._is_one_matrix(given, right) == is_one
    given[0, 0, 0] += 1e-3
    assert not row_signatures._is_one_matrix(given, right)


@pytest.mark.parametrize(("predicted", "is_one"), [(2, False), (3, True)])
def test_half_of_the_columns_are_predicted(predicted, is_one):
    """Three columns have a row each; the others share the fourth and predict each other."""
    rng = np.random.default_rng(12)
    row = np.concatenate([np.arange(3), np.full(predicted, 3)])
    right = rng.normal(size=(3, 1, len(row))) * (np.arange(4)[:, None] == row)
    assert row_signatures._is_one_matrix(rng.normal(size=(4, 4)) @ right, right) == is_one


@pytest.mark.parametrize(("off", "is_kept"), [(0.0, True), (1e-3, False)])
def test_a_logarithm_keeps_its_residual(off, is_kept):
    """M = I + v w^T with w across r keeps r."""
    rng = np.random.default_rng(5)
    right, residuals, v, w = rng.normal(size=(4, 3, 5)), *rng.normal(size=(3, 4, 3))
    w -= residuals * ((w * residuals).sum(axis=1) / (residuals**2).sum(axis=1) - off)[:, None]
    matrices = np.eye(3) + v[:, :, None] * w[:, None, :]
    given = evidence(matrices @ right, right)
    given.residuals = residuals
    assert row_signatures._keeps_residual(given, list(range(5)), 3) == is_kept


@pytest.mark.parametrize("block", [[1.0, np.nan], [np.inf, 2.0]])
def test_a_start_is_finite(block):
    with pytest.raises(bundle.InputError, match="nan or infinity in block 1"):
        bundle.check_gradients(lambda _: (np.zeros(1), []), [[1.0], block])


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (0.99e-4, "float_precision"),
        (1.01e-4, "small_part"),
        (0.29, "small_part"),
        (0.31, "large_part"),
    ],
)
def test_errors_without_a_pattern_have_kinds_by_size(error, kind):
    rng = np.random.default_rng(5)
    right, signs = rng.normal(size=(4, 3, 2)), rng.choice([-1.0, 1.0], size=(4, 3, 2))
    scale = evidence(right, right).deviations.scale
    given = evidence(right + error * scale * signs, right)
    classify._by_size(given)
    assert [one.kind for one in given.findings] == [kind]


@pytest.mark.parametrize(("num_wrong", "kind"), [(3, "small_part"), (4, "float_precision")])
def test_last_digits_are_wrong_in_most_entries_or_in_some(num_wrong, kind):
    """Half of six entries of a column, and four of them."""
    right = np.random.default_rng(6).normal(size=(1, 6, 1))
    analytic = right.copy()
    analytic[0, :num_wrong] *= 1 + 1e-6
    given = evidence(analytic, right)
    classify._by_size(given)
    assert [one.kind for one in given.findings] == [kind]


@pytest.mark.parametrize(("source", "words"), [(-1, "just before"), (0, "the first point")])
def test_a_stale_jacobian_is_that_of_an_earlier_point(source, words):
    right = np.random.default_rng(7).normal(size=(5, 2, 2))
    held = np.maximum(np.arange(5) - 1, 0) if source else np.zeros(5, int)
    deviations = evidence(right[held], right).deviations
    found = classify.stale(deviations, deviations, TOLERANCE)
    assert found.kind == "stale" and words in found.sentence
    two_before = evidence(right[np.maximum(np.arange(5) - 2, 0)], right).deviations
    assert classify.stale(two_before, two_before, TOLERANCE) is None


@pytest.mark.parametrize(("count", "is_found"), [(4, False), (5, True)])
def test_five_numbers_tell_single_precision(count, is_found):
    right = np.random.default_rng(8).normal(size=(1, count, 1))
    given = evidence(right.astype(np.float32), right).deviations
    assert bool(classify.float_precision(given, ("x",))) == is_found


@pytest.mark.parametrize(("times", "is_found"), [(1010, True), (990, False)])
def test_a_term_of_rank_one_is_a_thousand_times_its_doubt(times, is_found):
    rng = np.random.default_rng(9)
    right, missing = rng.normal(size=(2, 2, 2)), np.array([[0.6, 0.0], [0.8, 0.0]])
    doubt = np.full((2, 2, 2), 1 / (2 * times))  # of norm 1 / times at each point
    given = evidence(right + missing @ [[0.6, 0.8], [0, 0]], right, doubt)
    column_signatures.rank_one(given)
    assert [one.kind for one in given.findings] == ["missing_term"] * is_found


@pytest.mark.parametrize(("step", "edge", "word"), [(1, 3, "next"), (-1, 0, "previous")])
def test_shifted_columns_have_one_edge_without_a_source(step, edge, word):
    right = np.random.default_rng(10).normal(size=(3, 2, 4))
    analytic = np.roll(right, -step, axis=2)
    analytic[..., edge] = 0.0
    given = evidence(analytic, right)
    column_signatures.shifted(given)
    assert [one.kind for one in given.findings] == ["shifted"]
    assert f"the {word} one" in given.findings[0].sentence
    analytic[..., 3 - edge] = 0.0  # the other edge has a source
    inner = evidence(analytic, right)
    column_signatures.shifted(inner)
    assert inner.findings == []


def test_a_column_of_zeros_has_the_median_size_of_the_others():
    found = evidence(np.zeros((1, 1, 4)), [[[1.0, 2, 9, 0]]]).deviations.scale
    np.testing.assert_allclose(found[0, 0], [1, 2, 9, 2])


@pytest.mark.parametrize(("off", "is_kept"), [(0.99e-6, True), (1.01e-6, False)])
def test_a_residual_is_kept_to_a_share_of_the_deviation(off, is_kept):
    """M = I + 0.1 y y^T moves r = x by `off`, and differs from I by 0.1."""
    right = np.random.default_rng(11).normal(size=(1, 3, 5))
    matrix = np.array([[1, 0, 0], [off, 1.1, 0], [0, 0, 1]])
    given = evidence(matrix @ right, right)
    given.residuals = np.array([[2.0, 0, 0]])
    assert row_signatures._keeps_residual(given, list(range(5)), 3) == is_kept


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ((("left", -1),), "Exp(d) Exp(w)"),
        ((("right", -1),), "Exp(w) Exp(d)"),
        ((("left", -1), ("right", 1)), "the right Jacobian of SO(3) instead of the left"),
        ((("right", -1), ("left", 1)), "the left Jacobian of SO(3) instead of the right"),
    ],
)
def test_each_perturbation_of_a_rotation_is_named(changes, words):
    """J_l(w) is the mean of Exp(s w) over s from 0 to 1, J_r(w) that of Exp(-s w)."""
    rng = np.random.default_rng(13)
    right, vectors = rng.normal(size=(4, 3, 3)), rng.normal(size=(4, 3))
    nodes, weights = np.polynomial.legendre.leggauss(20)
    analytic = right.copy()
    for k, w in enumerate(vectors):
        for side, power in changes:
            turns = Rotation.from_rotvec(np.outer((nodes + 1) / 2, w))
            turns = (turns if side == "left" else turns.inv()).as_matrix()
            mean = np.einsum("n,nij->ij", weights / 2, turns)
            analytic[k] = analytic[k] @ (mean if power == 1 else np.linalg.inv(mean))
    given = evidence(analytic, right, points=vectors)
    row_signatures.rotation_vectors(given)
    assert [one.kind for one in given.findings] == ["perturbation"]
    assert words in given.findings[0].sentence
