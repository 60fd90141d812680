"""Models written by replacing numbers in their files, held against what pycolmap writes of them."""

import dataclasses
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap
import pytest

import bundle
from bundle import InputError, Problem
from bundle.io.colmap import can_rewrite
from tests.io.colmap_models import fields, synthesize, write_model

FORMATS = pytest.mark.parametrize("binary", [True, False], ids=["binary", "text"])


def model(tmp_path: Path, *, binary: bool, legacy: bool = False, seed: int = 3) -> Path:
    folder = write_model(synthesize(seed), tmp_path / "in", binary=binary)
    if legacy:
        for file in [*folder.glob("rigs.*"), *folder.glob("frames.*")]:
            file.unlink()
    return folder


def solved(problem: Problem, seed: int = 0) -> Problem:
    """Return the problem with other poses of norm 1, parameters and points, one behind a camera."""
    rng = np.random.default_rng(seed)
    poses = problem.cam_from_world + rng.normal(0, 1e-3, problem.cam_from_world.shape)
    poses[:, :4] /= np.linalg.norm(poses[:, :4], axis=1, keepdims=True)
    points = problem.points + rng.normal(0, 1e-3, problem.points.shape)
    moved = Problem.replace(problem, cam_from_world=poses)
    first = int(np.flatnonzero(problem.observation_point == 0)[0])
    image = problem.observation_image[first]
    away = moved.projection_centers[image] - points[0]
    points[0] += 2 * away
    return moved.replace(camera_params=problem.camera_params * (1 + 1e-3), points=points)


def errors_of(reconstruction: pycolmap.Reconstruction) -> list[float]:
    return [point.error for _, point in sorted(reconstruction.points3D.items())]


def by_pycolmap(problem: Problem, folder: Path, *, binary: bool) -> pycolmap.Reconstruction:
    """Return what is written of a problem whose source is a reconstruction in memory."""
    return write_model_of(problem.replace(source=problem.source), folder, binary=binary)


def write_model_of(problem: Problem, folder: Path, *, binary: bool) -> pycolmap.Reconstruction:
    bundle.save(problem, folder, "colmap" if binary else "colmap-text")
    return pycolmap.Reconstruction(folder)


@FORMATS
@pytest.mark.parametrize("legacy", [False, True], ids=["frames", "legacy"])
def test_a_solution_is_written_as_pycolmap_writes_it(
    tmp_path: Path, binary: bool, legacy: bool
) -> None:
    problem = solved(bundle.load(model(tmp_path, binary=binary, legacy=legacy)))
    assert can_rewrite(problem, binary=binary)
    assert not can_rewrite(problem, binary=not binary)
    ours = write_model_of(problem, tmp_path / "ours", binary=binary)
    assert can_rewrite(problem, binary=binary)  # nobody has asked for a reconstruction
    theirs = by_pycolmap(problem, tmp_path / "theirs", binary=binary)
    assert fields(ours) == fields(theirs)
    np.testing.assert_allclose(errors_of(ours), errors_of(theirs), rtol=1e-9)
    assert max(errors_of(ours)) > 1e100  # behind a camera
    suffix = ".bin" if binary else ".txt"
    names = {f"{stem}{suffix}" for stem in ("cameras", "frames", "images", "points3D", "rigs")}
    assert {file.name for file in (tmp_path / "ours").iterdir()} == names


@FORMATS
def test_a_point_without_observations_has_the_error_that_pycolmap_gives_it(
    tmp_path: Path, binary: bool
) -> None:
    reconstruction = synthesize(3)
    alone = reconstruction.add_point3D(np.array([0.1, 0.2, 0.3]), pycolmap.Track())
    folder = write_model(reconstruction, tmp_path / "in", binary=binary)
    problem = solved(bundle.load(folder))
    assert can_rewrite(problem, binary=binary)
    ours = write_model_of(problem, tmp_path / "ours", binary=binary)
    theirs = by_pycolmap(problem, tmp_path / "theirs", binary=binary)
    assert ours.points3D[alone].error == theirs.points3D[alone].error == -1
    assert fields(ours) == fields(theirs)
    np.testing.assert_allclose(errors_of(ours), errors_of(theirs), rtol=1e-9)


@FORMATS
def test_records_need_not_be_in_the_order_of_their_ids(tmp_path: Path, binary: bool) -> None:
    folder = model(tmp_path, binary=False)
    for name, lines_per_record in (("images", 2), ("cameras", 1), ("points3D", 1), ("frames", 1)):
        path = folder / f"{name}.txt"
        lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
        records = [lines[i : i + lines_per_record] for i in range(0, len(lines), lines_per_record)]
        path.write_text("".join(f"{line}\n" for record in records[::-1] for line in record))
    problem = solved(bundle.load(folder))
    ours = write_model_of(problem, tmp_path / "ours", binary=binary)
    theirs = by_pycolmap(problem, tmp_path / "theirs", binary=binary)
    assert fields(ours) == fields(theirs)
    np.testing.assert_array_equal(bundle.load(tmp_path / "ours").points, problem.points)


