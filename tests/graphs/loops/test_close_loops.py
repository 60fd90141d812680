"""Drifted models whose loops are closed: bundle adjustment alone ends elsewhere."""

import numpy as np
import pytest

import bundle
from bundle.model.residuals import reprojection_error
from tests.graphs.loops.drift import (
    ate,
    centers_and_rotations,
    closures_of,
    drifted_street,
    pairs_far_apart,
    with_poses,
)
from tests.rig_scenes import rig_problem


@pytest.fixture(scope="module")
def street():
    return drifted_street()


def test_bundle_adjustment_alone_ends_in_a_wrong_minimum_and_with_loops_in_the_right_one(street):
    truth, model, scales = street
    alone = bundle.solve(model).problem
    closed = bundle.close_loops(model, closures_of(truth, scales))
    refined = bundle.solve(closed.problem, factors=closed.factors).problem
    best = bundle.solve(truth).problem
    assert closed.num_used == 6 and closed.num_rejected == 0 and not closed.factors
    assert ate(model, truth) > 1 and ate(closed.problem, truth) < 0.5
    assert ate(alone, truth) > 5 * ate(best, truth) > ate(refined, truth)
    assert reprojection_error(alone).rmse > 2 * reprojection_error(best).rmse
    np.testing.assert_allclose(
        reprojection_error(refined).rmse, reprojection_error(best).rmse, rtol=1e-3
    )
    assert closed.has_free_scales and closed.scale_range[0] == pytest.approx(
        1 / scales[-1], rel=0.1
    )
    assert closed.num_components == 1 and closed.num_nodes == truth.num_images
    assert closed.cost_after < closed.cost_before


def test_wrong_closures_are_rejected(street):
    truth, model, scales = street
    closures = closures_of(truth, scales, 8, wrong=2)
    closed = bundle.close_loops(model, closures)
    assert [closure.used for closure in closed.closures] == [True] * 6 + [False] * 2
    assert ate(closed.problem, truth) < 0.5
    assert all(c.translation_after > 1 for c in closed.closures[6:])
    assert all(c.translation_after < 0.2 and c.rotation_after < 1 for c in closed.closures[:6])


def test_one_of_two_closures_may_be_wrong(street):
    truth, model, scales = street
    closed = bundle.close_loops(model, closures_of(truth, scales, 2, wrong=1))
    assert [closure.used for closure in closed.closures] == [True, False]


def test_where_no_points_hold_the_loop_its_closures_are_factors(street):
    """Tracks are split between the passes, as where the loop had not been seen."""
    truth, model, scales = street
    late = truth.observation_image >= truth.num_images // 2
    point = truth.observation_point + np.where(late, truth.num_points, 0)
    image = truth.observation_image
    turned, centers = centers_and_rotations(truth)
    bent, where = centers_and_rotations(model)
    points = np.zeros((2 * truth.num_points, 3))
    keys, first = np.unique(point, return_index=True)
    seen = image[first]
    local = truth.points[keys % truth.num_points] - centers[seen]
    local = turned[seen].inv().apply(local)
    points[keys] = bent[seen].apply(local) * scales[seen, None] + where[seen]
    split = model.replace(
        points=points, point_ids=np.arange(len(points)), observation_point=point.astype(np.int32)
    )
    late_first = pairs_far_apart(truth, 6)[:, ::-1]  # measured where the model has grown
    closed = bundle.close_loops(split, closures_of(truth, scales, pairs=late_first))
    assert closed.num_used == len(closed.factors) == 6
    result = bundle.solve(closed.problem, factors=closed.factors, max_num_iterations=0)
    expected = [0.5 * closure.chi2_after for closure in closed.closures]
    np.testing.assert_allclose(result.factor_costs_before, expected, rtol=0.05)
    refined = bundle.solve(closed.problem, factors=closed.factors)
    assert ate(refined.problem, truth) < 0.5 * ate(bundle.solve(split).problem, truth)


