"""Mistakes that sit in the layout of a block or in the rows are called by their names."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

import bundle
from bundle import _core
from tests.checking.reprojection import check_few, left_jacobian, skew
from tests.checking.test_gradients import POINT, UNIT, rotate, transform


def six(blocks, change, order):
    """A point moved by rotation vector and translation, in either order, beside other numbers."""
    pose, point = blocks
    w, t = (pose[:3], pose[3:6]) if order == "rotation first" else (pose[3:6], pose[:3])
    turn = Rotation.from_rotvec(w).as_matrix()
    by_w = -skew(turn @ point) @ left_jacobian(w) @ change(w)
    columns = [by_w, np.eye(3)] if order == "rotation first" else [np.eye(3), by_w]
    residual = pose[6] * (turn @ point + t)
    jacobian = np.hstack([*(pose[6] * c for c in columns), (residual / pose[6])[:, None]])
    return residual, [jacobian, pose[6] * turn]


CHANGES = {
    "Exp(d) Exp(w)": lambda w: np.linalg.inv(left_jacobian(w)),
    "Exp(w) Exp(d)": lambda w: np.linalg.inv(left_jacobian(-w)),
    "the right Jacobian of SO(3)": lambda w: np.linalg.inv(left_jacobian(w)) @ left_jacobian(-w),
}


@pytest.mark.parametrize("order", ["rotation first", "translation first"])
@pytest.mark.parametrize("words", CHANGES)
def test_a_perturbation_is_named_in_a_block_that_is_not_split(words, order):
    start = [np.array([0.3, -0.2, 0.5, 0.4, 0.7, -0.6, 1.5]), np.array([0.5, -0.4, 2.0])]
    assert check_few(lambda b: six(b, lambda _: np.eye(3), order), start)
    report = check_few(lambda b: six(b, CHANGES[words], order), start)
    first = 0 if order == "rotation first" else 3
    assert [(f.kind, f.columns) for f in report.findings] == [
        ("perturbation", tuple(f"block 0 [{first + j}]" for j in range(3)))
    ]
    assert words in report.findings[0].sentence


def twist_matrix(twist, turn, move):
    matrix = np.zeros((4, 4))
    matrix[:3, :3], matrix[:3, 3] = skew(twist[turn]), twist[move]
    return expm(matrix)


@pytest.mark.parametrize(("turn", "move"), [(slice(0, 3), slice(3, 6)), (slice(3, 6), slice(0, 3))])
def test_a_perturbation_of_a_twist_is_named(turn, move):
    """By d of Exp(d) Exp(twist), not by the twist's own numbers."""

    def function(blocks):
        moved = (twist_matrix(blocks[0], turn, move) @ [*POINT, 1])[:3]
        jacobian = np.zeros((3, 6))
        jacobian[:, turn], jacobian[:, move] = -skew(moved), np.eye(3)
        return moved, [jacobian]

    report = check_few(function, [[0.3, -0.2, 0.5, 0.4, 0.7, -0.6]])
    assert report.kinds == {"perturbation"}
    assert len(report.findings[0].columns) == 6


@pytest.mark.parametrize("place", [0, 3])
@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_a_tangent_jacobian_with_a_zero_column_is_named(place, scale):
    def function(blocks, pad=True):
        residual, (by_pose, by_point) = transform(blocks)
        if pad:
            by_rotation = -skew(residual - blocks[0][4:]) * scale
            by_pose = np.hstack([np.insert(by_rotation, place, 0, axis=1), np.eye(3)])
        return residual, [by_pose, by_point]

    start = [np.append(UNIT, [1.0, 2.0, -3.0]), POINT]
    report = check_few(function, start, ["se3", None])
    assert [f.kind for f in report.findings] == ["padded"]
    names = ["qx", "qy", "qz", "qw", "tx", "ty", "tz"]
    assert report.findings[0].columns == tuple(f"block 0 {name}" for name in names)
    assert check_few(lambda b: function(b, pad=False), start, ["se3", None])


