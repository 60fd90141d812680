"""Results of `bundle refine` that are unusable whatever their residuals: said, as `info` does."""

import json

import numpy as np
import pytest

import bundle
from tests.scenes import make_problem


def kinds(run, problem, folder):
    bundle.save(problem, folder / "model", "colmap")
    report = folder / "r.json"
    words = ("-o", f"{folder}/out/", "--max-iterations", "0", "--json", report, "--quiet")
    run("refine", folder / "model", *words)
    return {one["kind"] for one in json.loads(report.read_text("utf-8"))["findings"]}


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        (lambda params: np.array([5.0, *params[1:3], 0.0]), "absurd_focal_lengths"),
        (lambda params: np.concatenate([[90_000.0], params[1:]]), "absurd_focal_lengths"),
        (lambda params: np.concatenate([params[:3], [-40.0]]), "folding_distortion"),
        (lambda params: np.concatenate([params[:3], [1757.0]]), "absurd_distortion"),
        (lambda params: params, ""),
    ],
)
def test_absurd_cameras_are_named_after_a_solve(run, tmp_path, change, kind):
    problem = make_problem(num_images=6, num_points=100, model="SIMPLE_RADIAL", shared=True)
    params = np.array([change(row) for row in problem.camera_params])
    found = kinds(run, problem.replace(camera_params=params), tmp_path)
    broken = {"absurd_focal_lengths", "folding_distortion", "absurd_distortion", "collapsed_points"}
    assert found & broken == ({kind} if kind else set())


def test_collapsed_points_are_named_after_a_solve(run, tmp_path):
    problem = make_problem(num_images=6, num_points=100, model="SIMPLE_RADIAL", shared=True)
    points = problem.points.copy()
    center = problem.projection_centers[0]
    points[:9] = center + 1e-6 * (points[:9] - center)
    assert "collapsed_points" in kinds(run, problem.replace(points=points), tmp_path)
