"""Constant lenses that the observations contradict, and right ones that they do not."""

from __future__ import annotations

import shlex

import numpy as np
import pytest

import bundle
from bundle.judging.findings.find import find

HELD = {"refine": ("poses", "points")}


def held(made, factor=1.0, given=(), **options):
    """Return the finding after a solve with the true lenses, focal lengths times a factor."""
    params = made.ground_truth.camera_params * [factor, 1.0, 1.0, 1.0]
    start = made.problem.replace(camera_params=params)
    result = bundle.solve(start, max_num_iterations=200, **(options or HELD))
    found = find(result.problem, options=result.options, start=start, given=given)
    return next((one for one in found if one.kind == "constant_lens"), None)


@pytest.mark.parametrize("scene", ["orbit", "street"])
@pytest.mark.parametrize("seed", range(3))
def test_a_wrong_focal_length_is_named_and_a_right_one_is_not(scene, seed):
    made = bundle.synthesize(num_images=12, num_points=250, scene=scene, seed=seed)
    assert held(made) is None
    found = held(made, 1.1, ("--refine", "poses,points", "--loss", "huber"))
    share, chi2 = found.evidence["share"], found.evidence["chi2"]
    assert found.evidence["dof"] == 2 and found.sentence.endswith("for 2 terms).")
    problem = made.problem
    unknowns = 6 * problem.num_images + 3 * problem.num_points + 2 - 7
    redundancy = 2 * problem.num_observations - unknowns
    assert chi2 == pytest.approx(redundancy * share / (1 - share), rel=1e-6)
    words = ["--loss", "huber", "--refine", "poses,points,focal,extra"]
    assert shlex.split(found.command)[5:] == words
    free = bundle.solve(
        made.problem.replace(camera_params=made.ground_truth.camera_params * [1.1, 1, 1, 1])
    )
    focal = float(made.ground_truth.camera_params[0, 0])
    assert free.problem.camera_params[0, 0] == pytest.approx(focal, rel=0.02)
    # The fall that one step predicts is that of a solve.
    bent = bundle.solve(free.initial_problem, **HELD, max_num_iterations=200)
    fall = 1 - free.summary.final_cost / bent.summary.final_cost
    assert found.evidence["share"] == pytest.approx(fall, abs=0.03)


def test_only_the_constant_cameras_are_named_and_the_others_stay_refined():
    made = bundle.synthesize(
        num_images=12, num_points=250, scene="orbit", cameras="individual", seed=3
    )
    ids = tuple(made.problem.camera_ids[:2].tolist())
    flags = ("--fix-cameras", ",".join(map(str, ids)))
    found = held(made, 1.2, flags, fixed_camera_ids=ids)
    assert tuple(found.evidence["camera_ids"]) == ids
    assert "--fix-cameras" not in found.command
    assert held(made, fixed_camera_ids=ids) is None


def test_further_parameters_stay_in_the_command():
    made = bundle.synthesize(num_images=12, num_points=250, scene="orbit", seed=1)
    refine = ("poses", "points", "principal_point")
    found = held(made, 1.1, ("--refine", "poses,points,principal-point"), refine=refine)
    words = shlex.split(found.command)
    assert words[5:] == ["--refine", "poses,points,principal-point,focal,extra"]


def test_lenses_that_other_options_keep_are_refined_by_name():
    made = bundle.synthesize(num_images=12, num_points=250, scene="orbit", seed=1)
    given = ("--refine", "poses,points", "--colmap-options", "project.ini")
    found = held(made, 1.1, given)
    words = ["--colmap-options", "project.ini", "--refine", "poses,points,focal,extra"]
    assert shlex.split(found.command)[5:] == words


def test_constant_images_explain_a_misfit_themselves():
    made = bundle.synthesize(num_images=12, num_points=250, scene="orbit", seed=1)
    fixed = tuple(made.problem.image_ids[:3].tolist())
    assert held(made, 1.1, fixed_image_ids=fixed, **HELD) is None


def test_what_a_free_lens_absorbs_of_outliers_is_no_contradiction():
    falls = []
    for seed in range(6):
        made = bundle.synthesize(
            num_images=10, num_points=200, scene="orbit", seed=seed, outlier_share=0.03
        )
        assert held(made) is None
        params = made.ground_truth.camera_params
        start = made.problem.replace(camera_params=params)
        costs = [
            bundle.solve(start, max_num_iterations=300, **more).summary.final_cost
            for more in (HELD, {})
        ]
        falls.append(1 - costs[1] / costs[0])
    assert np.max(falls) > 0.05
