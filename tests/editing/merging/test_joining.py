"""Images, cameras, points and tracks of the second model after a merge."""

import numpy as np
import pycolmap
import pytest

import bundle
from tests.editing.merging.halves import TO_B, edited, halves, move_point, renumbered, tracks, whole


def test_tracks_are_joined_and_nothing_is_lost(model, merged):
    a, b = halves(model)
    counts = merged.counts
    seen = {track[0] for track in tracks(model)}
    assert {track[0] for track in tracks(merged.problem)} <= seen | {
        element for track in tracks(b) for element in track
    }
    # Every observation of either half is there once.
    union = {e for half in (a, b) for track in tracks(half) for e in track}
    assert sorted(union) == sorted(e for track in tracks(merged.problem) for e in track)
    assert counts.num_observations == len(union) - a.num_observations
    assert counts.num_points_joined > 10 and counts.num_points_added > 10
    assert counts.num_points_apart == counts.num_points_dropped == 0
    assert counts.num_observations_dropped == 0
    assert (counts.num_images, counts.num_cameras) == (3, 0)
    whole_tracks = [set(track) for track in tracks(model)]
    assert all(any(set(t) <= w for w in whole_tracks) for t in tracks(merged.problem))


def test_colours_and_ids_of_both_are_kept_where_they_are_free(model, merged):
    source = merged.problem.to_pycolmap()
    # A's ids, and B's new points under ids that A does not have; both halves took them from one
    # model, so B's points that A has under the same id and did not meet get others.
    a, _ = halves(model)
    colour = {i: p.color.tolist() for i, p in source.points3D.items()}
    assert all(colour[i] == [i % 256, 7, 9] for i in a.point_ids.tolist())
    assert all(value[1:] == [7, 9] for value in colour.values())
    assert source.is_valid()


def test_ids_of_another_run_are_found_by_name(model, merged):
    a, b = halves(model)
    other = bundle.merge(a, renumbered(b, cameras=0, images=-3, points=1000))
    assert tracks(other.problem) == tracks(merged.problem)
    new = dict(zip(other.problem.image_names, other.problem.image_ids.tolist(), strict=True))
    old = dict(zip(a.image_names, a.image_ids.tolist(), strict=True))
    assert old.items() <= new.items()
    assert len(set(new.values())) == 8
    added = set(other.problem.point_ids.tolist()) - set(a.point_ids.tolist())
    assert min(added) > 1000


def test_a_new_camera_keeps_its_parameters_and_a_shared_one_takes_those_of_a():
    model = whole(shared=False)
    a, b = halves(model)
    b = b.replace(camera_params=b.camera_params + 0.5)
    problem = bundle.merge(a, renumbered(b, cameras=-3)).problem
    row = {n: problem.image_camera[i] for i, n in enumerate(problem.image_names)}
    assert problem.num_cameras == 8
    for index in range(8):
        np.testing.assert_allclose(
            problem.camera_params[row[f"image{index}.jpg"]],
            model.camera_params[index] + (0 if index < 5 else 0.5),
        )


def test_another_model_of_a_shared_camera_is_said(model):
    a, b = halves(model)
    changed = bundle.change_camera_model(b, "RADIAL").problem
    merged = bundle.merge(a, changed)
    assert merged.problem.camera_models == ("SIMPLE_RADIAL",)
    assert any("RADIAL" in note and "camera 1" in note for note in merged.notes)


def test_points_that_disagree_stay_apart_and_a_keeps_the_keypoints(model):
    a, b = halves(model)
    clean = bundle.merge(a, b)
    both = sorted(set(a.point_ids.tolist()) & set(b.point_ids.tolist()))
    moved_id = next(i for i in both if (b.point_ids[b.observation_point] == i).sum() >= 3)
    merged = bundle.merge(a, move_point(b, moved_id, [0.8, 0.8, 0.0]))
    counts = merged.counts
    assert counts.num_points_joined == clean.counts.num_points_joined - 1
    assert counts.num_points_apart + counts.num_points_dropped == 1
    assert counts.num_observations_dropped >= 1
    assert merged.similarity.scale == pytest.approx(1 / TO_B.scale, rel=1e-9)
    wide = bundle.merge(a, move_point(b, moved_id, [0.8, 0.8, 0.0]), max_error=1e5)
    assert wide.counts == clean.counts


def conflict(model, num_met, num_free):
    """Halves with a point in B that meets its like in A so often, and is seen so often beside."""
    a, b = halves(model, range(1, 6), range(4, 9))
    met = np.isin(b.image_ids, a.image_ids)[b.observation_image]
    for row, point_id in enumerate(b.point_ids.tolist()):
        seen = b.observation_point == row
        counts = (seen & met).sum(), (seen & ~met).sum()
        if counts == (num_met, num_free) and point_id in a.point_ids:
            return a, move_point(b, point_id, [2.0, 1.0, 0.0]), point_id
    raise AssertionError("no such point")


