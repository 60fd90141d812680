"""Halves of a model merged: what comes out is the model."""

import numpy as np
import pytest

import bundle
from bundle import InputError
from tests.editing.merging.halves import TO_B, cut, halves, tracks, whole
from tests.rig_scenes import rig_problem
from tests.scenes import make_problem, scene


def test_poses_points_and_similarity_are_those_of_the_whole(model, merged):
    problem = merged.problem
    assert problem.image_names == model.image_names
    np.testing.assert_allclose(problem.projection_centers, model.projection_centers, atol=1e-9)
    sign = np.sign((problem.cam_from_world[:, :4] * model.cam_from_world[:, :4]).sum(1))
    np.testing.assert_allclose(
        problem.cam_from_world[:, :4] * sign[:, None], model.cam_from_world[:, :4], atol=1e-9
    )
    assert merged.similarity.scale == pytest.approx(1 / TO_B.scale, rel=1e-10)
    np.testing.assert_allclose(merged.similarity.rotation, TO_B.rotation.T, atol=1e-10)
    np.testing.assert_allclose(
        merged.similarity.apply(TO_B.apply(model.points)), model.points, atol=1e-9
    )
    row = {i: r for r, i in enumerate(model.point_ids.tolist())}
    known = [row[i] for i in problem.point_ids.tolist() if i in row]
    kept = np.isin(problem.point_ids, model.point_ids)
    assert kept.sum() > 60
    np.testing.assert_allclose(problem.points[kept], model.points[known], atol=1e-9)
    assert max(merged.rms_points, merged.rms_centers, merged.rms_pixels) < 1e-8


def test_the_merged_model_has_the_gauge_of_one():
    problem = whole(noise=0.3, perturbation=1e-4)
    merged = bundle.merge(*halves(problem))
    assert (merged.free_before, merged.determined) == (14, 7)
    assert bundle.diagnose(merged.problem).nullity == 7


def test_models_of_which_no_point_agrees_are_refused(model):
    a, b = halves(model)
    shuffled = b.points[np.random.default_rng(2).permutation(len(b.points))]
    with pytest.raises(InputError, match="found 0 among"):
        bundle.merge(a, b.replace(points=shuffled), max_error=1e-3)


def test_a_model_merged_with_itself_or_a_part_is_itself(model):
    for other in (model, cut(model, range(2, 6))):
        merged = bundle.merge(model, other)
        np.testing.assert_array_equal(merged.problem.cam_from_world, model.cam_from_world)
        assert tracks(merged.problem) == tracks(model)
        assert merged.counts.num_observations == merged.counts.num_observations_dropped == 0
        assert any("Every image" in note for note in merged.notes)


def test_refining_noisy_halves_reaches_the_optimum_of_the_whole():
    model = whole(noise=0.3, perturbation=1e-3, track=None)  # so every track meets
    a, b = (bundle.solve(half).problem for half in halves(model))
    merged = bundle.merge(a, b)
    assert tracks(merged.problem) == tracks(model)
    best = bundle.solve(model).summary.final_cost
    assert bundle.solve(merged.problem).summary.final_cost == pytest.approx(best, rel=1e-6)


def test_inputs_stay_as_they_were(model):
    a, b = halves(model)
    before = a.num_observations, a.points.copy(), b.points.copy(), tracks(a), tracks(b)
    bundle.merge(a, b)
    assert (a.num_observations, tracks(a), tracks(b)) == (before[0], *before[3:])
    np.testing.assert_array_equal(a.to_pycolmap().num_points3D(), a.num_points)
    np.testing.assert_array_equal(b.points, before[2])


@pytest.mark.parametrize(
    "a, b, words",
    [
        (make_problem(), scene(), "b: expected images with names"),
        (scene(), make_problem(), "a: expected images with names"),
        (
            make_problem(),
            make_problem(image_names=[f"x{i}" for i in range(5)]),
            "0 common names among 5",
        ),
        (make_problem(image_names=["x"] * 5), make_problem(), "images 1 and 2"),
    ],
)
def test_what_cannot_be_matched_is_refused(a, b, words):
    with pytest.raises(InputError, match=words) as caught:
        bundle.merge(a, b)
    assert "\n" not in str(caught.value)


def test_rigs_are_refused_by_name():
    with pytest.raises(InputError, match="a: expected a model without rigs, found"):
        bundle.merge(rig_problem(), make_problem())


def test_lists_of_keypoints_that_were_cut_down_are_found_by_their_pixels(model):
    def observed(half):
        keypoints = np.full(half.num_observations, -1)
        return half.replace(source=None, observation_keypoint=keypoints)

    def places(problem):
        rows = zip(problem.observation_point, problem.observation_image, strict=True)
        pixels = [
            (*row, *xy) for row, xy in zip(rows, problem.observation_xy.tolist(), strict=True)
        ]
        tracks = {}
        for point, image, x, y in pixels:
            tracks.setdefault(point, []).append((problem.image_names[image], x, y))
        return sorted(sorted(track) for track in tracks.values())

    a, b = halves(model)
    whole_lists, cut_lists = bundle.merge(a, b), bundle.merge(observed(a), observed(b))
    assert places(cut_lists.problem) == places(whole_lists.problem)
    assert cut_lists.counts == whole_lists.counts
    assert cut_lists.problem.to_pycolmap().is_valid()


@pytest.mark.parametrize("value", [0, -1, float("nan"), "8"])
def test_a_limit_that_is_none_is_refused(model, value):
    with pytest.raises(InputError, match="max_error"):
        bundle.merge(model, model, max_error=value)
