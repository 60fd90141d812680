"""COLMAP models whose files are not kept in memory: they are read in parts, twice."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap
import pytest

import bundle
from bundle import InputError
from tests.io.colmap_models import fields, synthesize, write_model

Large = Callable[..., Path]

LARGEST_IN_MEMORY = 4 << 20
FORMATS = pytest.mark.parametrize("binary", [True, False], ids=["binary", "text"])


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Large:
    """Copies of a model whose images and points are in files of more than 4 MB."""
    made: dict[bool, Path] = {}

    def copy(folder: Path, *, binary: bool) -> Path:
        if binary not in made:
            made[binary] = write_large(tmp_path_factory.mktemp("large") / "model", binary=binary)
        shutil.copytree(made[binary], folder)
        return folder

    return copy


def write_large(folder: Path, *, binary: bool) -> Path:
    reconstruction = synthesize(5)
    if binary:  # an image with many keypoints without a point, and many points without a track
        points = reconstruction.image(3).points2D
        xy = np.random.default_rng(5).uniform(0, 700, (180_000, 2))
        points.extend(pycolmap.Point2DList([pycolmap.Point2D(at) for at in xy]))
        for _ in range(90_000):
            reconstruction.add_point3D(np.ones(3), pycolmap.Track(), np.array([1, 2, 3], np.uint8))
        return write_model(reconstruction, folder, binary=True)
    write_model(reconstruction, folder, binary=False)
    for name in ("images.txt", "points3D.txt"):  # lines across the blocks of the reader
        text = (folder / name).read_bytes().replace(b"\n", b"\r\n")
        (folder / name).write_bytes(b"# " + b"c" * 2_500_000 + b"\n" + text + b"#" * 2_500_000)
    return folder


def suffix(binary: bool) -> str:
    return ".bin" if binary else ".txt"


@FORMATS
def test_a_solution_is_written_into_the_text_that_was_read(
    tmp_path: Path, large: Large, binary: bool
) -> None:
    folder = large(tmp_path / "in", binary=binary)
    for stem in ("images", "points3D"):
        assert (folder / f"{stem}{suffix(binary)}").stat().st_size > LARGEST_IN_MEMORY
    problem = bundle.load(folder)
    moved = problem.replace(points=problem.points + 0.125)
    assert bundle.save(moved, tmp_path / "out", "colmap" if binary else "colmap-text") == ()
    before, after = (fields(pycolmap.Reconstruction(tmp_path / name)) for name in ("in", "out"))
    for point_id, (xyz, *rest) in before["points"].items():
        assert after["points"][point_id] == ([x + 0.125 for x in xyz], *rest)
    for name in ("cameras", "rigs", "frames", "images"):
        assert after[name] == before[name]
    if not binary:
        for name in ("images.txt", "points3D.txt"):
            texts = [(tmp_path / side / name).read_bytes() for side in ("in", "out")]
            for part in (slice(2_500_000), slice(-2_500_000, None)):
                assert texts[0][part] == texts[1][part]
            assert texts[0].count(b"\r\n") == texts[1].count(b"\r\n")


@FORMATS
def test_the_arrays_are_those_of_the_small_file(tmp_path: Path, large: Large, binary: bool) -> None:
    problem = bundle.load(large(tmp_path / "large", binary=binary))
    small = bundle.load(write_model(synthesize(5), tmp_path / "small", binary=binary))
    for name in ("observation_xy", "observation_image", "observation_keypoint", "cam_from_world"):
        np.testing.assert_array_equal(getattr(problem, name), getattr(small, name))
    np.testing.assert_array_equal(problem.points[: small.num_points], small.points)


def test_lines_may_lie_anywhere_in_the_blocks(tmp_path: Path) -> None:
    folder = write_model(synthesize(5), tmp_path / "in", binary=False)
    small = bundle.load(folder)
    texts = {name: (folder / name).read_bytes() for name in ("images.txt", "points3D.txt")}
    block = 1 << 20
    for shift in np.linspace(0, max(map(len, texts.values())), 25).astype(int).tolist():
        for name, text in texts.items():
            padding = b"#" * (block - shift - 1) + b"\n" + text
            (folder / name).write_bytes(padding + b"#" * (LARGEST_IN_MEMORY + 1 - len(padding)))
        problem = bundle.load(folder)
        for array in ("observation_xy", "observation_point", "points", "cam_from_world"):
            np.testing.assert_array_equal(getattr(problem, array), getattr(small, array))


@FORMATS
def test_errors_have_their_lines_and_bytes(tmp_path: Path, large: Large, binary: bool) -> None:
    folder = large(tmp_path / "in", binary=binary)
    path = folder / f"points3D{suffix(binary)}"
    content = bytearray(path.read_bytes())
    if binary:
        content[-8:] = (9).to_bytes(8, "little")  # a track that is not there
        place = f"byte {len(content) - 8}"
    else:
        at = content.rindex(b"\r\n", 0, content.rindex(b"\r\n")) + 2
        content[at : at + 1] = b"x"
        place = str(content[:at].count(b"\n") + 1)
    path.write_bytes(content)
    with pytest.raises(InputError, match=rf"points3D\.\w+: ?{place}: expected .* found"):
        bundle.load(folder)


def test_another_file_of_the_same_name_changes_nothing(tmp_path: Path, large: Large) -> None:
    """Programs that write atomically give the name to a new file."""
    folder = large(tmp_path / "in", binary=False)
    problem = bundle.load(folder)
    (tmp_path / "other").write_bytes(b"nothing")
    (tmp_path / "other").replace(folder / "points3D.txt")
    shutil.rmtree(folder)
    assert bundle.save(problem, tmp_path / "out") == ()
    again = bundle.load(tmp_path / "out")
    np.testing.assert_array_equal(again.points, problem.points)
    assert problem.to_pycolmap().num_points3D() == problem.num_points


@pytest.mark.parametrize("format", ["colmap", "colmap-text", "nvm", "opensfm"])
@pytest.mark.parametrize("change", ["overwritten", "truncated", "emptied", "longer"])
def test_a_result_outlives_its_files(
    tmp_path: Path, large: Large, change: str, format: str
) -> None:
    """The files are written to while a solve runs; pages of a mapped file would be gone."""
    folder = large(tmp_path / "in", binary=False)
    problem = bundle.load(folder)
    if format == "nvm":
        lens = {"camera_params": problem.camera_params * [1, 1, 1, 0]}
        problem = problem.replace(**lens)
    moved = problem.replace(points=problem.points + 1)
    for name in ("points3D.txt", "images.txt"):
        with (folder / name).open("r+b") as file:
            if change == "overwritten":
                file.seek(2_600_000)
                file.write(b"7")
            file.truncate(
                {"truncated": 3_000_000, "emptied": 0, "longer": 9_000_000}.get(change)
                if change != "overwritten"
                else None
            )
    os.utime(folder / "points3D.txt", ns=(1, 1))
    lost = bundle.save(moved, tmp_path / "out", format)
    assert "has changed since it was read" in lost[0]
    again = bundle.load(tmp_path / "out", image_size="unknown")
    assert again.num_observations == moved.num_observations
    np.testing.assert_allclose(np.sort(again.points, axis=0), np.sort(moved.points, axis=0))
    with pytest.raises(InputError, match="the input file has changed while it was in use"):
        moved.to_pycolmap()


MEMORY = """
import re, sys
from pathlib import Path
import bundle

