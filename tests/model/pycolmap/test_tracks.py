"""Observations on the keypoints of a database, and COLMAP's triangulator on a problem."""

import numpy as np
import pycolmap
import pytest

import bundle
from bundle.io.database_images import database_matches
from bundle.model.pycolmap.tracks import FARTHEST_KEYPOINT, TrackBuilder, on_keypoints
from tests.track_scenes import damaged, synthesize


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scene")
    truth = synthesize(folder, num_frames_per_rig=5, num_points3D=80)
    return truth, database_matches(folder / "database.db", truth.image_names)


def placed(problem, keypoints):
    return on_keypoints(problem, keypoints, "x.db")


def test_a_model_of_the_database_stays_as_it_is(scene):
    truth, matches = scene
    assert placed(truth, matches.keypoints) is truth
    start = damaged(truth, "observations")
    assert placed(start, matches.keypoints) is start


def test_keypoints_in_another_order_are_found_by_their_place(scene):
    truth, matches = scene
    order = np.random.default_rng(0).permutation(len(matches.keypoints[2]))
    keypoints = [*matches.keypoints]
    keypoints[2] = keypoints[2][order]
    found = placed(truth, keypoints)
    assert found is not truth
    here = truth.observation_image == 2
    np.testing.assert_array_equal(
        order[found.observation_keypoint[here]], truth.observation_keypoint[here]
    )
    np.testing.assert_array_equal(
        found.observation_keypoint[~here], truth.observation_keypoint[~here]
    )
    image = found.to_pycolmap().image(int(truth.image_ids[2]))
    np.testing.assert_allclose([point.xy for point in image.points2D], keypoints[2], atol=1e-4)


def test_keypoints_at_one_place_are_taken_in_turn(scene):
    """SIFT has a keypoint for each orientation: two observations of them are two keypoints."""
    truth, matches = scene
    keypoints = [xy.copy() for xy in matches.keypoints]
    rows = np.flatnonzero(truth.observation_image == 0)[:2]
    first, second = truth.observation_keypoint[rows]
    keypoints[0][second] = keypoints[0][first]
    xy = truth.observation_xy.copy()
    xy[rows[1]] = xy[rows[0]]
    shifted = [np.vstack([xy[:1] + 100, xy]) for xy in keypoints]
    found = placed(truth.replace(observation_xy=xy), shifted).observation_keypoint[rows]
    assert set(found.tolist()) == {first + 1, second + 1}
    shifted[0][second + 1] += 50
    with pytest.raises(bundle.InputError, match=r"found 1 without one$"):
        placed(truth.replace(observation_xy=xy), shifted)


@pytest.mark.parametrize("shift", [0.9, 1.1])
def test_other_keypoints_are_refused(scene, shift):
    truth, matches = scene
    keypoints = [*matches.keypoints]
    keypoints[1] = keypoints[1] + [shift * FARTHEST_KEYPOINT, 0]
    if shift < 1:
        assert placed(truth, keypoints) is truth
        return
    with pytest.raises(bundle.InputError, match=rf"^x.db: .*image {truth.image_names[1]} "):
        placed(truth, keypoints)


def test_values_and_deletions_are_taken(scene):
    truth, matches = scene
    start = damaged(truth, "observations")
    start = bundle.filter_observations(start).problem
    builder = TrackBuilder(start, *matches, 4.0, 1.5)
    first, counts = builder.extend()
    assert counts.triangulated > 0
    assert first.num_observations > start.num_observations
    kept = np.ones(first.num_observations, bool)
    short = first.observation_point == 0  # loses all but two, then one point loses all
    kept[np.flatnonzero(short)[2:]] = False
    kept[first.observation_point == 1] = False
    moved = first.replace(
        points=first.points + 1e-4, camera_params=first.camera_params * (1 + 1e-7)
    )
    builder.take(moved, kept)
    left = builder._read()
    assert left.num_observations == kept.sum()
    assert left.num_points == first.num_points - 1
    stays = first.point_ids != first.point_ids[1]
    np.testing.assert_array_equal(left.point_ids, first.point_ids[stays])
    np.testing.assert_array_equal(left.points, moved.points[stays])
    made = builder._reconstruction
    assert made.is_valid()
    camera = made.camera(int(truth.camera_ids[0]))
    np.testing.assert_array_equal(camera.params, moved.camera_params[0])
    image = made.image(int(truth.image_ids[0]))
    np.testing.assert_allclose(image.cam_from_world().translation, truth.cam_from_world[0, 4:])
    # The deleted observations match the points that stay: they return.
    second, _ = builder.extend()
    assert second.num_observations > left.num_observations


def test_each_step_of_the_triangulator_counts(scene):
    """All images are triangulated once, the other steps are taken each time."""
    truth, matches = scene
    builder = TrackBuilder(truth, *matches, 4.0, 1.5)
    steps = []

    class Recorded:
        def __getattr__(self, name):
            counts = {"triangulate_image": 1, "complete_all_tracks": 10, "merge_all_tracks": 100}

            def step(*given):
                steps.append((name, *given[1:]))
                return counts.get(name, 1000)

            return step

    builder._triangulator = Recorded()
    first, again = builder.extend()[1], builder.extend()[1]
    assert first == (truth.num_images + 1000, 10, 100)
    assert again == (1000, 10, 100)
    names = [("complete_all_tracks",), ("merge_all_tracks",), ("retriangulate",)]
    images = [("triangulate_image", key) for key in truth.image_ids.tolist()]
    assert steps == [*images, *names, *names]


def test_limits_are_those_of_the_filter(scene):
    truth, matches = scene
    options = TrackBuilder(truth, *matches, 1.5, 3.0)._options
    assert (options.complete_max_reproj_error, options.merge_max_reproj_error) == (1.5, 1.5)
    assert options.min_angle == 3.0
    own = pycolmap.IncrementalTriangulatorOptions().min_angle
    assert TrackBuilder(truth, *matches, 4.0, 0.0)._options.min_angle == own


def test_any_lens_gets_tracks(scene):
    """A mapper skips images with a distortion above 1; these lenses are those of a solve."""
    truth, matches = scene
    radial = truth.camera_params.copy()
    bare = damaged(truth, "points")
    added = []
    for k in (0.0, 1.5):
        params = np.column_stack([radial[:, :3], np.full(len(radial), k)])
        start = bare.replace(camera_params=params)
        added.append(sum(TrackBuilder(start, *matches, 1e4, 1.5).extend()[1]))
    assert min(added) > 0


def test_results_do_not_depend_on_chance(scene):
    truth, matches = scene
    start = damaged(truth, "split")
    one, other = (TrackBuilder(start, *matches, 4.0, 1.5).extend()[0] for _ in range(2))
    np.testing.assert_array_equal(one.points, other.points)
    np.testing.assert_array_equal(one.observation_keypoint, other.observation_keypoint)
