"""Checkpoints of slices: those of the whole model, for any number of processes."""

import json
import shutil

import numpy as np
import pytest

import bundle
from bundle.solving.ranks.partition import divide, part_of
from bundle.solving.rounds.input_digest import digest, digest_of_parts, sums_of_rows
from bundle.solving.rounds.plan import RunPlan
from bundle.solving.slices.sliced_refinement import AllSlices, SlicedRefinement
from tests.rig_scenes import rig_problem
from tests.scenes import scene
from tests.solving.ranks.thread_crew import ThreadCrew, processes

OPTIONS = {"num_threads": 1, "deterministic": True, "function_tolerance": 1e-12}


@pytest.fixture(scope="module", params=["bal", "colmap"])
def source(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp(request.param)
    if request.param == "bal":
        bundle.save(scene(), folder / "model.txt")
        return folder / "model.txt"
    bundle.save(rig_problem(num_alone=1), folder / "model", "colmap")
    return folder / "model"


def refined(source, output, num_ranks, keep=None, **given):
    """Refine; `keep` = (checkpoint, copy) copies the checkpoint as it is at iteration 3."""
    crew = ThreadCrew(num_ranks)
    sliced = SlicedRefinement(crew, source)

    def progress(record):
        if record["iteration"] == 3 and keep is not None:
            shutil.copy(*keep)

    flags = {name: given.pop(name) for name in ("checkpoint", "resume") if name in given}
    options = bundle.SolveOptions(**OPTIONS | given)
    result = sliced.solve(options, progress, RunPlan(checkpoint_interval=2, **flags))
    sliced.save(output)
    sliced.measure(result)
    return result


def points(path):
    return bundle.load(path).points


def contents(path):
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    return [file.read_bytes() for file in files]


def test_a_killed_run_ends_where_the_others_do(source, tmp_path):
    """Bit for bit as the run that was not killed, in slices or divided by the first process."""
    name = source.name
    (out := tmp_path / "out").mkdir()
    (again := tmp_path / "again").mkdir()
    (whole := tmp_path / "whole").mkdir()
    file, copy = tmp_path / "run.npz", tmp_path / "copy.npz"
    first = refined(source, out / name, 3, checkpoint=file, keep=(file, copy))
    assert len(first.iterations["cost"]) > 4
    second = refined(source, again / name, 3, resume=copy)
    begun = second.initial_problem.cam_from_world
    np.testing.assert_array_equal(begun, bundle.load(source).cam_from_world)
    assert contents(again / name) == contents(out / name)
    np.testing.assert_array_equal(second.iterations["cost"], first.iterations["cost"])
    assert second.reprojection_error_before == first.reprojection_error_before
    with processes(3):
        kept = bundle.solve_rounds(
            source,
            checkpoint=tmp_path / "other.npz",
            num_rounds=0,
            checkpoint_interval=2,
            **OPTIONS,
        )
    bundle.save(kept.problem, whole / name)
    assert contents(whole / name) == contents(out / name)
    np.testing.assert_array_equal(kept.iterations["cost"], first.iterations["cost"])


def test_an_interrupted_run_goes_on(source, tmp_path):
    """Ctrl-C keeps the best state, but the run has not ended: resumed, it ends where others do."""
    name, file = source.name, tmp_path / "run.npz"
    for folder in ("whole", "again"):
        (tmp_path / folder).mkdir()
    expected = refined(source, tmp_path / "whole" / name, 2, checkpoint=tmp_path / "whole.npz")

    def stop(record):
        if record["iteration"] == 3:
            raise KeyboardInterrupt

    crew = ThreadCrew(2)
    sliced = SlicedRefinement(crew, source)
    options = bundle.SolveOptions(**OPTIONS)
    stopped = sliced.solve(options, stop, RunPlan(checkpoint=file, checkpoint_interval=2))
    assert stopped.summary.interrupted and stopped.summary.is_solution_usable
    crew.barrier.abort()
    with np.load(file) as archive:
        assert not json.loads(archive["meta"].tobytes())["has_ended"]
    result = refined(source, tmp_path / "again" / name, 2, resume=file)
    np.testing.assert_array_equal(result.iterations["cost"], expected.iterations["cost"])
    assert contents(tmp_path / "again" / name) == contents(tmp_path / "whole" / name)


def test_any_number_of_processes_goes_on(source, tmp_path, monkeypatch):
    name = source.name
    file, copy = tmp_path / "run.npz", tmp_path / "copy.npz"
    (tmp_path / "out").mkdir()
    (tmp_path / "two").mkdir()
    refined(source, tmp_path / "out" / name, 3, checkpoint=file, keep=(file, copy))
    ends = [points(tmp_path / "out" / name)]
    shutil.copy(copy, tmp_path / "two.npz")
    refined(source, tmp_path / "two" / name, 2, resume=tmp_path / "two.npz")
    ends.append(points(tmp_path / "two" / name))
    shutil.copy(copy, tmp_path / "one.npz")
    one = bundle.solve_rounds(
        source, resume=tmp_path / "one.npz", num_rounds=0, checkpoint_interval=2, **OPTIONS
    )
    ends.append(one.problem.points)
    for end in ends[1:]:
        np.testing.assert_allclose(end, ends[0], atol=1e-6)
    # What one process has ended, several only write, and the other way round.
    (tmp_path / "late").mkdir()
    with np.load(file) as archive:
        assert json.loads(archive["meta"].tobytes())["has_ended"]
    monkeypatch.delattr(AllSlices, "run")
    late = refined(source, tmp_path / "late" / name, 2, resume=tmp_path / "one.npz")
    assert late.initial_problem.num_points == len(ends[0])
    np.testing.assert_array_equal(late.iterations["cost"], one.iterations["cost"])
    written = bundle.load(tmp_path / "late" / name)
    np.testing.assert_array_equal(written.points, one.problem.points)
    np.testing.assert_array_equal(written.camera_params, one.problem.camera_params)
    begun = late.initial_problem.camera_params
    np.testing.assert_array_equal(begun, bundle.load(source).camera_params)
    ended = bundle.solve_rounds(
        source,
        resume=file,
        num_rounds=0,
        checkpoint_interval=2,
        **OPTIONS,
    )
    np.testing.assert_array_equal(ended.problem.points, ends[0])


def test_checkpoints_of_something_else(source, tmp_path):
    name, file = source.name, tmp_path / "run.npz"
    (tmp_path / "out").mkdir()
    refined(source, tmp_path / "out" / name, 2, checkpoint=file)
    with pytest.raises(bundle.InputError, match="another input"):
        refined(tmp_path / "out" / name, tmp_path / "no" / name, 2, resume=file)
    with pytest.raises(bundle.InputError, match="loss"):
        refined(source, tmp_path / "no" / name, 2, resume=file, loss="huber")
    with np.load(file) as archive:
        arrays = dict(archive)
    for damage in (arrays["points"][1:], np.full_like(arrays["points"], np.nan)):
        np.savez(file, **arrays | {"points": damage})
        with pytest.raises(bundle.InputError, match="damaged"):
            refined(source, tmp_path / "no" / name, 2, resume=file)
    with pytest.raises(bundle.InputError, match="checkpoint_interval"):
        RunPlan(checkpoint=tmp_path / "new.npz", checkpoint_interval=0)


def test_parts_add_up_to_the_digest_of_the_whole(source):
    problem = bundle.load(source)
    whole = digest(problem)
    division = divide(problem, 3)
    parts = [
        sums_of_rows(part_of(problem, points, division.section), points)
        for points in division.parts
    ]
    assert digest_of_parts(problem, np.sum(parts, axis=0, dtype=np.uint64)) == whole
    for name in ("points", "observation_xy", "camera_params", "cam_from_world"):
        changed = np.array(getattr(problem, name))
        changed[-1, 0] = np.nextafter(changed[-1, 0], 9)
        assert digest(problem.replace(**{name: changed})) != whole
    image, seen = problem.observation_image, problem.observation_point
    swapped = {"observation_point": np.r_[seen[1], seen[0], seen[2:]]}
    if (seen[0], image[0]) == (seen[1], image[0]):
        swapped = {"observation_image": np.r_[image[1], image[0], image[2:]]}
    assert digest(problem.replace(**swapped)) != whole
    assert digest(problem.replace(observation_sigma=np.ones(len(seen)))) != whole