def test_a_padded_quaternion_and_one_that_lacks_a_column_are_told_apart():
    def function(blocks, pad):
        residual, (by_q, by_point) = rotate(blocks)
        padded = np.hstack([-skew(residual), np.zeros((3, 1))])
        by_q = padded if pad else by_q * [1, 1, 1, 0]
        return residual, [by_q, by_point]

    manifolds = ["quaternion_wxyz", None]
    padded = check_few(lambda b: function(b, True), [UNIT, POINT], manifolds)
    assert padded.kinds == {"padded"}
    lacking = check_few(lambda b: function(b, False), [UNIT, POINT], manifolds)
    assert lacking.kinds == {"zero"}


def test_a_padded_quaternion_hides_no_mistake_of_another_block():
    def function(blocks):
        residual, (_, by_point) = rotate(blocks)
        return residual, [np.hstack([-skew(residual), np.zeros((3, 1))]), -by_point]

    report = check_few(function, [UNIT, POINT], ["quaternion_wxyz", None])
    assert "sign" in report.kinds


@pytest.mark.parametrize(
    ("manifold", "wxyz"), [("quaternion_wxyz", True), ("quaternion_xyzw", False)]
)
def test_a_quaternion_in_the_order_of_the_other_library_is_named(manifold, wxyz):
    def function(blocks):
        residual, (by_q, by_point) = rotate(blocks, wxyz)
        return residual, [np.roll(by_q, -1 if wxyz else 1, axis=1), by_point]

    report = check_few(function, [UNIT, POINT], [manifold, None])
    assert report.kinds == {"quaternion_order"}
    found = "first column last" if wxyz else "last column first"
    assert found in report.findings[0].sentence


def curve(blocks):
    a, b, c = blocks[0]
    times = np.array([0.0, 0.5, 1.0, 2.0])
    e = np.exp(-b * times)
    return a * e + c, [np.column_stack([e, -a * times * e, np.ones(4)])]


@pytest.mark.parametrize(
    ("order", "words"),
    [([1, 0, 2, 3], "swapped: 0 holds that of 1, 1"), ([1, 2, 0, 3], "in a wrong order")],
)
def test_rows_in_a_wrong_order_are_named(order, words):
    def function(blocks):
        residual, (jacobian,) = curve(blocks)
        return residual, [jacobian[order]]

    report = check_few(function, [[1.0, 0.7, 2.0]])
    assert [f.kind for f in report.findings] == ["swapped_rows"]
    assert words in report.findings[0].sentence


def weighed(weights, of_residual):
    """The weights on the residual, or on the Jacobian, alone."""

    def function(blocks):
        residual, (jacobian,) = curve(blocks)
        if of_residual:
            return weights @ residual, [jacobian]
        return residual, [weights @ jacobian]

    return check_few(function, [[1.0, 0.7, 2.0]])


@pytest.mark.parametrize("of_residual", [True, False])
def test_weights_on_one_side_alone_are_named(of_residual):
    rng = np.random.default_rng(0)
    diagonal = np.diag([10.0, 2, 3, 0.5])
    for weights in (diagonal, np.linalg.cholesky(diagonal + 0.3 * np.ones((4, 4))).T):
        report = weighed(weights, of_residual)
        assert [f.kind for f in report.findings] == ["whitening"]
        assert "square root of the information" in report.findings[0].sentence
    (finding,) = weighed(10 * np.eye(4), of_residual).findings
    assert finding.kind == "factor"
    assert ("only the residual" if of_residual else "only the Jacobians") in finding.sentence
    # A matrix that changes from point to point is another mistake.

    def changing(blocks):
        residual, (jacobian,) = curve(blocks)
        return residual, [(np.eye(4) + 0.1 * rng.standard_normal((4, 4))) @ jacobian]

    assert "whitening" not in check_few(changing, [[1.0, 0.7, 2.0]]).kinds


