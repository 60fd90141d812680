"""Entries that are a derivative at another scale, or on one side, are undecided and not wrong."""

from types import SimpleNamespace

import numpy as np
import pytest

import bundle
from bundle.analysis.diagnosis.shutter_modes import shutter_jacobians
from bundle.checking.jacobian_deviation import JacobianDeviation
from bundle.checking.jacobians import ReprojectionLines
from bundle.checking.residual_blocks import Manifold
from bundle.checking.step_curve import Line, SampleLines, SamplePoint, acquitted, walk
from bundle.synthetic.video_scene import film
from tests.checking.reprojection import check_few


def line(function, center=0.0):
    return walk(lambda h: np.atleast_1d(function(center + h)), np.atleast_1d(function(center)), 1.0)


def is_acquitted(function, claimed, right):
    claimed = np.array([float(claimed)])
    return bool(acquitted(line(function), claimed, np.abs(claimed - right), 1.0)[0])


def test_lines_of_observations_that_are_read_row_by_row():
    options = bundle.SceneOptions(
        scene="orbit", num_images=3, num_points=30, rolling_shutter=0.8, seed=1
    )
    problem = film(options).ground_truth
    rows = np.arange(0, problem.num_observations, 9)
    motion, by_point, _ = shutter_jacobians(problem, rows)
    expected = np.concatenate([motion[:, :, 6:], by_point], axis=2)
    lines = ReprojectionLines(problem, rows, np.full((len(rows), 3), 0.3))
    first = 6 + len(bundle.camera_models()[problem.camera_models[0]])
    for k in range(len(rows)):
        for column in range(9):  # twist, point
            found = lines.line(k, first + column)
            slope = found.central[np.argmin(np.abs(found.steps - 1e-5))]
            np.testing.assert_allclose(slope, expected[k, :, column], rtol=1e-5, atol=1e-3)


def test_a_slope_of_one_side_is_a_derivative():
    def kink(x):
        return x + x**2 + (3 * x if x > 0 else 0)

    assert is_acquitted(kink, 1, 2.5)
    assert is_acquitted(kink, 4, 2.5)
    for claimed in (-1, 0, 2, 5, 1 + 5e-6):
        assert not is_acquitted(kink, claimed, 2.5)
    assert is_acquitted(kink, 1 + 2e-7, 2.5)


def test_a_slope_below_which_digits_cancel_is_a_derivative():
    def naive(x):
        return x + (1 - np.cos(1e-3 * x)) / 1e-6 / (1 if abs(x) > 1e-7 else 2) + 1e-12 * (x > 0)

    assert is_acquitted(naive, 1, 1.2)
    assert not is_acquitted(naive, 1.1, 1.2)


@pytest.mark.parametrize("claimed", [0.9, 1 + 1e-4, 1 + 1e-6, -1, 0])
@pytest.mark.parametrize("bend", [0.1, 10, 1e4])
def test_a_wrong_slope_of_a_smooth_function_is_not(claimed, bend):
    def smooth(x):
        return np.sin(x) + bend * x**2 + bend * x**3

    assert not is_acquitted(smooth, claimed, 1.0)


def test_a_residual_too_coarse_for_its_slope_does_not_prove_a_slope_of_zero():
    assert not is_acquitted(lambda x: 1e3 + 1e-8 * (x - 1), 0, 1e-8)


def test_a_small_mistake_is_not_excused_by_a_slope_nearer_to_it():
    """The slope beyond the bend is 1: the mistake is 3e-7 below it, the derivative 5e-7 above."""

    def bent(x):
        return x + 5e-7 * 1e-6 * np.tanh(x / 1e-6)

    assert is_acquitted(bent, 1, 1 + 5e-7)
    assert not is_acquitted(bent, 1 - 3e-7, 1 + 5e-7)


