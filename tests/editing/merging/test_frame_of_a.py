"""The similarity between two models, from as little as they share."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle import InputError
from bundle.editing.frame_of_a import find_similarity
from bundle.georeference.similarity import Similarity, moved
from tests.editing.merging.halves import TO_B, edited, halves, move_point, whole


@pytest.fixture(scope="module")
def model():
    return whole()


@pytest.mark.parametrize("first, second", [((1, 2, 3, 4), (4, 5, 6, 7)), ((1, 2, 3), (2, 3, 4, 5))])
def test_one_or_two_shared_images_are_enough_with_points(model, first, second):
    merged = bundle.merge(*halves(model, first, second))
    assert merged.similarity.scale == pytest.approx(1 / TO_B.scale, rel=1e-9)
    assert merged.counts.num_points_joined >= 3


def without_points(model, first, second):
    """Halves whose points lie in images of their own: what is shared is images."""

    def forget(kept):
        def change(reconstruction):
            for point_id in list(reconstruction.points3D):
                if point_id % 2 == kept:
                    reconstruction.delete_point3D(point_id)

        return change

    a, b = halves(model, first, second)
    return edited(a, forget(0)), edited(b, forget(1))


def test_two_shared_images_without_points_determine_seven(model):
    merged = bundle.merge(*without_points(model, range(1, 6), range(4, 9)))
    assert merged.num_pairs == 0 and np.isnan(merged.rms_points)
    assert merged.similarity.scale == pytest.approx(1 / TO_B.scale, rel=1e-9)
    np.testing.assert_allclose(
        merged.problem.projection_centers, model.projection_centers, atol=1e-8
    )


def test_one_shared_image_without_points_leaves_the_scale_open(model):
    with pytest.raises(InputError, match=r"1 shared image .* 0 shared points, which determine 6"):
        bundle.merge(*without_points(model, range(1, 5), range(4, 9)))


def test_one_point_beside_one_image_gives_the_scale(model):
    a, _ = without_points(model, range(1, 5), range(4, 9))
    full = halves(model, range(1, 5), range(4, 9))[1]
    met = set(full.point_ids.tolist()) & set(a.point_ids.tolist())
    view = full.image_ids[full.observation_image] == 4
    met &= set(full.point_ids[full.observation_point[view]].tolist())
    view = a.image_ids[a.observation_image] == 4
    met &= set(a.point_ids[a.observation_point[view]].tolist())
    kept = sorted(met)[0]

    def only(reconstruction):
        for point_id in list(reconstruction.points3D):
            if point_id % 2 and point_id != kept:
                reconstruction.delete_point3D(point_id)

    merged = bundle.merge(a, edited(full, only))
    assert merged.num_pairs == 1
    assert merged.similarity.scale == pytest.approx(1 / TO_B.scale, rel=1e-9)


def test_wrong_points_and_a_misplaced_image_do_not_move_the_rest(model):
    a, b = halves(model)
    rng = np.random.default_rng(1)
    points = b.points.copy()
    wrong = rng.permutation(len(points))[: len(points) * 2 // 5]
    points[wrong] += rng.normal(0, 5, (len(wrong), 3))
    poses = b.cam_from_world.copy()
    poses[0, 4:] += 3
    merged = bundle.merge(a, b.replace(points=points, cam_from_world=poses))
    assert merged.similarity.scale == pytest.approx(1 / TO_B.scale, rel=1e-9)
    assert merged.counts.num_points_apart + merged.counts.num_points_dropped > 0


def test_an_identity_similarity_is_found():
    same = Similarity(1.0, np.eye(3), np.zeros(3))
    merged = bundle.merge(*halves(whole(3), similarity=same))
    np.testing.assert_allclose(merged.similarity.rotation, np.eye(3), atol=1e-10)


def alone(model, points):
    """Image 4 of either half and these points, all met in it."""
    a, b = model, moved(model, TO_B)
    meetings = np.array([(0, point, point) for point in points]).reshape(-1, 3)
    return a, b, np.array([[3, 3]]), meetings


def test_one_wrong_point_of_three_does_not_change_the_scale(model):
    a, b, images, meetings = alone(model, [0, 1, 2])
    b = move_point(b, 2, [30.0, 0.0, 0.0])
    found = find_similarity(a, b, images, meetings)
    assert found.scale == pytest.approx(1 / TO_B.scale, rel=1e-9)
    np.testing.assert_allclose(found.rotation, TO_B.rotation.T, atol=1e-9)


def test_points_outweigh_poses_that_are_turned(model):
    a, b, images, meetings = alone(model, range(40))
    turn = Rotation.from_rotvec([0.01, -0.02, 0.01])
    poses = b.cam_from_world.copy()
    poses[:, :4] = (turn * Rotation.from_quat(poses[:, :4])).as_quat()
    poses[:, 4:] = turn.apply(poses[:, 4:])
    found = find_similarity(a, b.replace(cam_from_world=poses), images, meetings)
    np.testing.assert_allclose(found.rotation, TO_B.rotation.T, atol=1e-9)


@pytest.mark.parametrize("which", [0, 1])
def test_two_images_in_one_place_of_either_model_leave_the_scale_open(model, which):
    problems = [model, moved(model, TO_B)]
    poses = problems[which].cam_from_world.copy()
    poses[4] = poses[3]
    problems[which] = problems[which].replace(cam_from_world=poses)
    with pytest.raises(InputError, match="2 shared images in one place"):
        find_similarity(*problems, np.array([[3, 3], [4, 4]]), np.zeros((0, 3), np.int64))


def test_a_point_that_meets_two_others_counts_with_each(model):
    """Two of three meetings are right; the wrong one comes first."""
    a, b = model, moved(model, TO_B)
    images = np.array([[0, 0]])
    seen = np.unique(model.observation_point[model.observation_image == 0])
    far = int(
        seen[np.argmax(np.linalg.norm(model.points[seen] - model.projection_centers[0], axis=1))]
    )
    one, two = (int(p) for p in seen[seen != far][:2])
    spread = a.replace(
        points=np.where(np.arange(a.num_points)[:, None] == far, 9.0, 1.0) * a.points
    )
    meetings = np.array([[0, far, one], [0, one, one], [0, two, two]])
    found = find_similarity(spread, b, images, meetings)
    assert found.scale == pytest.approx(1 / TO_B.scale, rel=1e-9)
