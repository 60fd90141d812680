"""Many rotations and poses at once, against SciPy, matrices and mpmath."""

import mpmath
import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from bundle.model.rigid_motions import (
    center_jacobians,
    cross_rows,
    inverse_jacobian_coefficient,
    inverse_poses,
    multiply_as_colmap,
    multiply_poses,
    unit_poses,
    vector_from_quaternion,
)


def random_poses(seed):
    rng = np.random.default_rng(seed)
    return np.hstack([Rotation.random(9, rng=rng).as_quat(), rng.normal(size=(9, 3))])


def matrices(poses):
    found = np.tile(np.eye(4), (len(poses), 1, 1))
    found[:, :3, :3] = Rotation.from_quat(poses[:, :4]).as_matrix()
    found[:, :3, 3] = poses[:, 4:]
    return found


def test_products_and_inverses_are_those_of_matrices():
    a, b = random_poses(1), random_poses(2)
    np.testing.assert_allclose(
        matrices(multiply_poses(a, b)), matrices(a) @ matrices(b), atol=1e-14
    )
    np.testing.assert_allclose(matrices(inverse_poses(a)), np.linalg.inv(matrices(a)), atol=1e-14)
    long = a * np.array([3.0] * 4 + [1.0] * 3)
    np.testing.assert_allclose(unit_poses(long), a, atol=1e-15)


def test_cross_products_have_the_bits_of_numpy():
    a, b = np.random.default_rng(3).normal(size=(2, 50, 3))
    for one, other in ((a, b), (a[0], b), (a, b[0])):
        np.testing.assert_array_equal(cross_rows(one, other), np.cross(one, other))


@pytest.mark.parametrize("length", [1.0, 1.001])
@pytest.mark.parametrize("angle", [0.0, 1e-14, 1e-9, 1e-3, 1.0, 3.1])
def test_rotation_vectors_are_those_of_scipy(angle, length):
    vectors = angle * np.array([[0.6, -0.48, 0.64], [0, 0, 1]])
    q = length * Rotation.from_rotvec(vectors).as_quat()
    for sign in (1, -1):
        np.testing.assert_allclose(vector_from_quaternion(sign * q), vectors, rtol=1e-9, atol=0)


@pytest.mark.parametrize("angle", [1e-9, 1e-4, 0.999e-3, 1.001e-3, 0.1, 3.0])
def test_the_coefficient_of_the_inverse_jacobian(angle):
    with mpmath.workdps(40):
        half = mpmath.mpf(angle) / 2
        expected = float((1 - half * mpmath.cot(half)) / (4 * half**2))
    np.testing.assert_allclose(inverse_jacobian_coefficient(np.array([angle])), expected, rtol=1e-8)
    assert inverse_jacobian_coefficient(np.zeros(1))[0] == 1 / 12


def test_products_as_colmap_are_colmaps_to_the_last_bit():
    """Also of quaternions that are not of norm 1."""
    rng = np.random.default_rng(5)
    a, b = rng.normal(size=(2, 300, 7))
    a[:150, :4] /= np.linalg.norm(a[:150, :4], axis=1, keepdims=True)

    def rigid(pose):
        return pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:4]), pose[4:])

    products = [rigid(one) * rigid(other) for one, other in zip(a, b, strict=True)]
    expected = [np.append(product.rotation.quat, product.translation) for product in products]
    np.testing.assert_array_equal(multiply_as_colmap(a, b), expected)


def test_centers_move_as_their_derivatives_say():
    poses, step = random_poses(4), 1e-6 * np.random.default_rng(5).normal(size=(9, 6))

    def centers(rotation, translation):
        return -rotation.inv().apply(translation)

    before = Rotation.from_quat(poses[:, :4])
    after = Rotation.from_rotvec(step[:, :3]) * before
    moved = centers(after, poses[:, 4:] + step[:, 3:]) - centers(before, poses[:, 4:])
    expected = np.einsum("nij,nj->ni", center_jacobians(poses), step)
    np.testing.assert_allclose(moved, expected, atol=1e-11)