def test_images_of_rigs_move_with_their_frames_and_keep_their_scale():
    problem = rig_problem(num_frames=6, noise=0, perturbation=0, num_alone=1, num_points=60)
    assert problem.num_frames == 6
    a, b = (int(key) for key in problem.image_ids[[0, 11]])
    rotation, center = centers_and_rotations(problem)
    turn = rotation[0].inv() * rotation[11]
    shift = rotation[0].inv().apply(center[11] - center[0]) + np.array([0.05, 0.0, 0.0])
    closures = bundle.PoseGraph(
        poses=np.tile([0, 0, 0, 1.0, 0, 0, 0], (2, 1)),
        ids=[a, b],
        edges=[[0, 1]],
        measurements=[[*turn.as_quat(), *shift]],
        information=1e10 * np.eye(6)[None],
    )
    closed = bundle.close_loops(problem, closures, loss="trivial")
    moved = closed.problem
    assert not closed.has_free_scales and closed.scale_range == (1.0, 1.0)
    assert closed.closures[0].translation_before == pytest.approx(0.05, rel=1e-6)
    assert closed.closures[0].translation_after < 0.005
    np.testing.assert_array_equal(moved.sensor_from_rig, problem.sensor_from_rig)
    after, where = centers_and_rotations(moved)
    apart = after[0].inv().apply(where[11] - where[0])
    np.testing.assert_allclose(apart, shift, atol=0.005)
    np.testing.assert_array_equal(moved.cam_from_world[0], problem.cam_from_world[0])
    assert not np.array_equal(moved.rig_from_world[-1], problem.rig_from_world[-1])
    same = closures.replace(edges=[[0, 1]], ids=problem.image_ids[:2])
    assert problem.image_frame[0] == problem.image_frame[1]
    with pytest.raises(bundle.InputError, match="two frames"):
        bundle.close_loops(problem, same)


def test_a_model_that_closes_already_stays(street):
    truth, _, _ = street
    exact = closures_of(truth, np.ones(truth.num_images), 4, degrees=1e-9, metres=1e-9)
    exact = exact.replace(information=np.tile(np.eye(6), (4, 1, 1)))
    closed = bundle.close_loops(truth, exact)
    np.testing.assert_allclose(closed.problem.cam_from_world, truth.cam_from_world, atol=1e-7)
    assert closed.variance_factor == 1 and closed.num_used == 4
    assert "4 used, 0 rejected" in repr(closed)


def test_pieces_without_points_stay_and_a_closure_joins_them(street):
    truth, model, scales = street
    lonely = with_poses(model, *centers_and_rotations(model), model.points)
    gone = ~np.isin(lonely.observation_image, [20])
    lonely = lonely.replace(
        observation_image=lonely.observation_image[gone],
        observation_point=lonely.observation_point[gone],
        observation_xy=lonely.observation_xy[gone],
        observation_keypoint=lonely.observation_keypoint[gone],
    )
    closed = bundle.close_loops(lonely, closures_of(truth, scales))
    assert closed.num_components == 2
    np.testing.assert_allclose(
        closed.problem.cam_from_world[20], model.cam_from_world[20], rtol=1e-12
    )


def test_misuse(street, tmp_path):
    truth, model, scales = street
    closures = closures_of(truth, scales, 2)
    ids = closures.ids.copy()
    ids[closures.edges[1, 1]] = 777
    bundle.save(closures.replace(ids=ids), tmp_path / "x.g2o")
    line = 1 + [row.split()[0] for row in (tmp_path / "x.g2o").read_text().splitlines()].index(
        "EDGE_SE3:QUAT"
    )
    with pytest.raises(bundle.InputError, match=rf"x\.g2o:{line + 1}: .* 777"):
        bundle.close_loops(model, tmp_path / "x.g2o")
    flat = bundle.PoseGraph(
        poses=np.zeros((2, 3)),
        edges=[[0, 1]],
        measurements=np.zeros((1, 3)),
        information=[np.eye(3)],
    )
    with pytest.raises(bundle.InputError, match="in 3D"):
        bundle.close_loops(model, flat)
    none = closures.replace(
        edges=np.zeros((0, 2), np.int32), measurements=np.zeros((0, 7)),
        information=np.zeros((0, 6, 6)), edge_lines=None,
    )  # fmt: skip
    with pytest.raises(bundle.InputError, match="found 0"):
        bundle.close_loops(model, none)
    with pytest.raises(bundle.InputError, match="loss"):
        bundle.close_loops(model, closures, loss="tukey")
    with pytest.raises(bundle.InputError, match="positive semidefinite"):
        bundle.close_loops(model, closures.replace(information=-closures.information))
    with pytest.raises(bundle.InputError, match="closures"):
        bundle.close_loops(model, 5)
