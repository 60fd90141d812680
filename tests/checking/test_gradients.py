"""`bundle.check_gradients`: manifolds, samples, wrong answers of the function, what is printed."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

import bundle
from bundle import InputError, _core
from tests.checking.reprojection import check_few, skew
from tests.printed import in_order


def rotate(blocks, wxyz=True):
    """R(q) X with a quaternion of any norm, and the derivatives."""
    q, point = blocks
    w, v = (q[0], q[1:]) if wxyz else (q[3], q[:3])
    squared = q @ q
    by_v = skew(v)
    cross = by_v @ point
    rotated = point + 2 * (w * cross + by_v @ cross) / squared
    d_w = 2 * cross / squared
    d_v = 2 * (
        (v @ point) * np.eye(3) - w * skew(point) + np.outer(v, point) - 2 * np.outer(point, v)
    )
    d_v = d_v / squared
    d_q = np.column_stack([d_w, d_v] if wxyz else [d_v, d_w])
    q_row = q if not wxyz else np.array([w, *v])
    d_q = d_q - 2 * np.outer(rotated - point, q_row) / squared
    matrix = np.eye(3) + 2 * (w * by_v + by_v @ by_v) / squared
    return rotated, [d_q, matrix]


UNIT = np.array([0.5, -0.1, 0.7, 0.5]) / np.linalg.norm([0.5, -0.1, 0.7, 0.5])
POINT = [1.0, -2.0, 0.5]


@pytest.mark.parametrize(
    ("manifold", "wxyz"), [("quaternion_wxyz", True), ("quaternion-xyzw", False), (None, True)]
)
def test_quaternions_in_both_orders(manifold, wxyz):
    assert check_few(lambda b: rotate(b, wxyz), [UNIT, POINT], [manifold, None])


def test_an_error_along_the_normal_is_seen_in_the_ambient_space_only():
    def function(blocks):
        residual, (d_q, d_point) = rotate(blocks)
        return residual, [d_q + np.outer([1, 2, 3], blocks[0]), d_point]

    manifolds = ["quaternion_wxyz", None]
    report = check_few(function, [UNIT, POINT], manifolds)
    assert report.kinds == {"normal"}
    assert "does not test" in " ".join(str(report).split())
    assert check_few(function, [UNIT, POINT], manifolds, ambient=False)


def test_a_right_perturbation_of_a_quaternion_is_named():
    def function(blocks):
        residual, (d_q, d_point) = rotate(blocks)
        w, x, y, z = blocks[0]
        plus = np.array([[-x, -y, -z], [w, z, -y], [-z, w, x], [y, -x, w]])
        return residual, [d_q @ plus @ d_point @ plus.T, d_point]

    report = check_few(function, [UNIT, POINT], ["quaternion_wxyz", None])
    assert report.kinds == {"perturbation"}, report


def transform(blocks):
    """An SE3 pose as COLMAP stores it, applied to a point."""
    pose, point = blocks
    rotated, (d_q, matrix) = rotate([pose[:4], point], wxyz=False)
    return rotated + pose[4:], [np.hstack([d_q, np.eye(3)]), matrix]


def test_se3_sphere_and_subset():
    pose = np.append(UNIT, [1.0, 0.0, -3.0])
    assert check_few(transform, [pose, POINT], ["se3", ("subset", [1])])
    direction = np.array([0.6, 0.0, 0.8])

    def dot(blocks):
        return [blocks[0] @ [1.0, 2.0, 3.0]], [np.array([[1.0, 2.0, 3.0]])]

    assert check_few(dot, [direction], ["sphere"])
    report = check_few(dot, [direction], ["sphere"], names=[("d", ["x", "y", "z"])])
    assert {verdict.name for verdict in report.parameters} >= {"x", "y", "z", "d direction 1"}


def test_a_swapped_pair_is_named_by_the_users_names():
    def function(blocks):
        (a,) = blocks
        jacobian = np.array([[2 * a[0], 3.0, 0.0], [0.0, a[2], a[1]]])
        return [a[0] ** 2 + 3 * a[1], a[1] * a[2]], [jacobian[:, [1, 0, 2]]]

    report = check_few(function, [[1.0, 2.0, 3.0]], names=[("p", ["u", "v", "w"])])
    assert [f.sentence for f in report.findings] == ["the columns of u and v are swapped"]
    assert [v.verdict for v in report.parameters] == ["wrong", "wrong", "correct"]
    assert {offender.parameter for offender in report.worst if offender.error} == {"u", "v"}
    assert f"sample {report.worst[0].details['sample']}" in str(report)
    assert repr(report).startswith("GradientReport: WRONG")


def test_derivatives_near_zero_are_no_false_alarms():
    """Ceres compares absolutely what is exactly zero on one side."""

    def function(blocks):
        (x,) = blocks
        return [1e9 + x[0], 1e-9 * np.sin(x[1])], [
            np.array([[1.0, 0.0], [0.0, 1e-9 * np.cos(x[1])]])
        ]

    assert check_few(function, [[3.0, 0.1]])


def changing(draw):
    def function(blocks):
        return blocks[0] + draw(), [np.eye(2)]

    return function


def sometimes_nothing(rng):
    return lambda: np.where(rng.random() < 0.5, np.nan, 0.0) * np.ones(2)


def test_a_function_that_is_not_deterministic_is_called_so(capfd):
    rng = np.random.default_rng(0)
    draws = [lambda size=size: size * rng.standard_normal(2) for size in (1e-3, 1e-6)]
    for draw in (*draws, sometimes_nothing(rng)):
        report = bundle.check_gradients(changing(draw), [[1.0, 2.0]])
        assert report.kinds == {"unstable"}
        assert len(report.findings) == 1
        assert not report
    captured = capfd.readouterr()
    assert captured.out + captured.err == ""  # Ceres logs each residual that differs


def test_sums_in_another_order_are_deterministic_enough():
    rng = np.random.default_rng(0)
    assert check_few(changing(lambda: 1e-13 * rng.random(2)), [[1.0, 2.0]])


def test_a_rough_residual_is_not_called_correct():
    def function(blocks):
        return np.floor(1e6 * blocks[0]) / 1e6, [np.eye(1)]

    report = bundle.check_gradients(function, [[1.0]])
    assert report.kinds == {"undecided"}
    assert report.num_undecided == report.num_checked == 10


def scalar(value, derivative, x):
    def function(blocks):
        with np.errstate(all="ignore"):
            y = blocks[0]
            return value(y), [np.atleast_2d(derivative(y[0]))]

    return bundle.check_gradients(function, [[x]], num_samples=1)


@pytest.mark.parametrize("distance", [0.0, 1e-12])
def test_at_a_kink_any_slope_between_both_sides_is_undecided(distance):
    def check(slope, bend=0.0):
        return scalar(
            lambda x: np.abs(x - distance) + bend * np.sin(x), lambda _: slope + bend, 0.0
        )

    for slope in (-1.0, 0.0, 1.0):
        for bend in (0.0, 3.0):
            report = check(slope, bend)
            assert report.kinds == {"undecided"}
            assert [(e.reason, e.count, e.places) for e in report.undecided] == [
                ("rough", 1, ("sample 0",))
            ]
    assert "undecided" not in check(5.0).kinds


@pytest.mark.parametrize("distance", [1e-3, 1e-6, 1e-9])
def test_a_pole_beside_the_point(distance):
    """1 / (x + d) with steps far above d looks as if its derivative were zero."""
    exact = -1 / distance
    report = scalar(lambda x: distance / (x + distance), lambda _: exact, 0.0)
    assert report.kinds <= {"correct", "undecided"}
    wrong = scalar(lambda x: distance / (x + distance), lambda _: -2 * exact, 0.0)
    assert not wrong.kinds & {"correct", "undecided"}
    assert wrong.worst[0].reference == pytest.approx(exact, rel=1e-6)


def test_a_residual_without_value_on_one_side_is_undecided():
    report = scalar(np.sqrt, lambda x: 0.5 / np.sqrt(x), 1e-13)
    assert report.kinds == {"undecided"}
    assert [entry.reason for entry in report.undecided] == ["no_value"]


def test_a_few_undecided_samples_are_counted_and_no_error():
    """A pole or a fold at one of the samples; a lie in the others is found all the same."""
    visited = []

    def function(blocks, factor=1.0, fold=-1.0):
        (x,) = blocks
        visited.append(x[0])
        return np.abs(x - fold), [factor * np.atleast_2d(np.sign(x[0] - fold))]

    bundle.check_gradients(function, [[0.3]], num_samples=8)
    samples = list(dict.fromkeys(visited[:9]))  # in this order, before any difference
    report = bundle.check_gradients(lambda b: function(b, fold=samples[3]), [[0.3]], num_samples=8)
    assert report
    assert report.num_undecided == 1
    assert in_order(" ".join(str(report).split()), "7", "1", "undecided")
    for fold in samples[0], samples[3]:
        lie = check_few(lambda b, fold=fold: function(b, 1.5, fold), [[0.3]])
        assert "factor" in lie.kinds
        assert lie.verdict == "wrong"


@pytest.mark.parametrize(("folded", "num_undecided"), [(1, 0), (2, 0), (3, 1), (4, 1)])
def test_a_sample_is_undecided_with_most_of_its_entries(folded, num_undecided):
    visited = []

    def function(blocks, fold=0.0):
        (x,) = blocks
        visited.append(x)
        off, slope = x - fold, np.ones(4)
        slope[:folded] = np.sign(off[:folded])
        return [slope @ off], [slope[None]]

    start = [[1.0, 2.0, 3.0, 4.0]]
    bundle.check_gradients(function, start, num_samples=5)
    third = visited[1 + 3]  # after the call that counts the residuals
    report = bundle.check_gradients(lambda b: function(b, third), start, num_samples=5)
    assert (report.verdict, report.num_undecided) == ("correct", num_undecided)


@pytest.mark.parametrize("num_samples", [1, 3, 10])
def test_a_start_on_a_kink_is_undecided(num_samples):
    def function(blocks, factor=1.0):
        return np.abs(blocks[0]), [factor * np.diag(np.sign(blocks[0]))]

    report = bundle.check_gradients(function, [[0.0, 2.0]], num_samples=num_samples)
    assert (report.verdict, report.ok, report.kinds) == ("undecided", False, {"undecided"})
    assert report.num_undecided == 1
    assert report.findings[0].columns == ("block 0 [0]",)
    assert check_few(function, [[0.1, 2.0]], radius=0.01).verdict == "correct"
    wrong = check_few(lambda b: function(b, 1.1), [[0.0, 2.0]])
    assert wrong.verdict == "wrong"


def test_single_precision_is_decided_as_far_as_it_goes():

    def linear(blocks, error=0.0):
        return blocks[0].astype("f4"), [np.diag([1 + error, 1.0])]

    def curved(blocks, error=0.0):
        a, b = blocks[0].astype("f4")
        value = np.array([np.sin(a) * np.exp(b)], "f4")
        by_a, by_b = np.cos(a) * np.exp(b), np.sin(a) * np.exp(b)
        return value, [np.array([[by_a * np.float32(1 + error), by_b]], "f4")]

    for function in (linear, curved):
        report = check_few(function, [[1.234567, 2.345678]])
        assert (report.verdict, report.tolerance) == ("correct", 1e-4)
        off = check_few(lambda b, f=function: f(b, 1e-3), [[1.234567, 2.345678]])
        assert off.verdict == "wrong"


def test_a_function_without_a_value_or_with_several_is_undecided():
    nothing = check_few(lambda b: (b[0] * np.nan, [np.eye(1)]), [[1.0]])
    rng = np.random.default_rng(0)
    several = check_few(changing(lambda: 1e-3 * rng.random(2)), [[1.0, 2.0]])
    assert {nothing.verdict, several.verdict} == {"undecided"}
    infinite = check_few(lambda b: (b[0], [np.array([[np.inf]])]), [[1.0]])
    assert infinite.verdict == "wrong"


def test_single_precision_is_no_derivative_of_zero():
    """A residual that stands still for small steps does not have the derivative zero there."""
    report = scalar(lambda x: np.float32(3) * x.astype(np.float32), lambda _: 3.0, 0.7234)
    assert report.kinds == {"correct"}
    off = scalar(lambda x: np.float32(3) * x.astype(np.float32), lambda _: 3.01, 0.7234)
    assert off.worst[0].error > 1e-3


def test_points_without_a_value_are_skipped():
    def function(blocks):
        (x,) = blocks
        with np.errstate(invalid="ignore"):
            return np.sqrt(x), [np.array([[0.5 / np.sqrt(np.abs(x[0]))]])]

    report = bundle.check_gradients(function, [[0.1]], radius=1.0, num_samples=40)
    assert report
    assert report.num_skipped > 0
    assert report.num_checked + report.num_skipped == 40
    nothing = check_few(function, [[-1.0]], radius=1e-3)
    assert nothing.kinds == {"not_finite"}
    assert set(dataclasses.asdict(nothing.gradient_checker).values()) == {0}


def test_a_small_error_is_seen_in_the_values():
    values = [np.array([[1234567.5]])]
    report = check_few(lambda b: (1234567.0 * b[0], values), [[1.0]])
    assert report.verdict == "wrong" and "1234567.5" in str(report) and "1234567 " in str(report)


def test_a_jacobian_that_is_not_finite():
    report = check_few(lambda b: (b[0], [np.array([[np.nan]])]), [[1.0]])
    assert report.kinds == {"not_finite"}


def good(blocks):
    return blocks[0], [np.eye(2)]


@pytest.mark.parametrize(
    ("function", "blocks", "manifolds", "settings", "message"),
    [
        (
            lambda b: (b[0], [np.ones((3, 2))]),
            [[1, 2]],
            None,
            {},
            "0: expected shape (2, 2)",
        ),
        (lambda b: (b[0][:1], [np.ones((2, 1))]), [[1, 2]], None, {}, "transposed?"),
        (
            lambda b: (b[0][:2], [np.ones((2, 6))]),
            [[0, 0, 0, 1, 0, 0, 0]],
            ["se3"],
            {},
            "expected shape (2, 7), found (2, 6); tangent='gtsam' takes tangent coordinates",
        ),
        (lambda b: (b[0], []), [[1, 2]], None, {}, "expected 1 Jacobian,"),
        (lambda b: b[0].sum(), [[1, 2]], None, {}, "expected (residual, list of Jacobians)"),
        (lambda b: (b[0][:0], [np.eye(2)]), [[1, 2]], None, {}, "at least one residual"),
        (good, [], None, {}, "at least one block"),
        (good, [[1, 2]], ["se3"], {}, "se3 expects a block of 7 numbers, found 2"),
        (good, [[1, 2]], ["so3"], {}, "found 'so3'"),
        (good, [[1, 2]], ["SE2"], {}, 'tangent="gtsam"'),
        (good, np.array([1.0, 2.0]), None, {}, "blocks: expected a list of arrays"),
        (good, np.array(1.0), None, {}, "blocks: expected a list of arrays"),
        (good, {"a": [1, 2]}, None, {}, "blocks: expected a list of arrays"),
        (good, good, None, {}, "; try lambda b: (residual(b[0]), [jacobian(b[0])])"),
        (lambda b: (b[0], np.eye(2)), [[1, 2]], None, {}, "found 2; try [jacobian]"),
        (lambda a, b: good([a + b]), [[1, 2], [3]], None, {}, "one argument, the blocks"),
        (lambda a, b: good([a + b]), [[1, 2]], None, {}, "one argument, the blocks"),
        (lambda: good([[1, 2]]), [[1, 2]], None, {}, "one argument, the blocks"),
        (good, [[1, 2]], [None, None], {}, "manifolds: expected 1, one per block, found 2"),
        (good, [[1, 2]], [("subset", [2])], {}, "entries from 0 to 1"),
        (good, [[1, 2]], ["angle_axis"], {}, "3 numbers, found 2"),
        (good, [[1, 2]], None, {"names": [("a", ["x"])]}, "expected 2 names for a, found 1"),
        (good, [[1, 2]], None, {"num_samples": 0}, "num_samples"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(function, blocks, manifolds, settings, message):
    with pytest.raises(InputError) as error:
        check_few(function, blocks, manifolds, **settings)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_what_the_function_raises_comes_through():
    calls = []

    def function(blocks):
        calls.append(0)
        if len(calls) > 30:
            raise RuntimeError("of the user")
        return good(blocks)

    with pytest.raises(RuntimeError, match="of the user"):
        check_few(function, [[1.0, 2.0]])
    assert len(calls) == 31


def root(blocks, factor=1.0):
    """A residual of math.sqrt, which raises below 0."""
    x, y = blocks[0]
    return [math.sqrt(x) * y], [[[factor * 0.5 / math.sqrt(x) * y, math.sqrt(x)]]]


@pytest.mark.parametrize("x", [1e-3, 0.05, 2.0])
def test_an_exception_outside_the_domain_is_no_value(x):
    report = check_few(root, [[x, 3.0]])
    assert (report.verdict, report.num_skipped) == ("correct", 0)
    wide = bundle.check_gradients(root, [[x, 3.0]], radius=1.0, num_samples=30)
    assert wide.ok and wide.num_skipped > 0
    wrong = check_few(lambda b: root(b, -1.0), [[x, 3.0]])
    assert wrong.kinds == {"sign"}


def test_an_exception_at_the_given_point_comes_through():
    with pytest.raises(ValueError, match="math domain error"):
        check_few(root, [[-1.0, 3.0]])


def test_an_exception_beside_a_zero_that_only_a_signature_tries():
    """The residual has a value with x = 0, but none at steps below."""

    def function(blocks):
        x, y = blocks[0]
        if x < 0:
            raise IndexError("outside the table")
        return [np.sqrt(x) ** 3 * y], [[[1.5 * np.sqrt(x) * y + y**2, np.sqrt(x) ** 3]]]

    report = check_few(function, [[2.0, 3.0]])
    assert report.verdict == "wrong"
    assert report.findings[0].columns == ("block 0 [0]",)


@pytest.mark.parametrize("size", [1e-250, 1e-160, 1e160, 1e250])
def test_the_size_of_a_residual_does_not_matter(size):
    def linear(blocks, factor=1.0):
        matrix = size * np.array([[1.0, 2.0], [-3.0, 0.5]])
        return matrix @ blocks[0], [matrix * [1.0, factor]]

    assert check_few(linear, [[0.3, 0.2]]).ok
    wrong = check_few(lambda b: linear(b, -1.0), [[0.3, 0.2]])
    assert (wrong.kinds, wrong.findings[0].columns) == ({"sign"}, ("block 0 [1]",))


def test_the_second_reference_against_formulas():
    """Its bound on its own error holds, also close to a singularity."""
    for x in (1e-6, 1e-3, 1.0, 50.0, 1e5):

        def function(blocks, jacobians):
            del jacobians
            with np.errstate(all="ignore"):
                value = np.array([1 / blocks[0][0], np.log(blocks[0][0]), np.sin(blocks[0][0])])
            return (value, None) if np.isfinite(value).all() else None

        found, bound, _, _ = _core.richardson_jacobian(
            function, 3, [np.array([x])], [("euclidean", [])]
        )
        exact = np.array([-1 / x**2, 1 / x, np.cos(x)])
        assert (np.abs(found[:, 0] - exact) <= bound[:, 0] + 1e-15 * np.abs(exact)).all()
        assert (bound[:2, 0] <= 1e-7 * np.abs(exact[:2])).all()