def test_a_derivative_of_a_logarithm_without_its_jacobian_is_named():
    measured = Rotation.from_rotvec([0.3, -0.5, 0.2])
    weights = np.array([[3.0, 0.4, 0.1], [0, 2.0, -0.5], [0, 0, 5.0]])

    def function(blocks, right):
        b = Rotation.from_quat(blocks[0])
        error = (measured.inv() * b).as_rotvec()
        inverse = np.linalg.inv(left_jacobian(-error)) if right else np.eye(3)
        return weights @ error, [weights @ inverse]

    graph = bundle.FactorGraph()
    graph.add_variable(
        "b", _core.retract("so3", measured.as_quat(), np.array([0.2, 0.4, -0.3])), "so3"
    )
    for right in (True, False):
        graph.add_factor(bundle.FunctionFactor(["b"], lambda v, right=right: function(v, right)))
    report = graph.check_gradients()
    assert [r.kinds for r in report.reports.values()] == [{"correct"}, {"logarithm"}]


def relative_pose(mode):
    """The user's own error between two poses, rotation and translation, whitened."""
    rng = np.random.default_rng(5)
    a = np.append(Rotation.random(random_state=rng).as_quat(), rng.normal(size=3))
    b = np.append(Rotation.random(random_state=rng).as_quat(), rng.normal(size=3))
    measured = Rotation.from_quat(a[:4]).inv() * Rotation.from_quat(b[:4])
    measured *= Rotation.from_rotvec([0.2, -0.1, 0.3])
    weights = np.diag([20.0, 20, 20, 10, 10, 10])

    def function(values):
        first, second = (Rotation.from_quat(v[:4]) for v in values)
        error = (measured.inv() * first.inv() * second).as_rotvec()
        moved = first.inv().apply(values[1][4:] - values[0][4:])
        inverse = np.eye(3) if mode == "no logarithm" else np.linalg.inv(left_jacobian(-error))
        by_a, by_b = np.zeros((6, 6)), np.zeros((6, 6))
        by_a[:3, :3] = -inverse @ (second.inv() * first).as_matrix()
        by_a[3:] = np.hstack([skew(moved), -np.eye(3)])
        by_b[:3, :3], by_b[3:, 3:] = inverse, (first.inv() * second).as_matrix()
        if mode == "rows":
            by_a[[0, 3]], by_b[[0, 3]] = by_a[[3, 0]], by_b[[3, 0]]
        if mode == "lever arm":
            by_a[3:, :3] *= -1
        if mode == "transposed":
            by_b[3:, 3:] = by_b[3:, 3:].T
        return weights @ np.append(error, moved), [weights @ by_a, weights @ by_b]

    graph = bundle.FactorGraph()
    graph.add_variable("a", a, "se3")
    graph.add_variable("b", b, "se3")
    graph.add_factor(bundle.FunctionFactor(["a", "b"], function))
    (report,) = graph.check_gradients(num_samples=2).reports.values()
    return report


@pytest.mark.parametrize(
    ("mode", "kind", "words"),
    [
        ("right", "correct", ""),
        ("no logarithm", "logarithm", "J_r^-1"),
        ("rows", "swapped_rows", "before the weights: 0 holds that of 3, 3 holds that of 0"),
        ("lever arm", "sign", "in residual"),
        ("transposed", "frame", "'b' translation x"),
    ],
)
def test_mistakes_in_some_rows_of_a_relative_pose_are_named(mode, kind, words):
    report = relative_pose(mode)
    assert report.kinds == {kind}
    assert all(words in finding.sentence for finding in report.findings)


ROOT = np.linalg.cholesky([[4.0, 1, 0.5], [1, 3, 0.2], [0.5, 0.2, 9]]).T


def separable(blocks):
    """Residuals of which the second depends on one parameter alone."""
    (x,) = blocks
    plain = np.sin(x) * [1, 2, 3] + x[::-1] ** 2
    return plain, np.diag(np.cos(x) * [1, 2, 3]) + np.fliplr(np.diag(2 * x[::-1]))


