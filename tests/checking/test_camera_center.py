"""Observations of points at a camera's centre: Jacobians against arithmetic of 60 digits.

Solvers leave points there. The projection is singular, no step of the usual size can be taken, and
below some depth the last digits of pose and point decide about every derivative.
"""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle import Problem, _core
from bundle.checking.jacobians import ROUNDING_UNITS, TURN, _rounding_errors
from tests import scenes

EPSILON = np.finfo(float).eps
FOCAL, K = 400.0, -0.02
PARAMS = [FOCAL, 320.0, 240.0, K]
DEPTHS = 10.0 ** -np.arange(0.0, 15.0)


def scene(depths, *, normal=0, seed=0):
    """One image, points at these depths close to its axis, and some at usual depths."""
    rng = np.random.default_rng(seed)
    depths = np.append(depths, rng.uniform(1, 5, normal))
    quaternion = rng.standard_normal(4)
    rotation = Rotation.from_quat(quaternion)
    translation = rng.uniform(-3, 3, 3)
    in_camera = depths[:, None] * np.column_stack(
        [rng.uniform(-0.5, 0.5, (len(depths), 2)), np.ones(len(depths))]
    )
    count = len(depths)
    return Problem(
        cam_from_world=np.append(quaternion, translation)[None],
        image_ids=[1],
        image_names=["a.jpg"],
        image_camera=[0],
        camera_ids=[1],
        camera_models=["SIMPLE_RADIAL"],
        camera_params=np.array([PARAMS]),
        camera_sizes=np.array([[640, 480]]),
        points=rotation.inv().apply(in_camera - translation),
        point_ids=np.arange(count) + 1,
        observation_image=np.zeros(count, int),
        observation_point=np.arange(count),
        observation_xy=rng.uniform(100, 400, (count, 2)),
        observation_keypoint=np.full(count, -1),
    )


