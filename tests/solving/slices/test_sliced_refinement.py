"""BAL files and COLMAP models in slices: the same steps, files and report as from the whole."""

import dataclasses

import numpy as np
import pytest

import bundle
from bundle.solving.ranks.partition import divide
from bundle.solving.slices.sliced_refinement import SlicedRefinement, SliceJob
from tests.rig_scenes import STEREO, rig_problem
from tests.scenes import scene, with_observations
from tests.solving.ranks.thread_crew import ThreadCrew, processes


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("slices") / "model.txt"
    bundle.save(scene(), path)
    return path


def refined(path, output, num_ranks, **options):
    crew = ThreadCrew(num_ranks)
    sliced = SlicedRefinement(crew, path)
    result = sliced.solve(bundle.SolveOptions(num_threads=1, **options), None)
    assert sliced.save(output) == ()
    sliced.measure(result)
    assert not crew.is_solving
    return result, sliced


def contents(path):
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    return {file.name if path.is_dir() else "": file.read_bytes() for file in files}


def test_errors_on_the_same_observations_are_those_of_the_whole_file(tmp_path):
    """Some observations are behind their camera, in one slice only; a loss has outliers."""
    problem = scene(noise=2.0)
    points = problem.points.copy()
    points[0, 2] = -40.0
    path = tmp_path / "behind.txt"
    bundle.save(problem.replace(points=points), path)
    options = {"loss": "cauchy", "loss_scale": 0.7, "cheirality": "zero"}
    result, _ = refined(path, tmp_path / "sliced.txt", 2, **options)
    with processes(2):
        whole = bundle.solve(path, num_threads=1, **options)
    for side in ("before", "after", "inliers"):
        found, expected = (vars(getattr(of.kept, side)) for of in (result, whole))
        np.testing.assert_allclose(list(found.values()), list(expected.values()), rtol=1e-12)
    assert result.kept.num_observations == whole.kept.num_observations == 120
    assert 0 < result.kept.before.num_behind_camera < 120
    assert result.kept.inliers.num_outliers > 0
    assert (result.deleted, result.edit_errors) == (whole.deleted, ())
    assert result.movement == whole.movement


@pytest.mark.parametrize("num_ranks", [2, 3])
def test_it_is_what_the_whole_file_gives(path, tmp_path, num_ranks):
    options = {"refine": ("poses", "points", "focal", "principal_point", "extra")}
    result, _ = refined(path, tmp_path / "sliced.txt", num_ranks, **options)
    with processes(num_ranks):
        whole = bundle.solve(path, num_threads=1, **options)
    whole.measure()
    bundle.save(whole.problem, tmp_path / "whole.txt")
    assert (tmp_path / "sliced.txt").read_bytes() == (tmp_path / "whole.txt").read_bytes()
    np.testing.assert_array_equal(result.iterations["cost"], whole.iterations["cost"])
    for name in ("reprojection_error_before", "reprojection_error_after"):
        found, expected = (dataclasses.asdict(getattr(of, name)) for of in (result, whole))
        np.testing.assert_allclose(list(found.values()), list(expected.values()), rtol=1e-13)
    found, expected = result.worst_images, whole.worst_images
    assert [image.image_id for image in found] == [image.image_id for image in expected]
    assert [i.num_observations for i in found] == [i.num_observations for i in expected]
    assert [image.max for image in found] == [image.max for image in expected]
    assert result.problem.num_points == whole.problem.num_points
    assert result.problem.num_observations == whole.problem.num_observations


