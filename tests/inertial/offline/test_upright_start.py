"""Placement beside an IMU: exact heading and shift, a vertical that stays, scales refused."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bundle import GravityPrior, InputError, OrientationPrior, PositionPrior
from bundle.georeference.similarity import Similarity, moved
from bundle.inertial.offline.inertial_start import _level, to_priors
from bundle.inertial.offline.motion_solve import ImuBodies
from tests.inertial.offline.test_imu_with_priors import (
    OPTIONS,
    SETTINGS,
    adjusted,
    flight,
    model_of,
    stereo_of,
)
from tests.scenes import make_problem

__all__ = ["flight"]


def turned_about(problem, degrees):
    """The problem in a world that is turned about z and shifted, and the way back."""
    turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    return moved(problem, Similarity(1.0, turn, np.array([3.0, -1, 2])))


def test_positions_with_lever_arms_give_heading_and_shift():
    truth = make_problem()
    arm = np.array([0.3, -0.5, 0.2])
    turns = Rotation.from_quat(truth.cam_from_world[:, :4]).inv()
    places = truth.projection_centers + turns.apply(arm)
    priors = [
        PositionPrior(int(image), place, 0.1, lever_arm=arm)
        for image, place in zip(truth.image_ids, places, strict=True)
    ]
    given = turned_about(truth, 130)
    found = moved(given, to_priors(given, priors))
    np.testing.assert_allclose(found.projection_centers, truth.projection_centers, atol=1e-9)


def test_the_vertical_of_the_imu_stays():
    """Positions and attitudes that contradict it turn the world about z alone."""
    truth = make_problem()
    given = turned_about(truth, -70)
    tilt = Rotation.from_euler("xy", (8, -5), degrees=True)
    tilted = moved(truth, Similarity(1.0, tilt.as_matrix(), np.zeros(3)))
    ids = truth.image_ids.tolist()
    turns = Rotation.from_quat(tilted.cam_from_world[:, :4])
    positions = [
        PositionPrior(i, c, 0.1) for i, c in zip(ids, tilted.projection_centers, strict=True)
    ]
    attitudes = [OrientationPrior(i, r.as_quat(), 1.0) for i, r in zip(ids, turns, strict=True)]
    down = [GravityPrior(i, r.apply([0, 0, -1]), 1.0) for i, r in zip(ids, turns, strict=True)]
    for priors, heading in ((positions, 70), (attitudes, 70), (attitudes + down, 70), (down, 0)):
        turn = Rotation.from_matrix(to_priors(given, priors).rotation).as_rotvec(degrees=True)
        np.testing.assert_allclose(turn[:2], 0, atol=1e-9)
        assert turn[2] == pytest.approx(heading, abs=3)


@pytest.mark.parametrize(
    "down", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (1e-9, 0, 1), (0.6, 0, -0.8), (0, 1e-3, 1)]
)
def test_any_direction_is_turned_down_the_shortest_way(down):
    unit = np.array(down, float) / np.linalg.norm(down)
    turn = _level(unit)
    np.testing.assert_allclose(turn @ unit, [0, 0, -1], atol=1e-8)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-8)
    angle = Rotation.from_matrix(turn).magnitude()
    assert angle == pytest.approx(np.arccos(-unit[2]), abs=1e-6)


def test_arms_are_those_of_the_bodies_in_the_world():
    problem = make_problem()
    pose = np.append(Rotation.from_rotvec([0.1, 0.2, 0.3]).as_quat(), [0.1, -0.2, 0.4])
    bodies = ImuBodies.of(problem, np.arange(5)[::-1], pose)
    turns = Rotation.from_quat(problem.cam_from_world[::-1, :4]).inv()
    np.testing.assert_allclose(bodies.arms(problem), turns.apply(pose[4:]), atol=1e-14)
    expected = (turns * Rotation.from_quat(pose[:4])).as_matrix()
    np.testing.assert_allclose(bodies.imu_rotations(problem), expected, atol=1e-14)
    assert bodies.keys(problem) == [("image", i) for i in problem.image_ids[::-1].tolist()]


def test_rigs_in_large_units_are_refused_too(flight):
    problem, stamps = stereo_of(flight, 8, scale=0.2)
    with pytest.raises(InputError, match="metres as its unit"):
        adjusted(flight.sequence, problem, np.repeat(stamps, 2), OPTIONS, **SETTINGS)


def test_forces_of_the_wrong_sign_have_no_scale(flight):
    """They give a negative scale, with a small standard deviation."""
    problem, stamps = model_of(flight.sequence, flight.ground_truth, 6)
    wrong = dataclasses.replace(flight.sequence, accel=-flight.sequence.accel)
    with pytest.raises(InputError, match=r"reversed.* the scale is -"):
        adjusted(wrong, problem, stamps, OPTIONS, **SETTINGS)
