"""Data of the source stays with the parts that the problem still has, and goes with the others."""

import numpy as np
import pycolmap
import pytest

from bundle import Problem
from bundle.io import colmap
from tests.io.colmap_models import bal_like, fields, synthesize
from tests.io.test_editing import rows, without_cameras_but_one, without_images, without_points

OBSERVED = 5


@pytest.fixture
def problem() -> Problem:
    return Problem.from_pycolmap(synthesize(21))


def keypoints_of(reconstruction: pycolmap.Reconstruction) -> dict[int, list[list[float]]]:
    return {
        image_id: [point.xy.tolist() for point in image.points2D]
        for image_id, image in reconstruction.images.items()
    }


def test_filtering_changes_tracks_and_nothing_else(problem: Problem) -> None:
    kept = np.arange(problem.num_observations) % 4 != 1
    before, after = (
        fields(problem.source),
        fields(problem.replace(**rows(problem, kept)).to_pycolmap()),
    )
    for name in ("cameras", "rigs", "frames"):
        assert after[name] == before[name]
    assert keypoints_of(problem.replace(**rows(problem, kept)).to_pycolmap()) == keypoints_of(
        problem.source
    )
    gone = {
        (int(problem.image_ids[problem.observation_image[o]]), int(problem.observation_keypoint[o]))
        for o in np.flatnonzero(~kept)
    }
    for point_id, (xyz, colour, track) in before["points"].items():
        rest = [element for element in track if element not in gone]
        assert after["points"][point_id] == (xyz, colour, rest)


def test_a_point_goes_from_its_keypoints_which_stay(problem: Problem) -> None:
    gone = np.isin(problem.point_ids, [3, 17])
    result = problem.replace(**without_points(problem, gone)).to_pycolmap()
    assert set(result.points3D) == set(problem.source.points3D) - {3, 17}
    assert keypoints_of(result) == keypoints_of(problem.source)
    assert result.is_valid()
    rest = fields(problem.source)["points"]
    assert fields(result)["points"] == {i: rest[i] for i in result.points3D}


def test_a_point_that_nobody_observes_has_no_error(problem: Problem) -> None:
    result = problem.replace(**rows(problem, problem.observation_point != OBSERVED)).to_pycolmap()
    point = result.point3D(int(problem.point_ids[OBSERVED]))
    assert point.track.length() == 0
    assert not point.has_error()
    assert fields(problem.source)["points"][int(problem.point_ids[OBSERVED])][1] == list(
        point.color
    )


def test_an_image_goes_with_its_frame(problem: Problem) -> None:
    result = problem.replace(**without_images(problem, [1, 8])).to_pycolmap()
    gone = set(problem.image_ids[[1, 8]].tolist())
    assert set(result.images) == set(problem.source.images) - gone
    assert set(result.frames) == {image.frame_id for image in result.images.values()}
    assert set(result.rigs) == set(problem.source.rigs)
    assert result.num_reg_images() == 8
    assert result.is_valid()


def test_a_camera_goes_with_its_rig_and_images_without_pose() -> None:
    source = synthesize(22)
    lost = next(i for i, image in source.images.items() if image.camera_id == 2)
    source.deregister_frame(source.image(lost).frame_id)
    problem = Problem.from_pycolmap(source)
    edited = problem.replace(**without_cameras_but_one(problem))
    result = edited.to_pycolmap()
    assert (set(result.cameras), set(result.rigs)) == ({1}, {1})
    assert set(result.images) == set(problem.image_ids.tolist())
    assert result.is_valid()
    assert lost in problem.to_pycolmap().images


def test_an_image_without_a_pose_gets_one(tmp_path) -> None:
    source = synthesize(23)
    full = Problem.from_pycolmap(source)
    lost = int(full.image_ids[4])
    source.deregister_frame(source.image(lost).frame_id)
    problem = full.replace(source=source)
    (tmp_path / "out").mkdir()
    assert colmap.write(problem, tmp_path / "out", binary=True) == ()
    again = colmap.load(tmp_path / "out")
    for name in ("image_ids", "image_names", "cam_from_world", "observation_keypoint"):
        np.testing.assert_array_equal(getattr(again, name), getattr(full, name))


