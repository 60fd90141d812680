"""Lenses whose formula goes on past 90 degrees: what is beyond counts by default."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.model.residuals import (
    linearize,
    reprojection_error,
    reprojection_errors,
    resolve_cheirality,
)
from tests import scenes
from tests.formulas import PARAMS

FISHEYES = tuple(model for model in bundle.camera_models() if "FISHEYE" in model)
WIDE = (*FISHEYES, "EUCM")


def looking_aside(model, seed=0, num_images=6, num_points=60, half=88.0, error=0.3, noise=0.3):
    """Return cameras that look across their path, into a cloud of points around it."""
    rng = np.random.default_rng(seed)
    params = np.array(PARAMS[model], float)
    points = rng.uniform([-6, -6, -3], [6, 6, 3], (num_points, 3))
    ahead = Rotation.from_euler("x", 90, degrees=True)
    centres = np.column_stack([np.linspace(-2, 2, num_images), np.zeros((num_images, 2))])
    images, seen, xy = [], [], []
    for i, centre in enumerate(centres):
        in_camera = ahead.apply(points - centre)
        angle = np.arctan2(np.hypot(*in_camera[:, :2].T), in_camera[:, 2])
        pixels = scenes.project(model, params, in_camera)
        near = np.linalg.norm(in_camera, axis=1) < 0.5
        good = np.flatnonzero((angle < np.radians(half)) & ~near)
        images += [i] * len(good)
        seen += good.tolist()
        xy.append(pixels[good] + rng.normal(0, noise, (len(good), 2)))
    moved = centres + rng.normal(0, error / np.sqrt(3), centres.shape)
    quaternions = np.tile(ahead.as_quat(), (num_images, 1))
    poses = np.column_stack([quaternions, -ahead.apply(moved)])
    order = np.lexsort((images, seen))
    return scenes.make_problem(
        num_images=num_images,
        num_points=num_points,
        model=model,
        shared=True,
        cam_from_world=poses,
        points=points + rng.normal(0, error, points.shape),
        camera_params=params[None],
        observation_image=np.array(images)[order],
        observation_point=np.array(seen)[order],
        observation_xy=np.concatenate(xy)[order],
        observation_keypoint=np.full(len(order), -1),
    )


def beyond(problem):
    """Return which observations are at 90 degrees from the axis or more."""
    poses = problem.cam_from_world[problem.observation_image]
    in_camera = Rotation.from_quat(poses[:, :4]).apply(problem.points[problem.observation_point])
    return (in_camera + poses[:, 4:])[:, 2] <= 0


@pytest.mark.parametrize("model", WIDE)
def test_what_is_beyond_ninety_degrees_counts(model, solve):
    problem = looking_aside(model)
    assert beyond(problem).sum() >= 3
    errors, unseen = reprojection_errors(problem)
    assert not unseen.any()
    held = {"refine": "poses,points", "gauge": "two_cameras"}
    result = solve(problem, **held)
    summary = result.summary
    assert summary.initial_cost == pytest.approx(0.5 * np.sum(errors**2), rel=1e-9)
    assert summary.termination_type == "CONVERGENCE"
    assert summary.held_cost == 0
    assert "observations_behind" not in summary.warning_kinds
    expected = solve(problem, cheirality="algebraic", **held)
    assert summary.final_cost == pytest.approx(expected.summary.final_cost, rel=1e-9)
    assert reprojection_error(result.problem).rmse < 0.4


@pytest.mark.parametrize("model", WIDE)
def test_colmap_s_convention_is_there_when_asked_for(model, solve):
    problem = looking_aside(model)
    errors, unseen = reprojection_errors(problem, cheirality="zero")
    assert unseen.tolist() == beyond(problem).tolist()
    result = solve(problem, cheirality="zero", max_num_iterations=0)
    expected = 0.5 * np.sum(errors[~unseen] ** 2)
    assert result.summary.initial_cost == pytest.approx(expected, rel=1e-9)
    assert result.reprojection_error_before.num_behind_camera == unseen.sum()
    assert result.reprojection_error_before.num_observations == (~unseen).sum()
    assert (linearize(problem, "zero").residual[unseen] == 0).all()


@pytest.mark.parametrize("seed", [0, 1, 3, 6, 7, 8])
def test_false_minima_of_wide_fisheyes_are_none(seed):
    """Start errors of 0.5 m, up to 88 degrees: where nothing counts beyond, all end elsewhere."""
    problem = looking_aside("OPENCV_FISHEYE", seed=seed, error=0.5, num_points=120, num_images=8)
    result = bundle.solve(problem, refine="poses,points")
    assert result.summary.is_solution_usable
    assert reprojection_error(result.problem).rmse < 0.4


def mixed():
    """Return a problem of pinhole and fisheye cameras, with a point behind or beyond both."""
    problem = scenes.make_problem(num_images=6, model="SIMPLE_RADIAL")
    fisheye = np.arange(6) % 2 == 1
    models = np.where(fisheye, "SIMPLE_RADIAL_FISHEYE", "SIMPLE_RADIAL").tolist()
    points = problem.points.copy()
    points[:3] = [[0.4, 0, -9], [3, 0.5, -6], [-2, 0.3, -7]]
    problem = problem.replace(camera_models=models, points=points)
    return problem, fisheye[problem.observation_image]


def test_each_lens_by_its_own_formula(solve):
    problem, is_fisheye = mixed()
    behind = beyond(problem)
    assert (behind & is_fisheye).any()
    assert (behind & ~is_fisheye).any()
    errors, unseen = reprojection_errors(problem)
    assert unseen.tolist() == (behind & ~is_fisheye).tolist()
    result = solve(problem, max_num_iterations=0)
    assert result.options.cheirality == "auto"
    expected = 0.5 * np.sum(errors[~unseen] ** 2)
    assert result.summary.initial_cost == pytest.approx(expected, rel=1e-9)
    error = result.reprojection_error_before
    assert error.num_observations == (~unseen).sum()
    assert error.rmse == pytest.approx(np.sqrt(np.mean(errors[~unseen] ** 2)), rel=1e-9)
    assert (linearize(problem).residual[unseen] == 0).all()
    assert (linearize(problem).residual[~unseen] != 0).any(axis=1).all()


def test_eucm_ends_where_its_denominator_vanishes():
    """With alpha = 0.1 the formula goes on to 96 degrees; what it has beyond is a mirror image."""
    problem = scenes.make_problem(num_images=2, num_points=8, model="EUCM", shared=True)
    angle = np.radians([60.0, 89, 91, 95, 97, 100, 120, 170])
    across = np.linspace(0, 6, 8)
    points = np.column_stack(
        [np.sin(angle) * np.cos(across), np.sin(angle) * np.sin(across), np.cos(angle)]
    )
    problem = problem.replace(
        points=points,
        cam_from_world=np.tile([0, 0, 0, 1.0, 0, 0, 0], (2, 1)),
        camera_params=[[800.0, 790.0, 400.0, 300.0, 0.1, 1.0]],
    )
    _, unseen = reprojection_errors(problem)
    expected = np.cos(angle) * 0.9 + 0.1 < 0
    assert unseen.tolist() == expected[problem.observation_point].tolist()
    _, unseen = reprojection_errors(problem, cheirality="zero")
    assert unseen.tolist() == (angle >= np.pi / 2)[problem.observation_point].tolist()


@pytest.mark.parametrize(
    ("models", "kind", "expected"),
    [
        (["SIMPLE_RADIAL"], "colmap", "zero"),
        (["FOV", "FULL_OPENCV"], "colmap", "zero"),
        (["OPENCV_FISHEYE"], "colmap", "algebraic"),
        (["DIVISION", "EQUIRECTANGULAR", "FISHEYE"], "colmap", "algebraic"),
        (["EUCM"], "colmap", "auto"),
        (["PINHOLE", "FISHEYE"], "colmap", "auto"),
        (["SIMPLE_RADIAL"], "bal", "algebraic"),
    ],
)
def test_what_auto_means(models, kind, expected):
    single = scenes.make_problem(num_images=len(models), model="SIMPLE_PINHOLE", shared=False)
    width = max(len(PARAMS[model]) for model in models)
    params = [[*PARAMS[model], *[0.0] * (width - len(PARAMS[model]))] for model in models]
    problem = single.replace(camera_models=models, camera_params=np.array(params), format=kind)
    assert resolve_cheirality(problem, "auto") == expected
    for given in ("zero", "algebraic"):
        assert resolve_cheirality(problem, given) == given
