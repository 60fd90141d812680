"""Covariances of points by the passes of the kernels: what changes how these go, not what comes."""

import subprocess
import sys

import numpy as np
import pytest

import bundle
from tests.scenes import make_problem

KINDS = ("pose", "camera", "point")
OBSERVATIONS = tuple(f"observation_{name}" for name in ("image", "point", "xy", "keypoint"))


def scene(**settings):
    return make_problem(**{"num_images": 4, "num_points": 25, "seed": 4, **settings})


def assert_same(cov, other, factor=1.0, tolerance=1e-9):
    """So many times the other, but for this share of the sigmas."""
    for kind in KINDS:
        ours, theirs = (getattr(of, f"{kind}_covariance") for of in (cov, other))
        sigma = np.sqrt(np.nan_to_num(np.diagonal(theirs, axis1=1, axis2=2)))
        scale = np.where(sigma > 0, sigma, 1)
        error = np.nan_to_num(ours - factor * theirs) / scale[:, :, None] / scale[:, None]
        assert (np.isnan(ours) == np.isnan(theirs)).all()
        assert np.abs(error).max() < tolerance, kind


@pytest.mark.parametrize("gauge", ["inner", "two_cameras"])
def test_a_point_seen_very_often_is_that_of_smaller_sigmas(gauge):
    """So often that the elimination spreads it over several chunks, and one too often for that."""
    problem = scene()
    xy = problem.observation_xy + np.random.default_rng(0).normal(0, 0.5, (1, 2))
    problem = problem.replace(observation_xy=xy)
    times = np.where(problem.observation_point == 3, 90, 1)  # 360 observations
    times[problem.observation_point == 5] = 20
    rows = np.repeat(np.arange(problem.num_observations), times)
    often = problem.replace(**{name: getattr(problem, name)[rows] for name in OBSERVATIONS})
    weighted = problem.replace(observation_sigma=1 / np.sqrt(times))
    cov = bundle.covariance(often, gauge=gauge)
    other = bundle.covariance(weighted, gauge=gauge)
    assert_same(cov, other)
    assert cov.dof - other.dof == 2 * (len(rows) - problem.num_observations)
    assert (cov.sigma0**2 * cov.dof) == pytest.approx(other.sigma0**2 * other.dof, rel=1e-10)


@pytest.mark.parametrize("gauge", ["inner", "two_cameras"])
def test_models_whose_jacobians_differ_in_width(gauge):
    radial = scene(model="RADIAL", shared=False)
    params = radial.camera_params.copy()
    params[0, 4] = 0
    radial = radial.replace(camera_params=params)
    models = ["SIMPLE_RADIAL", *radial.camera_models[1:]]
    mixed = radial.replace(camera_models=models)
    first = int(radial.camera_ids[0])
    cov = bundle.covariance(mixed, gauge=gauge)
    assert_same(
        cov, bundle.covariance(radial, gauge=gauge, constraints=[f"camera {first}: k2 fixed"])
    )


def test_observations_that_do_not_count_are_no_residuals():
    problem = scene()
    behind = problem.points.copy()
    behind[7] = problem.points.mean(axis=0) - np.array([0, 0, 1e3])  # of all cameras
    problem = problem.replace(points=behind)
    cov = bundle.covariance(problem)
    without = problem.observation_point != 7
    fewer = problem.replace(**{name: getattr(problem, name)[without] for name in OBSERVATIONS})
    assert_same(cov, bundle.covariance(fewer))
    assert cov.dof == bundle.covariance(fewer).dof
    assert cov.null_point_ids.tolist() == [problem.point_ids[7]]


COMPUTE = """
import sys, numpy as np, bundle
from tests.analysis.uncertainty.test_point_passes import scene
cov = bundle.covariance(scene(model="OPENCV", num_images=5), fixed_image_ids=(2,))
np.save(sys.argv[1], np.concatenate([cov.pose_covariance.ravel(), cov.point_covariance.ravel()]))
"""


def test_instruction_sets_agree(tmp_path, monkeypatch):
    found = []
    for name in ("baseline", "avx2", "avx512"):
        monkeypatch.setenv("BUNDLE_INSTRUCTION_SET", name)
        path = tmp_path / f"{name}.npy"
        subprocess.run([sys.executable, "-c", COMPUTE, str(path)], check=True, timeout=60)
        found.append(np.load(path))
    for other in found[1:]:
        assert np.abs(other - found[0]).max() < 1e-9 * np.abs(found[0]).max()