def test_new_keypoints_come_after_the_others(problem: Problem) -> None:
    before = keypoints_of(problem.source)
    image_id = int(problem.image_ids[2])
    added = problem.replace(
        observation_image=np.append(problem.observation_image, [2, 2]),
        observation_point=np.append(problem.observation_point, [7, 9]),
        observation_xy=np.vstack([problem.observation_xy, [[1, 2], [3, 4]]]),
        observation_keypoint=np.append(problem.observation_keypoint, [-1, -1]),
    )
    result = added.to_pycolmap()
    assert keypoints_of(result) == {**before, image_id: [*before[image_id], [1, 2], [3, 4]]}
    track = fields(problem.source)["points"][int(problem.point_ids[9])][2]
    new = (image_id, len(before[image_id]) + 1)
    assert fields(result)["points"][int(problem.point_ids[9])][2] == [*track, new]


def test_points_that_are_not_in_the_source_are_black_and_named(problem: Problem, tmp_path) -> None:
    ids = problem.point_ids.copy()
    ids[3:5] += 1000
    edited = problem.replace(point_ids=ids)
    (tmp_path / "out").mkdir()
    (loss,) = colmap.write(edited, tmp_path / "out", binary=True)
    assert loss.startswith("2 points are not in the source")
    colours = {i: point.color.tolist() for i, point in edited.to_pycolmap().points3D.items()}
    source = {i: point.color.tolist() for i, point in problem.source.points3D.items()}
    assert colours == {i: source.get(i, [0, 0, 0]) for i in ids.tolist()}


def test_a_problem_without_source_keeps_ids_names_and_sizes(problem: Problem) -> None:
    result = problem.replace(source=None).to_pycolmap()
    assert {i: image.name for i, image in result.images.items()} == dict(
        zip(problem.image_ids.tolist(), problem.image_names, strict=True)
    )
    assert {i: [c.width, c.height] for i, c in result.cameras.items()} == dict(
        zip(problem.camera_ids.tolist(), problem.camera_sizes.tolist(), strict=True)
    )
    assert set(result.points3D) == set(problem.point_ids.tolist())
    assert not any(point.color.any() for point in result.points3D.values())


def test_keypoint_indices_without_gaps_need_no_source() -> None:
    problem = bal_like()
    rng = np.random.default_rng(4)
    keypoint = np.empty(problem.num_observations, int)
    for image in range(problem.num_images):
        of_image = np.flatnonzero(problem.observation_image == image)
        keypoint[of_image] = rng.permutation(len(of_image))
    result = problem.replace(observation_keypoint=keypoint).to_pycolmap()
    for o in range(problem.num_observations):
        points = result.image(int(problem.observation_image[o])).points2D
        assert points[int(keypoint[o])].xy.tolist() == problem.observation_xy[o].tolist()


def test_names_made_up_do_not_repeat_those_that_are_there() -> None:
    problem = bal_like()
    names = ["image_000001", "", "", "b"]
    result = problem.replace(image_names=names).to_pycolmap()
    found = [result.image(i).name for i in range(4)]
    assert found == ["image_000001", "image_000001_", "image_000002", "b"]


def test_a_source_that_was_changed_after_all(problem: Problem) -> None:
    problem.source.delete_point3D(3)
    result = problem.to_pycolmap()
    assert result.is_valid()
    assert result.num_points3D() == problem.num_points
    assert result.compute_num_observations() == problem.num_observations


def test_a_keypoint_without_a_point_gets_one_at_another_place(problem: Problem) -> None:
    image_id = int(problem.image_ids[2])
    keypoints = problem.source.image(image_id).points2D
    free = next(k for k, keypoint in enumerate(keypoints) if not keypoint.has_point3D())
    result = problem.replace(
        observation_image=np.append(problem.observation_image, 2),
        observation_point=np.append(problem.observation_point, 7),
        observation_xy=np.vstack([problem.observation_xy, [1, 2]]),
        observation_keypoint=np.append(problem.observation_keypoint, free),
    ).to_pycolmap()
    keypoint = result.image(image_id).points2D[free]
    assert (keypoint.point3D_id, keypoint.xy.tolist()) == (problem.point_ids[7], [1, 2])


def test_new_images_put_keypoints_that_are_given_before_the_others() -> None:
    problem = bal_like()
    keypoint = np.full(problem.num_observations, -1)
    given = np.flatnonzero(problem.observation_image == 1)[[5, 2]]
    keypoint[given] = [0, 1]
    points = problem.replace(observation_keypoint=keypoint).to_pycolmap().image(1).points2D
    assert [point.xy.tolist() for point in points[:2]] == problem.observation_xy[given].tolist()