@pytest.mark.parametrize("num_ranks", [2, 3])
@pytest.mark.parametrize("num_alone", [None, 2])
def test_a_colmap_model_is_what_the_whole_gives(tmp_path, num_ranks, num_alone):
    """Files byte for byte, errors of points too; keypoints and colours are those of the input."""
    problem = scene() if num_alone is None else rig_problem(num_alone=num_alone)
    source = tmp_path / "model"
    bundle.save(problem, source, "colmap")
    points = source / "points3D.bin"
    coloured = bytearray(points.read_bytes())
    coloured[40:43] = b"\1\2\3"  # of the first point
    points.write_bytes(coloured)
    options = {"refine_sensor_from_rig": True} if problem.num_frames else {}
    result, sliced = refined(source, tmp_path / "sliced", num_ranks, **options)
    with processes(num_ranks):
        whole = bundle.solve(source, num_threads=1, **options)
    bundle.save(whole.problem, tmp_path / "whole")
    assert len(result.iterations["cost"]) > 2
    np.testing.assert_array_equal(result.iterations["cost"], whole.iterations["cost"])
    written = contents(tmp_path / "sliced")
    assert written == contents(tmp_path / "whole")
    assert written["points3D.bin"][40:43] == b"\1\2\3"
    assert written["points3D.bin"] != bytes(coloured)
    assert result.reprojection_error_after.max == whole.reprojection_error_after.max
    if problem.num_frames:
        assert result.gauge_freedom.sentence == whole.gauge_freedom.sentence
    assert sliced.cameras.num_points == problem.num_points


def test_gauge_of_rigs_with_held_points(tmp_path):
    """Points held in different slices; the second half of the points ties pieces together."""
    source = tmp_path / "model"
    bundle.save(rig_problem(rigs=(STEREO, STEREO)), source, "colmap")
    ids = bundle.load(source).point_ids
    for fixed in ((), ids[:1], ids[[0, -1]], ids[[0, 9, -1]]):
        options = {"fixed_point_ids": tuple(fixed.tolist()) if len(fixed) else ()}
        result, _ = refined(source, tmp_path / "out", 3, max_num_iterations=1, **options)
        expected = bundle.gauge_freedom(source, **options)
        assert result.gauge_freedom.degrees == expected.degrees
        assert result.gauge_freedom.num_pieces == expected.num_pieces


def test_fixed_points_of_a_colmap_model(tmp_path):
    problem = scene()
    source, output = tmp_path / "model", tmp_path / "out"
    ids = 3 * np.arange(problem.num_points) + 100
    bundle.save(problem.replace(point_ids=ids), source, "colmap")
    fixed = [100, 103, int(ids[-1])]
    refined(source, output, 2, fixed_point_ids=fixed)
    moved = (bundle.load(output).points != bundle.load(source).points).any(axis=1)
    np.testing.assert_array_equal(~moved, np.isin(ids, fixed))
    crew = ThreadCrew(2)
    sliced = SlicedRefinement(crew, source)
    with pytest.raises(bundle.InputError, match="found 101"):
        sliced.solve(bundle.SolveOptions(fixed_point_ids=(101,)), None)
    crew.barrier.abort()


@pytest.mark.parametrize("name", ["images.bin", "points3D.bin"])
def test_a_colmap_model_that_changes(tmp_path, name):
    source, output = tmp_path / "model", tmp_path / "out"
    bundle.save(scene(), source, "colmap")
    sliced = SlicedRefinement(ThreadCrew(2), source)
    result = sliced.solve(bundle.SolveOptions(num_threads=1, max_num_iterations=1), None)
    with (source / name).open("r+b") as file:
        file.truncate(100)
    with pytest.raises(bundle.InputError, match="changed"):
        sliced.save(output)
    assert not output.exists()
    sliced.measure(result)


def test_a_colmap_model_in_its_own_place(tmp_path):
    """Text files of an older model go, and are named; other files stay."""
    source = tmp_path / "model"
    bundle.save(scene(), source, "colmap")
    (source / "notes.md").write_text("mine")
    (source / "points3D.txt").write_text("# old")
    before = contents(source)
    crew = ThreadCrew(2)
    sliced = SlicedRefinement(crew, source)
    sliced.solve(bundle.SolveOptions(num_threads=1, max_num_iterations=2), None)
    (sentence,) = sliced.save(source)
    assert "points3D.txt" in sentence
    after = contents(source)
    assert after.keys() == before.keys() - {"points3D.txt"}
    assert after["notes.md"] == b"mine"
    assert after["images.bin"] != before["images.bin"]
    crew.barrier.abort()


