"""A BAL file in slices: the same steps, file and report as from the whole file."""

import dataclasses

import numpy as np
import pytest

import bundle
from bundle.ranks.partition import divide
from bundle.slices.bal_refinement import BalRefinement, SliceJob
from tests.ranks.thread_crew import ThreadCrew, processes
from tests.scenes import scene


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("slices") / "model.txt"
    bundle.save(scene(), path)
    return path


def refined(path, output, num_ranks, **options):
    crew = ThreadCrew(num_ranks)
    sliced = BalRefinement(crew, path)
    result = sliced.solve(bundle.SolveOptions(num_threads=1, **options), None)
    assert sliced.save(output) == ()
    sliced.measure(result)
    assert not crew.is_solving
    return result, sliced


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


def test_slices_are_the_parts_of_the_whole(path):
    problem = bundle.load(path)
    crew = ThreadCrew(3)
    sliced = BalRefinement(crew, path)
    points = divide(problem, 3)
    np.testing.assert_array_equal(np.flatnonzero(sliced._survey.owner == 1), points[1])
    own = sliced._slice
    np.testing.assert_array_equal(own.points, points[0])
    np.testing.assert_array_equal(own.part.points, problem.points[points[0]])
    seen = np.isin(problem.observation_point, points[0])
    np.testing.assert_array_equal(own.part.observation_xy, problem.observation_xy[seen])
    np.testing.assert_array_equal(own.part.observation_image, problem.observation_image[seen])
    crew.barrier.abort()


def test_fixed_points_of_any_slice_stay(path, tmp_path):
    before = bundle.load(path).points
    fixed = (0, 7, len(before) - 1)
    refined(path, tmp_path / "out.txt", 3, fixed_point_ids=fixed)
    after = bundle.load(tmp_path / "out.txt").points
    np.testing.assert_array_equal(after[list(fixed)], before[list(fixed)])
    assert (after != before).any(axis=1).sum() == len(before) - len(fixed)


def test_a_point_that_is_not_there(path):
    crew = ThreadCrew(2)
    sliced = BalRefinement(crew, path)
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
        BalRefinement(ThreadCrew(2), path)


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
        BalRefinement(crew, path)
    crew.barrier.abort()


def test_a_file_that_changes(path, tmp_path):
    """Counts are compared when observations are copied."""
    copy = tmp_path / "model.txt"
    copy.write_bytes(path.read_bytes())
    sliced = BalRefinement(ThreadCrew(2), copy)
    result = sliced.solve(bundle.SolveOptions(num_threads=1, max_num_iterations=1), None)
    bundle.save(scene(seed=5, num_points=20), copy)
    with pytest.raises(bundle.InputError, match="changed"):
        sliced.save(tmp_path / "out.txt")
    assert not (tmp_path / "out.txt").exists()
    sliced.measure(result)
