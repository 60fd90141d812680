"""Candidates and their cameras."""

import numpy as np
import pytest

import bundle
from bundle.judging.validation.candidates import (
    Candidate,
    default_candidates,
    groups_of,
    with_cameras,
)
from tests.rig_scenes import rig_problem
from tests.scenes import make_problem, scene

SIZES = np.array([[800, 600]] * 4 + [[640, 480]] * 2)


def two_sizes(**changes):
    """Return six images with a camera each, of two sizes."""
    return make_problem(num_images=6, num_points=60, camera_sizes=SIZES, **changes)


def names(candidates):
    return [(one.camera_model, one.share) for one in candidates]


def test_groups_of_images():
    problem = two_sizes()
    assert groups_of(problem, "size").tolist() == [0, 0, 0, 0, 1, 1]
    assert groups_of(problem, "all").tolist() == [0] * 6
    assert groups_of(problem, "each").tolist() == list(range(6))
    assert groups_of(problem, "input").tolist() == list(range(6))
    unknown = problem.replace(camera_sizes=np.where(SIZES[0] == SIZES, 0, SIZES))
    assert groups_of(unknown, "size").tolist() == [0, 1, 2, 3, 4, 4]


def test_defaults_of_a_camera_per_image():
    found = names(default_candidates(make_problem(num_images=4, num_points=20)))
    assert found == [
        *((model, "size") for model in ("SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")),
        *((model, "focal") for model in ("SIMPLE_RADIAL", "OPENCV")),
        *((model, "each") for model in ("SIMPLE_RADIAL", "RADIAL", "OPENCV")),
    ]


def test_defaults_include_the_lenses_of_the_input():
    found = names(default_candidates(make_problem(model="PINHOLE", shared=True)))
    assert ("PINHOLE", "size") in found
    fisheye = names(default_candidates(make_problem(model="OPENCV_FISHEYE")))
    assert {model for model, _ in fisheye} == {
        *("SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "OPENCV_FISHEYE", "THIN_PRISM_FISHEYE")
    }
    pairs = two_sizes().replace(image_camera=[0, 1, 0, 1, 2, 2])  # two cameras of one size
    assert ("SIMPLE_RADIAL", "input") in names(default_candidates(pairs))


def test_inputs_that_leave_no_sharing_to_choose():
    bal = default_candidates(scene())  # unknown sizes: nothing says which images have one camera
    assert {one.share for one in bal} == {"each"}
    assert groups_of(scene(), "size").tolist() == list(range(4))
    rigs = default_candidates(rig_problem())
    assert len({one.share for one in rigs}) == 1
    for one in rigs:
        with_cameras(rig_problem(), one)


def test_given_lists_are_multiplied():
    problem = two_sizes()
    found = default_candidates(
        problem, ("OPENCV", "RADIAL"), ("each", "size"), ("huber", "trivial"), (("focal",),)
    )
    assert len(found) == 8
    assert {one.refine for one in found} == {("focal",)}
    assert names(found)[:2] == [("OPENCV", "size"), ("RADIAL", "size")]
    assert not default_candidates(problem, ("SIMPLE_PINHOLE",), ("focal",))


def test_focal_lengths_alone_differ():
    problem = two_sizes(model="OPENCV")
    start, rules = with_cameras(problem, Candidate(camera_model="OPENCV", share="focal"))
    params = bundle.solve(start, constraints=rules).problem.camera_params[start.image_camera]
    assert len(np.unique(params[:, 0])) == 6
    np.testing.assert_allclose(params[:4, 4:], np.tile(params[0, 4:], (4, 1)))
    assert (params[0, 4:] != params[5, 4:]).all()
    ratio = params[:, 1] / params[:, 0]
    np.testing.assert_allclose(ratio[:4], ratio[0])


def test_mixed_models_become_one():
    problem = two_sizes(model="RADIAL")
    models = ["RADIAL"] * 5 + ["SIMPLE_RADIAL"]
    params = problem.camera_params.copy()
    params[5, 3:] = [0.01, 0]
    mixed = problem.replace(camera_models=models, camera_params=params)
    found, _ = with_cameras(mixed, Candidate(camera_model="RADIAL", share="size"))
    assert set(found.camera_models) == {"RADIAL"}
    assert found.num_cameras == 2
    assert ("", "each") in names(default_candidates(mixed))
    with pytest.raises(bundle.InputError, match="expected the model of camera"):
        with_cameras(mixed, Candidate(camera_model="", share="size"))