def test_slices_are_the_parts_of_the_whole(path):
    problem = bundle.load(path)
    crew = ThreadCrew(3)
    sliced = SlicedRefinement(crew, path)
    points = divide(problem, 3).parts
    np.testing.assert_array_equal(np.flatnonzero(sliced._survey.owner == 1), points[1])
    own = sliced._slice
    np.testing.assert_array_equal(own.part.point_ids, points[0])
    np.testing.assert_array_equal(own.part.points, problem.points[points[0]])
    seen = np.isin(problem.observation_point, points[0])
    np.testing.assert_array_equal(own.part.observation_xy, problem.observation_xy[seen])
    np.testing.assert_array_equal(own.part.observation_image, problem.observation_image[seen])
    crew.barrier.abort()


def test_images_that_only_another_slice_sees_are_refined(tmp_path):
    """Points of the first slice are in no image of the second half."""
    problem = scene(num_images=6, num_points=60)
    late = problem.observation_image >= 3
    keep = late == (problem.observation_point >= 30)
    path = tmp_path / "model.txt"
    bundle.save(with_observations(problem, keep), path)
    result, sliced = refined(path, tmp_path / "sliced.txt", 2)
    assert len(np.unique(sliced._slice.part.observation_image)) == 3
    assert sliced._slice.image_is_observed.tolist() == [1] * 6
    with processes(2):
        whole = bundle.solve(path, num_threads=1)
    bundle.save(whole.problem, tmp_path / "whole.txt")
    assert (tmp_path / "sliced.txt").read_bytes() == (tmp_path / "whole.txt").read_bytes()
    moved = result.problem.cam_from_world != result.initial_problem.cam_from_world
    assert moved.any(axis=1).all()


def test_fixed_points_of_any_slice_stay(path, tmp_path):
    before = bundle.load(path).points
    fixed = (0, 7, len(before) - 1)
    refined(path, tmp_path / "out.txt", 3, fixed_point_ids=fixed)
    after = bundle.load(tmp_path / "out.txt").points
    np.testing.assert_array_equal(after[list(fixed)], before[list(fixed)])
    assert (after != before).any(axis=1).sum() == len(before) - len(fixed)


def test_a_point_that_is_not_there(path):
    crew = ThreadCrew(2)
    sliced = SlicedRefinement(crew, path)
    with pytest.raises(bundle.InputError, match="found 100000"):
        sliced.solve(bundle.SolveOptions(fixed_point_ids=(100000,)), None)
    crew.barrier.abort()


@pytest.mark.parametrize(
    ("text", "word"), [("1 1 1\n0 0 a", "2"), ("2 3 0\n" + "1\n" * 27, "observations")]
)
def test_bad_files(tmp_path, text, word):
    path = tmp_path / "bad.txt"
    path.write_text(text)
    with pytest.raises(bundle.InputError, match=word):
        SlicedRefinement(ThreadCrew(2), path)


def test_another_file_in_another_process(path, tmp_path, monkeypatch):
    other = tmp_path / "other.txt"
    problem = bundle.load(path)
    kept = {
        name: getattr(problem, f"observation_{name}")[:-20] for name in ("image", "point", "xy")
    }
    fewer = {f"observation_{name}": values for name, values in kept.items()}
    bundle.save(problem.replace(**fewer, observation_keypoint=np.full(len(kept["xy"]), -1)), other)
    work = SliceJob.work
    monkeypatch.setattr(SliceJob, "work", lambda _, meeting: work(SliceJob(other), meeting))
    crew = ThreadCrew(2)
    with pytest.raises(bundle.InputError, match="same file"):
        SlicedRefinement(crew, path)
    crew.barrier.abort()


def test_a_file_that_changes(path, tmp_path):
    """Counts are compared when observations are copied."""
    copy = tmp_path / "model.txt"
    copy.write_bytes(path.read_bytes())
    sliced = SlicedRefinement(ThreadCrew(2), copy)
    result = sliced.solve(bundle.SolveOptions(num_threads=1, max_num_iterations=1), None)
    bundle.save(scene(seed=5, num_points=20), copy)
    with pytest.raises(bundle.InputError, match="changed"):
        sliced.save(tmp_path / "out.txt")
    assert not (tmp_path / "out.txt").exists()
    sliced.measure(result)
