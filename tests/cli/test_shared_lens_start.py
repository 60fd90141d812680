"""Start of a shared lens: images keep their scale, unless something holds them."""

import json

import numpy as np
import pytest

import bundle
from bundle.cli.main import main


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """Save a model whose lenses differ by 10 %, as do the distances of their images."""
    made = bundle.synthesize(scene="orbit", num_images=8, num_points=150, seed=4)
    problem = bundle.split_cameras(made.ground_truth)
    factor = np.linspace(0.9, 1.1, 8)
    params, poses = problem.camera_params.copy(), problem.cam_from_world.copy()
    params[:, 0] *= factor
    depth = np.median(np.linalg.norm(problem.points - problem.projection_centers[:1], axis=1))
    poses[:, 6] += (factor - 1) * depth
    folder = tmp_path_factory.mktemp("shared") / "model"
    bundle.save(problem.replace(camera_params=params, cam_from_world=poses), folder)
    return folder


def start(model, tmp_path, *flags):
    """Return the RMSE of the start of a refinement that shares the lens."""
    words = ["refine", str(model), "-o", str(tmp_path / "out"), "--quiet", "--max-iterations", "1"]
    main([*words, "--share-cameras", "all", "--json", str(tmp_path / "report.json"), *flags])
    edits = json.loads((tmp_path / "report.json").read_text())["edits"]
    return next(edit["after"]["rmse"] for edit in edits if edit["edit"] == "share_cameras")


def test_images_keep_their_scale(model, tmp_path):
    kept = start(model, tmp_path)
    assert kept < 12 < 25 < start(model, tmp_path, "--overwrite", "--fix-images", "1")


@pytest.mark.parametrize(
    "flags",
    [
        ("--refine", "points,focal"),
        ("--only-images", "1,2,3"),
        ("--fix-images", "orbit_0001.jpg"),
        ("--set", "image 2: position fixed"),
    ],
)
def test_held_images_do_not_move(model, tmp_path, flags):
    assert start(model, tmp_path, *flags) > 25
