"""Errors against logarithms of matrices, Jacobians against differences."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle import _core
from tests.graphs.pose_graphs import graphs

KINDS = [(error, dimension) for error in ("log", "g2o", "ceres") for dimension in (2, 3)]


@pytest.mark.parametrize(("error", "dimension"), KINDS)
def test_errors_are_those_of_matrices(error, dimension):
    rng = np.random.default_rng(3)
    for size in (1e-6, 1e-2, 0.5):
        x_i, z = (graphs.random_pose(rng, dimension) for _ in range(2))
        little = graphs.matrix(graphs.random_pose(rng, dimension, size=size, angle=size))
        x_j = graphs.pose_of(graphs.matrix(x_i) @ graphs.matrix(z) @ little)
        found = _core.relative_pose_error(error, x_i, x_j, z)[0]
        expected = graphs.error_by_matrices(error, x_i, x_j, z)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-13)


@pytest.mark.parametrize(("error", "dimension"), KINDS)
@pytest.mark.parametrize("angle", [1e-9, 0.3, 2.5])
def test_jacobians_are_those_of_differences(error, dimension, angle):
    rng = np.random.default_rng(5)
    x_i, z = (graphs.random_pose(rng, dimension) for _ in range(2))
    axis = np.array([0.6, -0.48, 0.64])
    apart = (
        np.array([0.3, -0.2, angle])
        if dimension == 2
        else np.append(Rotation.from_rotvec(angle * axis).as_quat(), [0.3, -0.2, 0.4])
    )
    x_j = graphs.pose_of(graphs.matrix(x_i) @ graphs.matrix(z) @ graphs.matrix(apart))

    def function(values):
        residual, *jacobians = _core.relative_pose_error(error, *values, z)
        return residual, jacobians

    graph = bundle.FactorGraph()
    manifold = "se2" if dimension == 2 else "se3"
    graph.add_variable("i", x_i, manifold)
    graph.add_variable("j", x_j, manifold)
    graph.add_factor(bundle.FunctionFactor(["i", "j"], function))
    assert graph.check_gradients(num_samples=1)


@pytest.mark.parametrize("error", ["log", "g2o", "ceres"])
def test_turns_of_angles_change_nothing(error):
    x_i, x_j, z = np.array([0, 0, 3.1]), np.array([1, 0, -3.1]), np.array([-1, 0.1, 0.05])
    residual = _core.relative_pose_error(error, x_i, x_j, z)[0]
    assert abs(residual[2] - (2 * np.pi - 6.25)) < 1e-12
    for turns in (-4 * np.pi, 2 * np.pi):
        other = _core.relative_pose_error(error, x_i, x_j + np.array([0, 0, turns]), z)[0]
        np.testing.assert_allclose(other, residual, atol=1e-13)


@pytest.mark.parametrize("error", ["log", "g2o", "ceres"])
def test_the_sign_of_a_quaternion_changes_nothing(error):
    rng = np.random.default_rng(8)
    x_i, x_j, z = (graphs.random_pose(rng, 3) for _ in range(3))
    expected = _core.relative_pose_error(error, x_i, x_j, z)
    flip = np.array([-1, -1, -1, -1, 1, 1, 1.0])
    for found, same in zip(
        _core.relative_pose_error(error, x_i, flip * x_j, z), expected, strict=True
    ):
        np.testing.assert_allclose(found, same, atol=1e-13)
