"""Where the checker of Jacobians starts: at parameters whose size says how far a step may go."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.graph.factor_check import _origin
from bundle.graph.variables import Variable

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
