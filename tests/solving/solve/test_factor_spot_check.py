"""Factors in Python beside the observations: a wrong Jacobian is said, and named by a call."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.graphs.factors import check_solve
from tests.rig_scenes import rig_problem
from tests.scenes import make_problem


@pytest.fixture(autouse=True)
def enough_time(monkeypatch):
    """On a busy machine, too, every column is looked at."""
    monkeypatch.setattr(check_solve, "MOST_SECONDS", 5.0)


def center(pose, target, mode="right", sigma=0.01):
    """Position of a camera, by the tangent coordinates of cam_from_world."""
    c = -Rotation.from_quat(pose[:4]).as_matrix().T @ pose[4:]
    skew = np.array([[0, -c[2], c[1]], [c[2], 0, -c[0]], [-c[1], c[0], 0]])
    jacobian = np.hstack([skew, -np.eye(3)])
    if mode == "sign":
        jacobian[:, :3] *= -1
    if mode == "degrees":
        jacobian[:, :3] *= np.pi / 180
    if mode == "all":
        jacobian *= -1
    return (c - target) / sigma, [jacobian / sigma]


def centers(problem, mode):
    return [
        bundle.FunctionFactor([("image", int(i))], lambda v, c=c + 0.01: center(v[0], c, mode))
        for i, c in zip(problem.image_ids, problem.projection_centers, strict=True)
    ]


def said(result, kind="wrong_factor"):
    summary = result.summary
    return [w for w, k in zip(summary.warnings, summary.warning_kinds, strict=True) if k == kind]


@pytest.mark.parametrize(
    ("mode", "words", "kind"),
    [("sign", "rotation", "sign"), ("degrees", "0.0175", "degrees"), ("all", "-1 times", "sign")],
)
def test_a_wrong_rotation_is_said_and_named(mode, words, kind):
    problem = make_problem(num_images=5, num_points=30, seed=3)
    factors = centers(problem, mode)
    (sentence,) = said(bundle.solve(problem, factors=factors, max_num_iterations=20))
    for word in ("FunctionFactor(('image'", words, "bundle.check_factors(problem, factors)"):
        assert word in sentence
    report = bundle.check_factors(problem, factors[:2])
    assert report.verdict == "wrong"
    assert {tuple(r.kinds) for r in report.reports.values()} == {(kind,)}
    solver = bundle.Solver(problem, factors=factors, max_num_iterations=5)
    assert said(solver.solve()) == said(solver.solve())
    assert len(said(solver.solve())) == 1
    assert said(solver.solve(check_solution=False)) == []


@pytest.mark.parametrize("mode", ["right", "sign"])
def test_a_row_of_tiny_weight_hides_nothing(mode):
    problem = make_problem(num_images=5, num_points=30, seed=3)

    def weighted(pose, target):
        error, (jacobian,) = center(pose, target)
        weights = np.array([1, 1, 1e-12])
        jacobian[2, 1] *= -1 if mode == "sign" else 1
        return weights * error, [weights[:, None] * jacobian]

    factors = [
        bundle.FunctionFactor([("image", int(i))], lambda v, c=c + 0.01: weighted(v[0], c))
        for i, c in zip(problem.image_ids, problem.projection_centers, strict=True)
    ]
    found = said(bundle.solve(problem, factors=factors, max_num_iterations=20))
    assert bool(found) == (mode == "sign")


def test_the_watch_names_the_call_that_sees_factors():
    made = bundle.synthesize(scene="orbit", num_images=8, num_points=200, seed=1)
    factors = [
        bundle.FunctionFactor([("image", int(i))], lambda v, c=c: center(v[0], c, "all", 1e-3))
        for i, c in zip(made.problem.image_ids, made.ground_truth.projection_centers, strict=True)
    ]
    result = bundle.solve(made.problem, factors=factors)
    (sentence,) = said(result, "suspicious_steps")
    assert "bundle.check_factors" in sentence


def test_right_factors_of_every_kind_of_variable_are_not_accused():
    """Held parameters have no column to be right about, and neither have held images."""
    problem = make_problem(num_images=5, num_points=30, model="SIMPLE_RADIAL", seed=1)
    focal, cx, cy, k = problem.camera_params[0]

    def camera(values):
        return [(values[0][0] - focal) / 5, values[0][3] - k], [[[0.2, 0, 0, 0], [0, 0, 0, 1.0]]]

    def principal_point_unknown(values):  # not refined: its columns are zero by choice
        f, x, y, _ = values[0]
        return [(f + x - cx + y - cy - focal) / 5], [[[0.2, 0, 0, 0]]]

    def point(values):
        return values[0] - problem.points[3], [np.eye(3)]

    factors = [
        *centers(problem, "right"),
        bundle.FunctionFactor([("camera", 1)], camera),
        bundle.FunctionFactor([("camera", 1)], principal_point_unknown),
        bundle.FunctionFactor([("point", int(problem.point_ids[3]))], point),
    ]
    result = bundle.solve(problem, factors=factors)
    assert said(result) == said(result, "suspicious_steps") == []
    held = [bundle.FunctionFactor([("image", 1)], lambda v: (v[0][:3], [np.zeros((3, 6))]))]
    assert said(bundle.solve(problem, factors=held, fixed_image_ids=(1,))) == []


def test_factors_of_frames_and_sensors():
    problem = rig_problem(num_frames=4, num_points=30, seed=2)
    key = ("frame", int(problem.frame_ids[1]))
    target = problem.rig_from_world[1]

    def function(values, sign=1.0):
        residual, jacobians = center(values[0], np.zeros(3), sigma=1.0)
        start, _ = center(target, np.zeros(3), sigma=1.0)
        return residual - start - 0.01, [sign * jacobians[0]]

    assert said(bundle.solve(problem, factors=[bundle.FunctionFactor([key], function)])) == []
    wrong = bundle.FunctionFactor([key], lambda v: function(v, -1.0))
    (sentence,) = said(bundle.solve(problem, factors=[wrong]))
    assert "-1 times" in sentence


def test_check_factors_refuses_what_is_none():
    problem = make_problem()
    assert bundle.check_factors(problem, centers(problem, "right")[:1], num_samples=2)
    with pytest.raises(bundle.InputError, match="factors"):
        bundle.check_factors(problem, [3])
    with pytest.raises(bundle.InputError, match="problem"):
        bundle.check_factors("nothing", [])
