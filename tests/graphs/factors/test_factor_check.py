"""Where the checker of Jacobians starts: at parameters whose size says how far a step may go."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.graphs.factors.factor_check import _origin
from bundle.graphs.factors.variables import Variable

# Angles have the scale 1, translations that of their length, plain numbers their own.
ORIGINS = [
    ("euclidean", [0.5, -2.0], [0.5, -2.0]),
    ("so2", [3.0], [1]),
    ("so3", [0.6, 0, 0, 0.8], [1, 1, 1]),
    ("se2", [30, 40, 2.0], [50, 50, 1]),
    ("se2", [0, 0, 2.0], [1, 1, 1]),
    ("se3", [0, 0, 0, 1, 3, 0, 4], [1, 1, 1, 5, 5, 5]),
    ("se3", [0, 0, 0, 1, 0, 0, 0], [1, 1, 1, 1, 1, 1]),
]


@pytest.mark.parametrize(("manifold", "value", "origin"), ORIGINS)
def test_the_origin_has_the_size_of_the_variable(manifold, value, origin):
    variable = Variable.make("x", value, manifold, fixed=False, lower=None, upper=None)
    np.testing.assert_array_equal(_origin(variable, variable.value), origin)


def test_rounding_of_a_rotated_point_far_from_the_origin_is_no_wrong_jacobian():
    """Changing the last digit of an angle of zero would change nothing."""
    point = np.array([1.0, 2, 3])

    def function(values):
        rotation = Rotation.from_quat(values[0]).as_matrix()
        return (rotation @ point + 1e6) - 1e6, [rotation @ np.cross(np.eye(3), point).T]

    graph = bundle.FactorGraph()
    graph.add_variable("r", [0.6, 0, 0, 0.8], "so3")
    graph.add_factor(bundle.FunctionFactor(["r"], function))
    assert graph.check_gradients(num_samples=1)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_an_imu_factor_at_rest_is_not_accused(seed, scale):
    """Velocity, position and biases are zero, and so is what their last digits tell of rounding."""
    rng = np.random.default_rng(seed)
    motion = bundle.Preintegration(bundle.ImuNoise(1.7e-4, 2e-3, 1.9e-5, 3e-3))
    accel = scale * rng.normal(0, 1, (50, 3)) + [0, 0, 9.81]
    motion.integrate(scale * rng.normal(0, 0.3, (50, 3)), accel, np.full(50, 0.005))
    graph = bundle.FactorGraph()
    for k in "01":
        graph.add_variable("x" + k, [0, 0, 0, 1, 0, 0, 0], "se3")
        graph.add_variable("v" + k, [0, 0, 0])
        graph.add_variable("b" + k, [0] * 6)
    graph.add_factor(bundle.ImuFactor("x0", "v0", "b0", "x1", "v1", motion))
    assert graph.check_gradients(num_samples=2).verdict == "correct"


@pytest.mark.parametrize("num_samples", [1, 3])
def test_a_sign_of_one_column_stays_in_it_at_every_sample(num_samples):
    """A right Jacobian of SE(2) would carry it into the others."""

    def bearing(values):
        x, y, angle = values[0]
        dx, dy = 5 - x, 3 - y
        square = dx * dx + dy * dy
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        by_position = np.array([[dy / square, -dx / square]]) @ turn
        return [np.arctan2(dy, dx) - angle], [np.hstack([by_position, [[1.0]]])]

    graph = bundle.FactorGraph()
    graph.add_variable("p", [1, 0.5, 0.3], "se2")
    graph.add_factor(bundle.FunctionFactor(["p"], bearing))
    check = graph.check_gradients(num_samples=num_samples)
    (report,) = check.wrong.values()
    assert [(f.kind, f.columns) for f in report.findings] == [("sign", ("'p' angle",))]
    assert (check.verdict, check.ok, check.undecided) == ("wrong", False, {})


def test_the_verdict_on_factors_is_the_worst_of_each():
    graph = bundle.FactorGraph()
    graph.add_variable("x", [0.0])
    graph.add_factor(bundle.FunctionFactor(["x"], lambda v: (v[0], [[[1.0]]])))
    assert graph.check_gradients().verdict == "correct"
    graph.add_factor(bundle.FunctionFactor(["x"], lambda v: (abs(v[0]), [[np.sign(v[0])]])))
    undecided = graph.check_gradients()
    assert (undecided.verdict, bool(undecided), undecided.wrong) == ("undecided", False, {})
    assert len(undecided.undecided) == 1
    assert "1 of 2 factors" in str(undecided)
    graph.add_factor(bundle.FunctionFactor(["x"], lambda v: (v[0], [[[2.0]]])))
    wrong = graph.check_gradients()
    assert (wrong.verdict, len(wrong.wrong), len(wrong.undecided)) == ("wrong", 1, 1)