def test_an_apart_point_keeps_what_is_left_under_an_id_of_its_own(model):
    a, b, point_id = conflict(model, 2, 2)
    merged = bundle.merge(a, b)
    counts = merged.counts
    assert (counts.num_points_apart, counts.num_points_dropped) == (1, 0)
    assert counts.num_observations_dropped == 2
    problem = merged.problem
    place = merged.similarity.apply(b.points[b.point_ids == point_id])
    (row,) = np.flatnonzero(np.abs(problem.points - place).max(axis=1) < 1e-9)
    assert problem.point_ids[row] not in a.point_ids
    images = problem.observation_image[problem.observation_point == row]
    assert len(images) == 2
    assert not {problem.image_names[image] for image in images} & set(a.image_names)
    np.testing.assert_array_equal(
        problem.points[problem.point_ids == point_id], a.points[a.point_ids == point_id]
    )


def test_a_point_with_one_observation_left_is_dropped(model):
    a, b, _ = conflict(model, 2, 1)
    merged = bundle.merge(a, b)
    counts = merged.counts
    assert (counts.num_points_apart, counts.num_points_dropped) == (0, 1)
    assert counts.num_observations_dropped == 3


def test_a_point_that_meets_two_joins_the_one_that_it_meets_most(model):
    a, b = halves(model, range(1, 7), range(4, 9))
    shared = np.isin(a.image_ids, b.image_ids)[a.observation_image]
    chosen = next(
        i
        for i in a.point_ids.tolist()
        if (shared & (a.point_ids[a.observation_point] == i)).sum() == 3
    )

    def split(reconstruction):
        """One shared keypoint of the track goes to another point at the same place."""
        point = reconstruction.point3D(chosen)
        element = max(point.track.elements, key=lambda e: e.image_id)
        image, keypoint = element.image_id, element.point2D_idx
        spare = reconstruction.image(1).num_points2D()
        reconstruction.image(1).points2D.append(pycolmap.Point2D([5.0, 5.0]))
        reconstruction.delete_observation(image, keypoint)
        track = [pycolmap.TrackElement(image, keypoint), pycolmap.TrackElement(1, spare)]
        # The least id, so that ties alone would choose it.
        new = pycolmap.Point3D(xyz=point.xyz, track=pycolmap.Track(track))
        reconstruction.add_point3D_with_id(0, new)

    problem = bundle.merge(edited(a, split), b).problem

    def length(point_id):
        return (problem.point_ids[problem.observation_point] == point_id).sum()

    assert length(0) == 2
    assert length(chosen) == (model.point_ids[model.observation_point] == chosen).sum() - 1


def test_a_track_is_not_continued_in_an_image_that_it_sees(model):
    a, b = halves(model)
    # A keypoint of a shared image that B alone has, seen by a point that A's track meets there.
    shared = next(
        (int(i), int(p))
        for i, p in zip(b.observation_image, b.observation_point, strict=True)
        if b.image_ids[i] == 4
        and b.point_ids[p] in a.point_ids
        and (
            (a.point_ids[a.observation_point] == b.point_ids[p])
            & (a.image_ids[a.observation_image] == 4)
        ).any()
    )
    point_id = int(b.point_ids[shared[1]])

    def doubled(reconstruction):
        image = reconstruction.image(4)
        image.points2D.append(pycolmap.Point2D([3.0, 4.0]))
        element = pycolmap.TrackElement(4, image.num_points2D() - 1)
        reconstruction.add_observation(point_id, element)

    clean, merged = bundle.merge(a, b), bundle.merge(a, edited(b, doubled))
    assert tracks(merged.problem) == tracks(clean.problem)
    assert merged.counts.num_observations_dropped == 1


def test_a_camera_of_another_image_size_stays(model):
    a, b = halves(model)
    merged = bundle.merge(a, b.replace(camera_sizes=b.camera_sizes * 2))
    assert merged.counts.num_cameras == 1 and len(merged.notes) == 1
    assert merged.problem.camera_sizes.tolist() == [[800, 600], [1600, 1200]]


def test_a_camera_that_was_split_goes_to_the_one_of_most_images():
    model = whole()
    a, b = halves(model, range(1, 7), range(4, 9))
    split = bundle.split_cameras(a)
    joined = bundle.share_cameras(split, split.camera_ids[[4, 5]].tolist())
    merged = bundle.merge(joined, b)
    row = {name: index for index, name in enumerate(merged.problem.image_names)}
    camera = merged.problem.image_camera
    assert camera[row["image7.jpg"]] == camera[row["image4.jpg"]] != camera[row["image3.jpg"]]
    assert any("2 cameras" in note for note in merged.notes)


def test_a_camera_of_shared_images_alone_is_not_spoken_of():
    a, b = halves(whole(shared=False))
    assert bundle.merge(a, b.replace(camera_sizes=b.camera_sizes * 2)).notes == ()