def test_a_few_quiet_steps_do_not_make_a_noisy_residual_quiet():
    steps = 0.5 ** np.arange(7, 51)
    center, claimed = np.zeros(1), np.array([1.001])
    noise = np.where(np.arange(44) % 2, 1e-9, -1e-9)
    noise[-7:] = 0.0
    noise[16:20] = 1e-3 * steps[16:20]  # by chance the slope that is claimed
    sides = [(sign * (steps + noise))[:, None] for sign in (1, -1)]
    assert 1e-3 * steps[16] < 1e-9 < 1e-3 * steps[0]
    assert not acquitted(Line(steps, center, *sides), claimed, np.array([1e-3]), 1.0)[0]


def test_steps_without_a_value_prove_nothing():
    found = walk(lambda h: None if abs(h) > 1e-3 else np.array([h]), np.zeros(1), 1.0)
    assert np.isnan(found.central[0, 0])
    assert acquitted(found, np.ones(1), np.ones(1), 1.0)[0]
    nothing = walk(lambda _: None, np.zeros(1), 1.0)
    assert not acquitted(nothing, np.ones(1), np.ones(1), 1.0)[0]


def kinked(x):
    """Return residuals (2,): with slopes of 1 and 4 on the sides of 0, and with a slope of 1."""
    return np.array([x + x**2 + (3 * x if x > 0 else 0), x])


@pytest.mark.parametrize(
    ("claimed", "doubt"),
    [([1.0, 1.0], [1.5, 0.0]), ([2.0, 1.0], [0.0, 0.0]), ([1.0, np.nan], [0.0, 0.0])],
)
def test_a_column_of_numbers_may_appeal(claimed, doubt):
    """The deviation of an entry that is a slope of one side becomes its uncertainty."""
    user = SimpleNamespace(core=lambda blocks, _: (kinked(blocks[0][0]),))
    layout = SimpleNamespace(manifolds=[Manifold.parse(None, 1)])
    lines = SampleLines([SamplePoint(user, [np.zeros(1)])], [np.zeros(2)], layout)
    given = JacobianDeviation(
        np.array(claimed).reshape(1, 2, 1), np.array([[[2.5], [1.0]]]), np.zeros((1, 2, 1)), 1e-7
    )
    found = lines.appealed(given, [0], 1e-7, along_manifold=False)
    np.testing.assert_array_equal(found.uncertainty[0, :, 0], doubt)


@pytest.mark.parametrize(("doubt", "is_known"), [(0.1, True), (np.inf, False), (np.nan, False)])
def test_a_reference_without_a_parameter_is_known_in_all_entries(monkeypatch, doubt, is_known):
    user = SimpleNamespace(core=lambda blocks, _: blocks, sizes=[2, 1])
    blocks = [np.array([1.0, 2.0]), np.array([3.0])]

    def reference(self, _):
        return np.concatenate(self.blocks), np.array([[0.1, doubt, 0.1]])

    monkeypatch.setattr(SamplePoint, "reference", reference)
    found = SamplePoint(user, blocks).reference_without(1, [])
    assert (found is not None) == is_known
    if is_known:
        assert found.tolist() == [1, 0, 3]


def huber(blocks):
    """A robust weight exactly at its kink, beside a parameter across it."""
    x, y = blocks[0]
    length = abs(x)
    root = 1.0 if length <= 2 else (2 / length) ** 0.5
    slope = 0.0 if length <= 2 else -0.5 * root / x
    return [root * x, y], [np.array([[root + slope * x, 0], [0, 1]])]


def test_a_kink_is_undecided_and_a_mistake_beside_it_is_found():
    assert bundle.check_gradients(huber, [[2.0, 1.0]], num_samples=1).verdict == "undecided"

    def wrong(blocks):
        residual, (jacobian,) = huber(blocks)
        return residual, [jacobian * [1, -1]]

    report = bundle.check_gradients(wrong, [[2.0, 1.0]], num_samples=1)
    assert (report.verdict, report.kinds) == ("wrong", {"sign"})


