"""Learned reconstructions with their faults: what can be refined is mended."""

import numpy as np
import pytest

import bundle
from tests.io.formats.learned_exports import export, truth


@pytest.fixture(params=range(4))
def scene(request):
    return truth(request.param)


def errors(problem, scene):
    """Median error of the focal lengths; distance of centres, and turns in degrees (rms)."""
    focal = np.median(np.abs(problem.camera_params[:, 0] / scene.camera_params[0, 0] - 1))
    found = bundle.evaluate(problem, scene)
    return np.array([focal, found.position.rmse, found.rotation.rmse])


def test_first_observations_of_an_export_fit_whatever_is_wrong(scene):
    for kind in ("single", "pairs"):
        problem = export(scene, kind, 5)
        first = np.unique(problem.observation_point, return_index=True)[1]
        sizes, _ = bundle.reprojection_errors(problem)
        assert sizes[first].max() < 1e-6


def test_matches_of_pairs_are_refined(scene):
    start = export(scene, "pairs", 5)
    own = bundle.solve(start)
    shared = bundle.solve(bundle.share_cameras(start))
    before, with_own, with_shared = (errors(p, scene) for p in (start, own.problem, shared.problem))
    assert (with_own < 0.6 * before).all()
    assert with_own[0] < before[0] / 5
    assert with_shared[0] < 0.01
    assert with_shared[1] < with_own[1]