@FORMATS
def test_only_numbers_change_in_the_files(tmp_path: Path, binary: bool) -> None:
    folder = model(tmp_path, binary=binary)
    if not binary:  # comments, digits and blanks that COLMAP would not write
        text = (folder / "points3D.txt").read_text()
        (folder / "points3D.txt").write_text(f"# by hand\n{text}\n# end")
    problem = bundle.load(folder)
    bundle.save(problem, tmp_path / "out", "colmap" if binary else "colmap-text")
    for name in ("rigs", "cameras", "frames", "images"):
        file = name + (".bin" if binary else ".txt")
        before, after = (folder / file).read_bytes(), (tmp_path / "out" / file).read_bytes()
        if binary:
            assert before == after
        else:
            assert numbers(before.decode()) == numbers(after.decode())
    if not binary:
        after_text = (tmp_path / "out" / "points3D.txt").read_text()
        assert after_text.startswith("# by hand\n") and after_text.endswith("\n# end")


def numbers(text: str) -> list[object]:
    """Return the words of a text, numbers as such."""

    def value(word: str) -> object:
        try:
            return float(word)
        except ValueError:
            return word

    return [value(word) for word in text.split()]


@FORMATS
def test_what_becomes_of_the_files_after_reading_does_not_matter(
    tmp_path: Path, binary: bool
) -> None:
    folder = model(tmp_path, binary=binary)
    expected = pycolmap.Reconstruction(folder)
    kept, asked = bundle.load(folder), bundle.load(folder)
    for file in folder.iterdir():
        file.write_bytes(b"something else")
    shutil.rmtree(folder)
    assert fields(write_model_of(kept, tmp_path / "out", binary=binary)) == fields(expected)
    assert fields(asked.source) == fields(expected)


@FORMATS
def test_a_source_that_was_asked_for_counts_as_it_is(tmp_path: Path, binary: bool) -> None:
    problem = bundle.load(model(tmp_path, binary=binary))
    edit = problem.replace(points=problem.points + 1.0)
    assert problem.source is edit.source is dataclasses.replace(edit).source
    assert not can_rewrite(edit, binary=binary)
    for point in problem.source.points3D.values():
        point.color = np.array([1, 2, 3], np.uint8)
    written = write_model_of(edit, tmp_path / "out", binary=binary)
    assert all(point.color.tolist() == [1, 2, 3] for point in written.points3D.values())


EDITS: dict[str, Callable[[Problem], Problem]] = {
    "names": lambda p: p.replace(image_names=[f"{i}.png" for i in range(p.num_images)]),
    "image ids": lambda p: p.replace(image_ids=p.image_ids + 1000),
    "point ids": lambda p: p.replace(point_ids=p.point_ids + 100_000),
    "sizes": lambda p: p.replace(camera_sizes=p.camera_sizes + 1),
    "models": lambda p: p.replace(camera_models=["SIMPLE_RADIAL_FISHEYE"] * p.num_cameras),
    "positions": lambda p: p.replace(observation_xy=p.observation_xy + 0.5),
    "cameras": lambda p: p.replace(image_camera=np.zeros(p.num_images, np.int32)),
    "one observation less": lambda p: p.replace(
        observation_image=p.observation_image[1:],
        observation_point=p.observation_point[1:],
        observation_xy=p.observation_xy[1:],
        observation_keypoint=p.observation_keypoint[1:],
    ),
}


@pytest.mark.parametrize("edit", EDITS.values(), ids=EDITS.keys())
def test_other_edits_are_written_too(tmp_path: Path, edit: Callable[[Problem], Problem]) -> None:
    problem = edit(bundle.load(model(tmp_path, binary=True)))
    assert not can_rewrite(problem, binary=True)
    bundle.save(problem, tmp_path / "out")
    again = bundle.load(tmp_path / "out")
    for name in ("image_ids", "image_names", "camera_models", "point_ids"):
        assert list(getattr(again, name)) == list(getattr(problem, name))
    for name in ("camera_sizes", "image_camera", "observation_xy", "observation_point"):
        np.testing.assert_array_equal(getattr(again, name), getattr(problem, name))


def test_numbers_beyond_a_cameras_parameters_are_refused(tmp_path: Path) -> None:
    problem = bundle.load(model(tmp_path, binary=True))
    wide = np.pad(problem.camera_params, ((0, 0), (0, 1)))
    zeros = problem.replace(camera_params=wide)
    assert fields(write_model_of(zeros, tmp_path / "zeros", binary=True)) == fields(problem.source)
    with pytest.raises(InputError, match=r"^camera_params: camera "):
        bundle.save(zeros.replace(camera_params=wide + 1.0), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@FORMATS
def test_it_pickles(tmp_path: Path, binary: bool) -> None:
    problem = bundle.load(model(tmp_path, binary=binary))
    again = pickle.loads(pickle.dumps(problem))
    assert fields(again.source) == fields(problem.source)


def test_a_frame_of_several_images_is_refused(tmp_path: Path) -> None:
    folder = model(tmp_path, binary=False)
    path = folder / "frames.txt"
    lines = [line.split() for line in path.read_text().splitlines() if not line.startswith("#")]
    # Columns: id, rig, pose, number of data, then type, sensor and image of each.
    first = lines[0]
    twin = next(line for line in lines[1:] if line[1] == first[1])
    lines.remove(twin)
    joined = [*first[:9], "2", *first[10:], *twin[10:]]
    path.write_text("".join(" ".join(line) + "\n" for line in [joined, *lines[1:]]))
    expected = rf"^{path}:1: frame {first[0]}: expected at most one image of camera "
    with pytest.raises(InputError, match=expected):
        bundle.load(folder)
