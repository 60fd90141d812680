"""Rotations, bodies and routes against SciPy, finite differences and plain geometry."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from bundle.model.rigid_motions import (
    look_along,
    quaternion_from_matrix,
    quaternion_from_vector,
    quaternion_multiply,
    quaternion_rotate,
    rotate,
)
from bundle.synthetic.orbit import Body, random_directions
from bundle.synthetic.street import drive_laps, drive_one_way, waypoints


def rotations():
    """Rotations with the difficult ones among them: none, half turns, tiny."""
    rng = np.random.default_rng(1)
    vectors = rng.normal(0, 2, (200, 3))
    special = np.pi * np.eye(3)
    return Rotation.from_rotvec(np.concatenate([vectors, special, [[0, 0, 0], [1e-12, 0, 0]]]))


def test_quaternions_of_matrices():
    wanted = rotations()
    found = quaternion_from_matrix(wanted.as_matrix())
    assert (found[:, 3] >= 0).all()
    assert_allclose(np.linalg.norm(found, axis=1), 1, rtol=1e-14)
    assert_allclose((Rotation.from_quat(found) * wanted.inv()).magnitude(), 0, atol=1e-14)


def test_quaternion_algebra():
    a, b = rotations(), rotations()[::-1]
    vectors = np.random.default_rng(2).normal(size=(len(a), 3))
    product = quaternion_multiply(a.as_quat(), b.as_quat())
    assert_allclose((Rotation.from_quat(product) * (a * b).inv()).magnitude(), 0, atol=1e-14)
    assert_allclose(quaternion_rotate(a.as_quat(), vectors), a.apply(vectors), atol=1e-14)
    assert_allclose(rotate(a.as_matrix(), vectors), a.apply(vectors), atol=1e-14)
    found = Rotation.from_quat(quaternion_from_vector(a.as_rotvec()))
    assert_allclose((found * a.inv()).magnitude(), 0, atol=1e-14)


def test_look_along():
    forward = random_directions(np.random.default_rng(3), 50)
    level = look_along(forward, np.zeros(50))
    assert_allclose(level @ level.transpose(0, 2, 1), np.tile(np.eye(3), (50, 1, 1)), atol=1e-14)
    assert_allclose(np.linalg.det(level), 1)
    assert_allclose(level[:, 2], forward, atol=1e-14)
    assert_allclose(level[:, 0, 2], 0, atol=1e-14)  # x is level
    assert (level[:, 1, 2] < 0).all()  # y is down
    rolled = look_along(forward, np.full(50, 0.3))
    turn = Rotation.from_matrix(rolled @ level.transpose(0, 2, 1)).as_rotvec()
    assert_allclose(np.abs(turn), np.tile([0, 0, 0.3], (50, 1)), atol=1e-14)


@pytest.mark.parametrize("exponent", [2, 6])
def test_normals_of_bodies(exponent):
    rng = np.random.default_rng(4)
    body = Body(rng, np.array([1.0, -2.0, 3.0]), np.array([2.0, 1.0, 1.5]), exponent)
    directions = random_directions(rng, 300)
    positions, normals = body.surface(directions)
    assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=1e-14)
    assert ((positions - body.center) * normals).sum(axis=1).min() > 0
    step = 1e-6
    for axis in np.eye(3):
        tangent = (
            body.surface(directions + step * axis)[0] - body.surface(directions - step * axis)[0]
        )
        assert_allclose((tangent * normals).sum(axis=1) / (2 * step), 0, atol=1e-8)
    again, _ = body.surface(body.toward(positions))
    assert_allclose(again, positions, atol=1e-12)


def drive(kind, count, pitch=50.0):
    return waypoints(
        kind, np.random.default_rng(5), pitch=pitch, corner_radius=6.0, spacing=2.5, count=count
    )


@pytest.mark.parametrize("kind", [drive_laps, drive_one_way])
def test_waypoints_are_evenly_spaced_along_roads(kind):
    where, heading = drive(kind, 1000)
    steps = np.diff(where, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    assert lengths.max() <= 2.5 + 1e-9
    assert lengths.min() > 2.2  # chords of the corners
    off_axis = np.abs(where - 50.0 * np.round(where / 50.0)).min(axis=1)
    assert off_axis.max() < 6.0
    turns = np.abs(np.angle(np.exp(1j * np.diff(heading))))
    assert turns.max() < np.radians(50)
    assert (turns > np.radians(5)).any()


def test_one_way_never_comes_back_and_laps_do():
    def nearest_return(where):
        apart = np.abs(np.subtract.outer(np.arange(len(where)), np.arange(len(where)))) > 20
        return np.linalg.norm(where[:, None] - where[None], axis=2)[apart]

    assert nearest_return(drive(drive_one_way, 800)[0]).min() > 25
    assert nearest_return(drive(drive_laps, 120)[0]).min() < 2