def peak():
    return 1024 * int(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1])

small, path, *options = sys.argv[1:]
sizes = {"image_size": (4000, 3000)} if options else {}
bundle.load(small, **sizes)
before = peak()
problem = bundle.load(path, **sizes)
arrays = sum(a.nbytes for a in vars(problem).values() if hasattr(a, "nbytes"))
print((peak() - before) / arrays)
"""


def many(num_points: int) -> bundle.Problem:
    """Points in front of cameras with five observations each, exact to a tenth of a pixel."""
    rng = np.random.default_rng(num_points)
    num_images, track = 40, 5
    centers = np.column_stack([np.arange(num_images), np.zeros((num_images, 2))])
    points = np.column_stack([rng.uniform(0, 40, num_points), rng.uniform(-1, 1, num_points)])
    points = np.column_stack([points, rng.uniform(20, 30, num_points)])
    first = rng.integers(0, num_images - track, num_points)
    image = (first[:, None] + np.arange(track)).ravel().astype(np.int32)
    point = np.repeat(np.arange(num_points, dtype=np.int32), track)
    inside = points[point] - centers[image]
    xy = 1500 * inside[:, :2] / inside[:, 2:] + [2000, 1500]
    return bundle.Problem(
        cam_from_world=np.column_stack([np.tile([0, 0, 0, 1.0], (num_images, 1)), -centers]),
        image_camera=np.zeros(num_images, np.int32),
        image_names=tuple(f"image {i}.jpg" for i in range(num_images)),
        camera_models=("SIMPLE_PINHOLE",),
        camera_params=np.array([[1500.0, 2000, 1500]]),
        camera_sizes=np.array([[4000, 3000]]),
        points=points,
        observation_image=image,
        observation_point=point,
        observation_xy=xy + rng.normal(0, 0.3, xy.shape),
    )


FILES = {
    "colmap": "model/",
    "colmap-text": "model/",
    "bal": "problem.txt",
    "bundler": "bundle.out",
    "nvm": "model.nvm",
    "opensfm": "project/",
    "openmvg": "sfm_data.json",
}


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="Linux")
@pytest.mark.parametrize("format", list(FILES))
def test_reading_takes_three_times_the_arrays(tmp_path: Path, format: str) -> None:
    paths = []
    for number, num_points in enumerate((100, 200_000 if format == "opensfm" else 100_000)):
        (tmp_path / str(number)).mkdir()
        path = tmp_path / str(number) / FILES[format]
        bundle.save(many(num_points), path, format)
        paths.append(str(path))
    options = ["sizes"] if format in ("bundler", "nvm") else []
    command = [sys.executable, "-c", MEMORY, *paths, *options]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert float(done.stdout) <= 3
