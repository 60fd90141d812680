"""The spectrum against that of the dense Jacobian, and against its own other path."""

import numpy as np
import pytest

import bundle
from bundle import _core
from bundle.analysis.diagnosis.track_table import TrackTable
from bundle.solving.layout import resolve_defaults
from tests.analysis.diagnosis.blocks import block
from tests.scenes import make_problem


def spectrum(problem, **changes):
    options = resolve_defaults(problem, bundle.SolveOptions(gauge="none", **changes))
    return _core.reduced_spectrum(problem, options.asdict(), TrackTable(problem).pieces)


def dense_spectrum(problem):
    """Return the eigenvalues of the scaled Schur complement of a Jacobian by differences.

    And the condition number of the Schur complement as it is, beside a gauge of seven.

    The unknowns are local, so that their choice drops out of everything but the scaling: rotations
    as vectors from the left, translations, f and k of one camera.
    """
    from scipy.spatial.transform import Rotation

    from tests.scenes import project

    n, m = problem.num_images, problem.num_points
    model = problem.camera_models[0]
    image, point = problem.observation_image, problem.observation_point

    def residuals(x):
        poses, params = x[: 6 * n].reshape(n, 6), x[6 * n : 6 * n + 2]
        points = problem.points + x[6 * n + 2 :].reshape(m, 3)
        turn = Rotation.from_rotvec(poses[image, :3]) * Rotation.from_quat(
            problem.cam_from_world[image, :4]
        )
        shift = poses[image, 3:] + problem.cam_from_world[image, 4:]
        lens = problem.camera_params[0] + np.array([params[0], 0, 0, params[1]])
        return project(model, lens, turn.apply(points[point]) + shift).ravel()

    size = 6 * n + 2 + 3 * m
    columns = []
    for j in range(size):
        step = np.zeros(size)
        step[j] = 1e-5
        ahead, back, far, behind = (residuals(k * step) for k in (1, -1, 2, -2))
        columns.append((8 * (ahead - back) - (far - behind)) / 12e-5)
    jacobian = np.column_stack(columns)
    cameras, points = jacobian[:, : 6 * n + 2], jacobian[:, 6 * n + 2 :]
    q, _ = np.linalg.qr(points)
    left = cameras - q @ (q.T @ cameras)
    scaled = left / np.linalg.norm(left, axis=0)
    squares = [np.linalg.svd(matrix, compute_uv=False)[::-1] ** 2 for matrix in (scaled, left)]
    return squares[0], squares[1][-1] / squares[1][7]


def test_eigenvalues_are_those_of_a_dense_jacobian():
    problem = block(num_images=5, num_points=20)
    found = spectrum(problem)
    expected, condition = dense_spectrum(problem)
    assert found["nullity"] == found["num_gauge"] == found["expected_nullity"] == 7
    assert expected[6] < 1e-12
    np.testing.assert_allclose(found["eigenvalues"][:8], expected[7:15], rtol=1e-5)
    assert found["max_eigenvalue"] == pytest.approx(expected[-1], rel=1e-6)
    assert found["condition_number_unscaled"] == pytest.approx(condition, rel=1e-3)


def test_eigenvalues_of_a_sparse_system():
    """300 unknowns and more are a sparse S, whose values stand in the panels of its factor."""
    problem = make_problem(num_images=50, num_points=80, track=8, shared=True, perturbation=0)
    found = spectrum(problem)
    assert len(found["scale"]) == 302
    assert found["nullity"] == found["num_gauge"] == 7
    expected, condition = dense_spectrum(problem)
    np.testing.assert_allclose(found["eigenvalues"][:5], expected[7:12], rtol=1e-4)
    assert found["max_eigenvalue"] == pytest.approx(expected[-1], rel=1e-5)
    assert found["condition_number_unscaled"] == pytest.approx(condition, rel=1e-2)
    vectors = found["directions"]
    np.testing.assert_allclose(vectors.T @ vectors, np.eye(vectors.shape[1]), atol=1e-10)


@pytest.mark.parametrize(
    ("changes", "nullity"),
    [
        ({}, 7),
        ({"fixed_image_ids": (1,)}, 1),
        ({"fixed_image_ids": (1, 2)}, 0),
        ({"fixed_point_ids": (1,)}, 4),
        ({"fixed_point_ids": (1, 2)}, 1),
        ({"refine": ("poses", "focal")}, 0),
        ({"refine": ("points",)}, 0),
        ({"gauge": "two_cameras"}, 0),
    ],
)
def test_what_is_held_takes_degrees_of_the_gauge(changes, nullity):
    found = bundle.diagnose(block(), **changes)
    assert (found.nullity, found.expected_nullity) == (nullity, nullity)
    assert found.ok