def single(blocks, factor=1.0):
    """A curve computed in single precision, with Jacobians in double precision."""
    a, b = blocks[0]
    times = np.linspace(0.1, 1, 5)
    e = np.exp(-b * times)
    residual = (np.float32(a) * e.astype(np.float32)).astype(np.float32)
    return residual, [np.column_stack([e, -factor * a * times * e])]


def test_a_residual_in_single_precision_is_judged_at_its_own():
    report = check_few(single, [[1.3, 0.7]])
    assert (report.verdict, report.tolerance) == ("correct", 1e-4)
    assert "single precision" in report.subject
    assert check_few(single, [[1.3, 0.7]], tolerance=0.01).tolerance == 0.01
    for factor, kind in ((2.0, "factor"), (-1.0, "sign"), (1.02, "factor")):
        report = check_few(lambda b, f=factor: single(b, f), [[1.3, 0.7]])
        assert report.kinds == {kind}


def test_a_residual_of_plain_numbers_is_not_in_single_precision():
    report = bundle.check_gradients(lambda b: (b[0], [np.eye(2)]), [[0.5, 3.0]], num_samples=1)
    assert (report.verdict, report.tolerance) == ("correct", 1e-7)


def test_a_function_that_fails_at_zero_is_still_named():
    """Signatures try parameters at zero, where a function of its users may divide by them."""

    def inverse(blocks):
        (x, y), (z,) = blocks
        return [1 / float(x) + y * z], [np.array([[-1 / x**2, 2.5 * z + x]]), np.array([[y]])]

    report = bundle.check_gradients(inverse, [[2.0, 3.0], [1.5]])
    assert report.verdict == "wrong"
    (finding,) = report.findings  # y's column alone: 2.5 z + x in place of z
    assert (finding.kind, finding.columns, finding.rows) == ("large_part", ("block 0 [1]",), (0,))
    assert (report.num_checked, report.num_undecided) == (10, 0)
    counts = {one.name: (one.num_entries, one.num_wrong) for one in report.parameters}
    assert counts == {"block 0 [0]": (10, 0), "block 0 [1]": (10, 10), "block 1": (10, 0)}


@pytest.mark.parametrize("scale", [1e-10, 1e-8, 1e-5, 1e5])
def test_a_function_of_tiny_parameters_is_not_accused(scale):
    rng = np.random.default_rng(3)
    linear = rng.normal(size=(3, 3))

    def cubic(blocks):
        x = blocks[0] / scale
        return linear @ x + x**3, [(linear + np.diag(3 * x**2)) / scale]

    def mistaken(blocks):
        residual, (jacobian,) = cubic(blocks)
        return residual, [jacobian * [1, 1, 1.001]]

    for _ in range(5):
        blocks = [rng.normal(size=3) * scale]
        assert check_few(cubic, blocks).verdict != "wrong"
        assert check_few(mistaken, blocks).verdict == "wrong"


def test_small_derivatives_of_a_residual_in_single_precision_are_not_accused():
    """Differences of a rounded residual agree at several steps, and are all wrong."""
    rng = np.random.default_rng(4)

    def rounded(blocks):
        x = blocks[0].astype(np.float32).astype(float)
        weights = np.array([1.0, 1e-3, 1e-5])
        residual = np.array([100 + np.sin(x) @ weights, 7 * x[0]])
        jacobian = np.array([np.cos(x) * weights, [7, 0, 0]])
        return residual.astype(np.float32).astype(float), [jacobian.astype(np.float32)]

    for _ in range(10):
        assert check_few(rounded, [rng.normal(0, 0.1, 3)]).verdict != "wrong"


def test_central_differences_are_extrapolated_by_their_squares():
    """The residual is a h + h^3 at three steps, and does not change at smaller ones."""
    steps = 0.5 ** np.arange(11)
    plus = np.where(steps > 0.2, 0.7 * steps + steps**3, 0.0)[:, None]
    line = Line(steps, np.zeros(1), plus, -plus)
    one = np.ones(1)
    assert acquitted(line, 0.7 * one, one, one).all()
    assert not acquitted(line, 0.71 * one, one, one).any()