def exact(problem, point):
    """Return depth and the Jacobian (2, 6) by translation and point, to 60 digits."""
    with mpmath.workdps(60):
        q = [mpmath.mpf(float(value)) for value in problem.cam_from_world[0, :4]]
        norm = mpmath.sqrt(sum(value * value for value in q))
        x, y, z, w = (value / norm for value in q)
        rotation = mpmath.matrix(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        translation = mpmath.matrix([float(v) for v in problem.cam_from_world[0, 4:]])
        p = rotation * mpmath.matrix([float(v) for v in problem.points[point]]) + translation
        u, v = p[0] / p[2], p[1] / p[2]
        r = u * u + v * v
        distort = mpmath.matrix([[1 + K * (r + 2 * u * u), 2 * K * u * v], [0, 0]])
        distort[1, 0], distort[1, 1] = 2 * K * u * v, 1 + K * (r + 2 * v * v)
        project = mpmath.matrix([[1 / p[2], 0, -u / p[2]], [0, 1 / p[2], -v / p[2]]])
        by_point_in_camera = FOCAL * distort * project
        by_point = by_point_in_camera * rotation
        rows = [
            [float(matrix[i, j]) for matrix in (by_point_in_camera, by_point) for j in range(3)]
            for i in range(2)
        ]
        return float(p[2]), np.array(rows)


def test_analytic_and_reference_hold_to_what_rounding_leaves():
    problem = scene(DEPTHS)
    numbers = np.arange(problem.num_observations)
    analytic, reference, uncertainty, _, rounding, counts, *_ = _core.check_reprojections(
        problem, numbers, np.zeros((len(numbers), 3)), "zero", 1e-6, 1
    )
    columns = [3, 4, 5, -3, -2, -1]
    bounded = 0
    for k in np.flatnonzero(counts):
        depth, should_be = exact(problem, k)
        size = np.linalg.norm(should_be, axis=0).max()
        known = EPSILON * np.abs(problem.points[k]).sum() / depth
        assert 0.1 * known < rounding[k] < 10 * known or depth < 1e-13
        left = np.abs(analytic[k][:, columns] - should_be).max() / size
        assert left < ROUNDING_UNITS * rounding[k] + 1e-14
        if rounding[k] < 1e-4:
            bounded += 1
            off = np.abs(reference[k][:, columns] - should_be)
            by_rounding = _rounding_errors(reference[[k]], rounding[[k]])[0][:, columns]
            assert (off <= uncertainty[k][:, columns] + 1.01 * by_rounding).all()
            assert (uncertainty[k][:, columns] <= (1e4 * rounding[k] + 1e-9) * size).all()
    assert bounded >= 10


@pytest.mark.parametrize("seed", range(3))
def test_points_at_the_centre_are_undecided_with_the_reason(seed):
    problem = scene(DEPTHS, normal=20, seed=seed)
    report = bundle.check_jacobians(problem, samples_per_image=None, seed=seed)
    assert report, report
    assert [entry.reason for entry in report.undecided] == ["camera_center"]
    # Depths from about 1e-6 down cannot be decided to seven digits.
    assert 2 <= report.num_undecided <= 9
    assert "a.jpg, point" in report.undecided[0].places[0]
    assert report.num_checked >= 20


def test_a_lie_is_found_at_every_depth_that_can_be_decided(monkeypatch):
    original = _core.check_reprojections

    def lying(*arguments):
        analytic, *rest = original(*arguments)
        analytic[..., 5] *= 1.001
        return (analytic, *rest)

    monkeypatch.setattr(_core, "check_reprojections", lying)
    for depth in 10.0 ** -np.arange(0.0, 9.0):
        report = bundle.check_jacobians(scene([depth]), samples_per_image=None)
        found = [finding for finding in report.findings if finding.kind == "factor"]
        assert len(found) == 1, (depth, report)
        assert found[0].columns == ("translation z",)
        assert found[0].factor == pytest.approx(1.001, abs=1e-4)


def test_if_no_observation_can_be_decided_the_check_is_not_passed():
    report = bundle.check_jacobians(scene([1e-14, 1e-14, 2e-14], seed=2), samples_per_image=None)
    assert report.kinds == {"undecided"}
    assert not report


def test_a_scene_far_from_the_origin_is_not_stepped_across():
    """Steps go by the depth, not by the coordinates."""
    problem = scene(np.linspace(1, 5, 30))
    centre = np.array([5e6, 4e5, 100.0])
    rotation = Rotation.from_quat(problem.cam_from_world[0, :4].copy())
    pose = problem.cam_from_world.copy()
    pose[0, 4:] -= rotation.apply(centre)
    moved = problem.replace(cam_from_world=pose, points=problem.points + centre)
    report = bundle.check_jacobians(moved, samples_per_image=None, tolerance=1e-4)
    assert report, report
    assert report.num_undecided == 0


@pytest.mark.parametrize("size", [1e5, 4e5])
def test_distortion_is_decided_in_coordinates_of_a_map(size):
    """Pixels have rounding errors of 1e-8 there, and little distortion."""
    problem = scene(np.linspace(1, 5, 30))
    centre = np.array([size, size, 100.0])
    rotation = Rotation.from_quat(problem.cam_from_world[0, :4].copy())
    pose = problem.cam_from_world.copy()
    pose[0, 4:] -= rotation.apply(centre)
    moved = problem.replace(cam_from_world=pose, points=problem.points + centre)
    report = bundle.check_jacobians(moved, samples_per_image=None)
    assert report, report
    (extra,) = (group for group in report.groups if group.name == "extra")
    assert extra.verdict == "correct"


@pytest.mark.parametrize(("rounding", "is_found"), [(5e-4, True), (2e-3, False)])
def test_a_point_is_given_up_where_rounding_decides(rounding, is_found, monkeypatch):
    """A mistake is found up to relative rounding errors of 1e-3; above, nothing is said."""
    original = _core.check_reprojections

    def coarse(*arguments):
        analytic, *rest = original(*arguments)
        analytic[..., 5] *= 2
        rest[3][:] = rounding
        return (analytic, *rest)

    monkeypatch.setattr(_core, "check_reprojections", coarse)
    report = bundle.check_jacobians(scene([1.0] * 3), samples_per_image=None)
    assert ("factor" in report.kinds) == is_found
    assert (report.verdict == "wrong") == is_found


@pytest.mark.parametrize("seed", [0, 3])
def test_a_real_model_with_points_at_camera_centres(bundle_data, seed):
    """Half of its observations have a depth below 1e-4 of the median, some 1e-10 of it."""
    problem = bundle.load(bundle_data / "degenerate" / "pratikk0")
    report = bundle.check_jacobians(problem, samples_per_image=40, seed=seed)
    assert report, report
    assert {entry.reason for entry in report.undecided} <= {"camera_center"}
    assert report.num_undecided < 0.001 * report.num_checked


def test_every_other_observation_is_checked_away_from_the_origin_of_its_chart(monkeypatch):
    turns = []

    def spy(problem, observations, offsets, *others):
        turns.append(offsets)
        return answer(problem, observations, offsets, *others)

    answer = _core.check_reprojections
    monkeypatch.setattr(_core, "check_reprojections", spy)
    assert bundle.check_jacobians(scenes.make_problem(), seed=3)
    (offsets,) = turns
    assert not offsets[::2].any()
    assert np.std(offsets[1::2]) == pytest.approx(TURN, rel=0.2)


def test_a_rough_residual_is_not_blamed_on_the_center(monkeypatch):
    problem = scene([1e-3, 1e-3, 1e-9], normal=20)
    original = _core.check_reprojections

    def rough(*arguments):
        analytic, reference, uncertainty, *others = original(*arguments)
        uncertainty[:2] = 1e-3 * np.abs(reference[:2]).max()
        return (analytic, reference, uncertainty, *others)

    monkeypatch.setattr(_core, "check_reprojections", rough)
    report = bundle.check_jacobians(problem, samples_per_image=None)
    assert {one.reason: one.count for one in report.undecided} == {"camera_center": 1, "rough": 2}
