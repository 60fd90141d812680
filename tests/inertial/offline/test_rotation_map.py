"""Map between rotations of gyroscope and images: values, sigmas, and each gross error by name."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bundle.inertial.offline.rotation_map import RotationMap, axes_sentence, signed_axes

TURN = Rotation.from_rotvec([0.3, -0.5, 0.9])


def draw(matrix, bias=(0.01, -0.02, 0.03), noise=0.0, seed=0, count=200, axes=(1, 1, 1)):
    rng = np.random.default_rng(seed)
    samples = 0.1 * rng.normal(size=(count, 3)) * axes
    times = rng.uniform(0.1, 0.3, count)
    images = samples @ np.transpose(matrix) + times[:, None] * bias
    images = images + noise * rng.normal(size=(count, 3))
    motions = [
        SimpleNamespace(delta_rotation=Rotation.from_rotvec(one).as_matrix(), duration=seconds)
        for one, seconds in zip(samples, times, strict=True)
    ]
    return Rotation.from_rotvec(images).as_matrix(), motions


def made(matrix, sigma=1e-3, rms=1e-3, before=1.0):
    return RotationMap(np.asarray(matrix, float), np.full(3, sigma), rms, before)


def turned(degrees):
    return Rotation.from_rotvec(np.radians([0, degrees, 0])).as_matrix()


def cause(matrix, arm=(0, 0, 0, 1, 0, 0, 0), **known):
    return made(matrix, **known).cause(np.array(arm, float))


def test_the_map_is_found_and_one_wild_rotation_does_not_move_it():
    matrix = turned(20) @ np.diag([1.1, 0.9, -1.0])
    between, motions = draw(matrix)
    found = RotationMap.between(between, motions)
    np.testing.assert_allclose(found.matrix, matrix, atol=1e-9)
    assert found.rms < 1e-9 and found.rms_before > 0.05
    between[7] = Rotation.from_rotvec([2.0, 1, 0]).as_matrix()
    np.testing.assert_allclose(RotationMap.between(between, motions).matrix, matrix, atol=1e-6)


def test_errors_have_their_sigmas():
    errors = []
    for seed in range(40):
        found = RotationMap.between(*draw(np.eye(3), noise=0.01, seed=seed, count=800))
        errors.append((found.matrix - np.eye(3)) / found.sigma)
        assert found.rms == pytest.approx(0.01, rel=0.3)
    assert 0.8 < np.std(errors) < 1.3


def test_rotations_about_one_axis_determine_nothing():
    found = RotationMap.between(*draw(np.eye(3), noise=0.003, axes=(0.01, 0.01, 1)))
    assert not found.is_determined
    assert found.sigma[2] < 0.01
    assert not (found.is_turned or found.is_scaled)


def test_polar_decomposition():
    matrix = turned(30) @ np.diag([1.2, 1.0, 0.8])
    found = made(matrix, sigma=0.01)
    np.testing.assert_allclose(found.rotation, turned(30), atol=1e-12)
    assert found.scale == pytest.approx(1.0)
    assert found.angle == pytest.approx(30)
    assert made(-turned(30)).angle == pytest.approx(30)
    assert found.angle_sigma == pytest.approx(np.degrees(0.01))


def test_bounds_of_small_errors():
    assert [made(turned(a)).is_turned for a in (0.99, 1.01)] == [False, True]
    sigma = np.radians(1.0)
    assert [made(turned(a), sigma=sigma).is_turned for a in (4.9, 5.1)] == [False, True]
    scales = [made(s * np.eye(3)).is_scaled for s in (0.979, 0.981, 1.019, 1.021)]
    assert scales == [True, False, False, True]
    wide = 0.03 * np.sqrt(3)  # five sigmas of the mean of three are 0.15
    assert [made(s * np.eye(3), sigma=wide).is_scaled for s in (1.14, 1.16)] == [False, True]
    for sigma, expected in ((0.099, True), (0.101, False)):
        assert made(np.eye(3), sigma=sigma).is_determined == expected
        assert made(turned(90), sigma=sigma).is_turned == expected
        assert bool(cause(-np.eye(3), sigma=sigma)[0]) == expected


@pytest.mark.parametrize(
    ("matrix", "kind", "word"),
    [
        (-np.eye(3), "gyro_axes", "reversed: its axes are -x -y -z"),
        (np.diag([1.0, 1, -1]), "gyro_axes", "mirrored: its axes are +x +y -z"),
        ([[0, 1, 0], [-1, 0, 0], [0, 0, 1]], "gyro_axes", "turned: its axes are +y -x +z"),
        (np.diag([1.0, 1, -1]) @ turned(40), "gyro_axes", "mirrored"),
        (turned(15.1), "camera_from_imu", "15.1"),
        (turned(14.9), "", ""),
        (2.1 * np.eye(3), "gyro_scale", "0.48"),
        (1.9 * np.eye(3), "", ""),
        (0.49 * np.eye(3), "gyro_scale", "degrees per second"),
        (0.51 * np.eye(3), "", ""),
        (turned(90) @ turned(11.9), "gyro_axes", "+z +y -x"),
        (turned(90) @ turned(12.1), "camera_from_imu", "102"),
    ],
)
def test_gross_errors_have_names(matrix, kind, word):
    found = cause(matrix)
    assert found[0] == kind
    assert word in found[1]


def test_an_inverted_or_reordered_camera_from_imu():
    """It should be C M, with C as given."""
    right = TURN
    given = right.inv()
    arm = [*given.as_quat(), 0.1, 0, 0]
    assert cause((given.inv() * right).as_matrix(), arm)[0] == "inverse"
    x, y, z, w = right.as_quat()
    given = Rotation.from_quat([w, x, y, z])
    arm = [w, x, y, z, 0.1, 0, 0]
    assert cause((given.inv() * right).as_matrix(), arm)[0] == "order"
    other = turned(12.1) @ (given.inv() * right).as_matrix()
    assert cause(other, arm)[0] == "camera_from_imu"


def test_a_map_that_explains_little_is_no_cause():
    assert cause(-np.eye(3), rms=0.49)[0] == "gyro_axes"
    assert cause(-np.eye(3), rms=0.51)[0] == ""


def test_signed_axes_and_their_words():
    axes = np.array([[0, 0, -1.0], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_array_equal(signed_axes(axes @ turned(5)), axes)
    assert signed_axes(turned(45)) is None
    assert "-z +x +y" in axes_sentence("accelerometer", axes)
