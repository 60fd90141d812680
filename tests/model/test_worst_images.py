"""The worst images, against sums over a loop."""

import numpy as np
import pytest

import bundle
from bundle.model import residuals as module
from bundle.model.residuals import reprojection_error, reprojection_errors, worst_images
from tests.scenes import make_problem, scene


def test_the_images_of_largest_rmse_are_named():
    problem = make_problem(num_images=7, num_points=20)
    errors, _ = reprojection_errors(problem)
    expected = {}
    for i, name in enumerate(problem.image_names):
        own = errors[problem.observation_image == i]
        expected[name] = (len(own), np.sqrt((own**2).mean()), own.max())
    found = worst_images(problem, most=4)
    names = sorted(expected, key=lambda name: -expected[name][1])[:4]
    assert [image.name for image in found] == names
    for image in found:
        got = (image.num_observations, image.rmse, image.max)
        assert got == pytest.approx(expected[image.name])
        assert problem.image_ids[problem.image_names.index(image.name)] == image.image_id


def test_only_observations_that_count():
    """Image 0 is turned round: all behind it. It counts for BAL, and for COLMAP it does not."""
    problem = scene(kind="colmap")
    poses = problem.cam_from_world.copy()
    poses[0, 6] = -6.0
    turned = problem.replace(cam_from_world=poses)
    assert turned.image_ids[0] not in {image.image_id for image in worst_images(turned)}
    assert worst_images(turned, "algebraic")[0].image_id == turned.image_ids[0]
    assert len(worst_images(turned)) == 3


@pytest.mark.parametrize("cheirality", ["algebraic", "zero"])
def test_blocks_of_observations_do_not_show(monkeypatch, cheirality):
    """Nor does the end of the last block; observations behind their camera are in several."""
    problem = scene(kind="colmap")
    poses = problem.cam_from_world.copy()
    poses[0, 6] = -6.0
    problem = problem.replace(cam_from_world=poses)
    whole = worst_images(problem, cheirality)
    monkeypatch.setattr(module, "_BLOCK", 7)
    assert problem.num_observations % 7 and problem.num_observations > 7
    assert worst_images(problem, cheirality) == whole


@pytest.mark.parametrize("cheirality", ["algebraic", "zero"])
def test_measured_at_once_or_one_by_one(cheirality):
    result = bundle.solve(scene(kind="colmap"), max_num_iterations=1, cheirality=cheirality)
    result.measure()
    assert vars(result).keys() >= {"reprojection_error_before", "reprojection_error_after"}
    assert result.reprojection_error_before == reprojection_error(
        result.initial_problem, cheirality
    )
    assert result.reprojection_error_after == reprojection_error(result.problem, cheirality)
    assert vars(result)["worst_images"] == worst_images(result.problem, cheirality)
