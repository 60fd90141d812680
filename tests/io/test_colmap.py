"""COLMAP models on disk: nothing is lost, nothing but the refined numbers changes."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from bundle import InputError, Problem
from bundle.io import colmap
from tests.io.colmap_models import (
    ARRAYS,
    REAL_MODELS,
    bal_like,
    errors_of,
    fields,
    synthesize,
    write_model,
)


def saved(problem: Problem, folder: Path, *, binary: bool) -> pycolmap.Reconstruction:
    folder.mkdir(parents=True)
    assert colmap.write(problem, folder, binary=binary) == ()
    return pycolmap.Reconstruction(folder)


@pytest.mark.parametrize("binary", [True, False], ids=["binary", "text"])
@pytest.mark.parametrize("name", REAL_MODELS)
def test_real_model_survives_unchanged(
    bundle_data: Path, tmp_path: Path, name: str, binary: bool
) -> None:
    source = pycolmap.Reconstruction(bundle_data / "colmap" / name)
    result = saved(colmap.load(bundle_data / "colmap" / name), tmp_path / "out", binary=binary)
    assert fields(result) == fields(source)
    source.update_point_3d_errors()
    expected = errors_of(source)
    assert errors_of(result) == {i: pytest.approx(error, rel=1e-9) for i, error in expected.items()}


@pytest.mark.parametrize("name", REAL_MODELS)
def test_observations_of_the_files_are_those_of_the_reconstruction(
    bundle_data: Path, name: str
) -> None:
    folder = bundle_data / "colmap" / name
    loaded = colmap.load(folder)
    converted = Problem.from_pycolmap(pycolmap.Reconstruction(folder))
    for array in (*ARRAYS, "observation_keypoint"):
        np.testing.assert_array_equal(getattr(loaded, array), getattr(converted, array))


@pytest.mark.parametrize("read_binary", [True, False], ids=["from-binary", "from-text"])
@pytest.mark.parametrize("write_binary", [True, False], ids=["to-binary", "to-text"])
def test_synthetic_model_survives_unchanged(
    tmp_path: Path, read_binary: bool, write_binary: bool
) -> None:
    source = synthesize(1)
    problem = colmap.load(write_model(source, tmp_path / "in", binary=read_binary))
    assert fields(saved(problem, tmp_path / "out", binary=write_binary)) == fields(source)


def test_binary_is_preferred(tmp_path: Path) -> None:
    folder = write_model(synthesize(1), tmp_path / "model", binary=True)
    write_model(synthesize(2, num_points=11), tmp_path / "other", binary=False)
    for file in (tmp_path / "other").iterdir():
        file.rename(folder / file.name)
    assert colmap.load(folder).num_points == 40
    (folder / "points3D.bin").unlink()
    assert colmap.load(folder).num_points == 11


def test_unregistered_images_stay(tmp_path: Path) -> None:
    source = synthesize(6)
    lost = sorted(source.reg_image_ids())[2]
    source.deregister_frame(source.image(lost).frame_id)
    problem = Problem.from_pycolmap(source)
    assert lost not in problem.image_ids
    assert problem.num_images == source.num_images() - 1
    assert fields(problem.to_pycolmap()) == fields(source)

    (tmp_path / "out").mkdir()
    (sentence,) = colmap.write(problem, tmp_path / "out", binary=True)
    assert "1 of 10" in sentence
    np.testing.assert_array_equal(colmap.load(tmp_path / "out").image_ids, problem.image_ids)


@pytest.mark.parametrize("binary", [True, False], ids=["binary", "text"])
def test_new_reconstruction_with_ids_from_zero(tmp_path: Path, binary: bool) -> None:
    problem = bal_like()
    saved(problem, tmp_path / "out", binary=binary)
    loaded = colmap.load(tmp_path / "out")
    order = np.lexsort((problem.observation_image, problem.observation_point))
    for name in ARRAYS:
        expected = getattr(problem, name)
        if name.startswith("observation"):
            expected = expected[order]
        np.testing.assert_array_equal(getattr(loaded, name), expected)
    assert loaded.camera_models == problem.camera_models
    assert loaded.image_names == tuple(f"image_{i:06d}" for i in range(problem.num_images))
    for image_index in range(problem.num_images):
        of_image = problem.observation_image == image_index
        image = loaded.source.image(image_index)
        np.testing.assert_array_equal(
            [point.xy for point in image.points2D], problem.observation_xy[of_image]
        )


def test_names_with_spaces_survive_text(tmp_path: Path) -> None:
    source = synthesize(11)
    for image_id, image in source.images.items():
        image.name = f"my holiday/{image_id}  final.jpg"
    folder = write_model(source, tmp_path / "in", binary=False)
    problem = colmap.load(folder)
    assert fields(problem.to_pycolmap()) == fields(source)
    (tmp_path / "out").mkdir()
    (sentence,) = colmap.write(problem, tmp_path / "out", binary=False)
    assert "spaces" in sentence
    assert (tmp_path / "out" / "images.txt").read_bytes() == (folder / "images.txt").read_bytes()


def test_text_needs_names(tmp_path: Path) -> None:
    source = synthesize(12)
    source.image(1).name = ""
    problem = Problem.from_pycolmap(source)
    saved(problem, tmp_path / "binary", binary=True)
    (tmp_path / "text").mkdir()
    with pytest.raises(InputError, match=r"^image 1: expected a name"):
        colmap.write(problem, tmp_path / "text", binary=False)


def test_save_into_a_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="No such file or directory"):
        colmap.write(bal_like(), tmp_path / "missing", binary=True)


def run(code: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.parametrize("binary", [True, False], ids=["binary", "text"])
def test_loading_and_saving_print_nothing(tmp_path: Path, binary: bool) -> None:
    folder = write_model(synthesize(14), tmp_path / "in", binary=binary)
    (tmp_path / "out").mkdir()
    code = (
        "import pathlib, sys; from bundle.io import colmap\n"
        "problem, folder = colmap.load(sys.argv[1]), pathlib.Path(sys.argv[2])\n"
        "colmap.write(problem, folder, binary=sys.argv[3] == 'y')"
    )
    result = run(code, folder, tmp_path / "out", "y" if binary else "n")
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")


@pytest.mark.parametrize("binary", [True, False], ids=["binary", "text"])
def test_disk_that_fills_is_noticed(tmp_path: Path, binary: bool) -> None:
    folder = write_model(synthesize(15), tmp_path / "in", binary=True)
    (tmp_path / "out").mkdir()
    code = (
        "import pathlib, resource, sys; from bundle.io import colmap\n"
        "problem = colmap.load(sys.argv[1])\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (3000, 3000))\n"
        "try: colmap.write(problem, pathlib.Path(sys.argv[2]), binary=sys.argv[3] == 'y')\n"
        "except OSError as error: print(error)"
    )
    result = run(code, folder, tmp_path / "out", "y" if binary else "n")
    assert "File too large" in result.stdout
    assert (result.returncode, result.stderr, result.stdout.count("\n")) == (0, "", 1)
