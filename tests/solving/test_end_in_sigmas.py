"""The end of a solve in standard deviations, in both backends, against dense matrices."""

import os
from pathlib import Path

import numpy as np
import pytest

import bundle
from tests import scenes
from tests.analysis.uncertainty.dense import Dense

BACKENDS = ("fused", "ceres")
DATA = Path(os.environ.get("BUNDLE_DATA", "../shared/data"))
KITTI = DATA / "rigs" / "kitti26_stereo_rig"

needs_kitti = pytest.mark.skipif(not KITTI.exists(), reason="needs BUNDLE_DATA")


def noisy(seed=1, **changes):
    scene = {"num_images": 5, "num_points": 60, "perturbation": 2e-2, **changes}
    problem = scenes.make_problem(seed=seed, **scene)
    noise = np.random.default_rng(seed).normal(size=problem.observation_xy.shape)
    return problem.replace(observation_xy=problem.observation_xy + 0.5 * noise)


def decrements(problem, free):
    """sqrt(g^T H^+ g) / s0 over all columns and over those of poses and cameras."""
    dense = Dense(problem)
    columns = [k for k, name in enumerate(dense.names) if free(name)]
    jacobian, gradient = dense.jacobian[:, columns], dense.jacobian[:, columns].T @ dense.residual
    scale = np.sqrt((jacobian**2).sum(axis=0))
    step = np.linalg.lstsq(jacobian / scale, dense.residual, rcond=1e-9)[0] / scale
    is_point = np.array([dense.names[k][0] == "point" for k in columns])
    h = jacobian.T @ jacobian
    w, v = h[np.ix_(~is_point, is_point)], h[np.ix_(is_point, is_point)]
    reduced = gradient[~is_point] - w @ np.linalg.solve(v, gradient[is_point])
    dof = len(dense.residual) - len(columns)
    sigma = np.sqrt(dense.residual @ dense.residual / dof)
    return (
        np.sqrt(gradient @ step) / sigma,
        np.sqrt(reduced @ step[~is_point]) / sigma,
    )


def free_of(problem):
    names = bundle.camera_models()[problem.camera_models[0]]
    held = [j for j, name in enumerate(names) if name in ("cx", "cy")]
    return lambda name: name[0] != "camera" or name[2] not in held


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("gauge", ["none", "two_cameras"])
@pytest.mark.parametrize("tolerance", [3e-2, 3e-3])
def test_the_distance_is_the_newton_decrement(backend, gauge, tolerance):
    """At an end by another tolerance: the same in any gauge."""
    problem = noisy()
    end = bundle.solve(problem, backend=backend, parameter_tolerance=tolerance, gauge=gauge)
    assert end.summary.message.startswith("Parameter tolerance")
    whole, cameras = decrements(end.problem, free_of(problem))
    # A gauge holds seven columns.
    dof = 2 * problem.num_observations - 3 * problem.num_points - 5 * 8
    share = np.sqrt(1 + 7 * (gauge == "two_cameras") / dof)
    assert end.summary.distance_in_sigmas == pytest.approx(share * whole, rel=1e-4)
    assert end.summary.largest_camera_step_in_sigmas == pytest.approx(share * cameras, rel=1e-4)
    assert whole > 0.05


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_last_step_is_taken(backend):
    """The steps are those of Ceres' rule, and those after its end."""
    problem = noisy()
    # With several threads, Ceres adds in another order from run to run.
    first = bundle.solve(problem, backend=backend, convergence="ceres", num_threads=1)
    result = bundle.solve(problem, backend=backend, num_threads=1)
    steps = len(first.iterations["cost"])
    assert np.array_equal(result.iterations["cost"][:steps], first.iterations["cost"])
    assert len(result.iterations["cost"]) > steps
    assert result.summary.final_cost == result.iterations["cost"][-1] < first.summary.final_cost
    assert result.summary.termination_type == "CONVERGENCE"
    assert result.summary.message.startswith("Function tolerance reached")
    assert result.summary.distance_in_sigmas < 0.1
    assert first.summary.distance_in_sigmas is None
    assert first.summary.largest_camera_step_in_sigmas is None


def test_both_backends_end_at_the_same_step():
    for seed in range(3):
        ours, theirs = (bundle.solve(noisy(seed), backend=backend) for backend in BACKENDS)
        assert np.allclose(ours.iterations["cost"], theirs.iterations["cost"], rtol=1e-9)
        assert ours.summary.message[:46] == theirs.summary.message[:46]
        assert ours.summary.distance_in_sigmas == pytest.approx(
            theirs.summary.distance_in_sigmas, rel=1e-3, abs=1e-6
        )


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_robust_loss_takes_its_last_step_and_has_no_distance(backend):
    problem = noisy()
    first = bundle.solve(problem, backend=backend, loss="cauchy", convergence="ceres")
    result = bundle.solve(problem, backend=backend, loss="cauchy")
    assert len(result.iterations["cost"]) == len(first.iterations["cost"]) + 1
    assert result.summary.final_cost < first.summary.final_cost
    assert result.summary.distance_in_sigmas is None


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_limit_of_steps_has_no_distance(backend):
    result = bundle.solve(noisy(), backend=backend, max_num_iterations=2)
    assert result.summary.termination_type == "NO_CONVERGENCE"
    assert result.summary.distance_in_sigmas is None


@needs_kitti
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_focal_length_along_a_straight_road(backend):
    """Ceres' rule ends 1.67 sigmas from the minimum, 36 px off in f."""
    problem = bundle.load(KITTI)
    early = bundle.solve(problem, backend=backend, convergence="ceres")
    result = bundle.solve(problem, backend=backend)
    exact = bundle.solve(problem, function_tolerance=1e-14, max_num_iterations=500)
    variance = bundle.covariance(exact.problem, scale="sigma0", of="intrinsics")
    sigma = np.sqrt(variance.camera_covariance[0, 0, 0])

    def off(solved):
        return abs(solved.problem.camera_params[0, 0] - exact.problem.camera_params[0, 0]) / sigma

    assert off(early) > 1.2
    assert off(result) < 0.1
    assert result.summary.largest_camera_step_in_sigmas < 0.1


def test_the_option_reaches_the_drop_in():
    from bundle.interface.colmap_options import colmap_adjustment

    assert colmap_adjustment({}, {}).options.convergence == "colmap"
    assert bundle.SolveOptions().convergence == "sigmas"