@pytest.mark.parametrize("power", [-1, 1], ids=["residual only", "twice"])
def test_weights_are_named_where_a_residual_depends_on_one_parameter(power):
    def weighted(blocks):
        plain, jacobian = separable(blocks)
        return ROOT @ plain, [np.linalg.matrix_power(ROOT, 1 + power) @ jacobian]

    report = bundle.check_gradients(weighted, [np.array([0.3, 0.8, 1.4])], num_samples=5)
    assert report.kinds == {"whitening"}


def test_a_matrix_that_any_square_jacobian_has_is_no_weight():
    """Every square Jacobian of a linear function is a constant matrix times the right Jacobian."""
    matrix = np.array([[1.0, 2, 3], [4, 5.5, 6], [7, 8, 9.7]])
    wrong = matrix @ [[1, 0.3, 0], [0.2, 1, 0.5], [0.1, 0, 1]]
    report = check_few(lambda b: (matrix @ b[0], [wrong]), [np.array([1.0, 2, 3])])
    assert report.verdict == "wrong" and "whitening" not in report.kinds


@pytest.mark.parametrize("row", [0, 1])
def test_a_residual_in_degrees_is_named(row):
    def bearing(blocks):
        at, landmark = blocks
        x, y = landmark - at
        square = x * x + y * y
        angle, length = np.degrees(np.arctan2(y, x)), np.sqrt(square)
        by_angle, by_length = [-y / square, x / square], [x / length, y / length]
        order = [0, 1] if row == 0 else [1, 0]
        jacobian = np.array([by_angle, by_length])[order]  # the first lacks 180 / pi
        return np.array([angle, length])[order], [-jacobian, jacobian]

    report = check_few(bearing, [np.array([1.0, 2]), np.array([9.0, 5])])
    assert report.kinds == {"degrees"} and f"residual {row}" in report.findings[0].sentence


def test_a_block_stored_by_columns_is_named_where_it_has_zeros():
    def projection(blocks):
        (x, y, z), (f,) = blocks
        right = f * np.array([[1 / z, 0, -x / z**2], [0, 1 / z, -y / z**2]])
        return f * np.array([x / z, y / z]), [right.T.reshape(2, 3), np.array([[x / z], [y / z]])]

    report = check_few(projection, [np.array([0.3, -0.4, 2.0]), np.array([500.0])])
    assert report.kinds == {"transposed"}


def seen(blocks, spoil):
    """A pixel of a point in the frame of a camera, with a mistake."""
    x, y, z = blocks[0] + blocks[1]
    jacobian = np.array([[1, 0, -x / z], [0, 1, -y / z]]) / z
    return np.array([x, y]) / z, [jacobian, spoil(jacobian, z)]


@pytest.mark.parametrize("power", [1, 2, -1])
def test_a_missing_depth_is_a_factor_that_varies(power):
    start = [np.array([0.3, -0.4, 1.5]), np.array([0.2, 0.1, 2.5])]
    report = check_few(lambda b: seen(b, lambda j, z: j * z**power), start)
    (finding,) = report.findings
    assert (finding.kind, finding.factor) == ("factor", None)
    assert finding.columns == tuple(f"block 1 [{j}]" for j in range(3))


def test_other_mistakes_of_a_block_are_no_varying_factor():
    """Rows with factors of their own, and a single number per point."""
    start = [np.array([0.3, -0.4, 1.5]), np.array([0.2, 0.1, 2.5])]
    rows = check_few(lambda b: seen(b, lambda j, z: np.diag([z, 1 + z**2]) @ j), start)
    assert rows.verdict == "wrong"
    assert "factor" not in rows.kinds

    def one(blocks):
        return np.sin(blocks[0]), [np.cos(blocks[0] ** 2)[None]]

    assert check_few(one, [np.array([0.7])]).kinds == {"small_part"}
