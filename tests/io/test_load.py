"""Formats of paths that are read or written; stand-ins note the calls for COLMAP models."""

import subprocess
import sys
from pathlib import Path

import pytest

import bundle
import bundle.io.colmap
from tests.io.bal_files import bal_text, gzip_bytes, load_bytes, make_bal


@pytest.fixture
def problem(tmp_path: Path) -> bundle.Problem:
    return load_bytes(tmp_path, bal_text(*make_bal(1)), "in.txt")


@pytest.fixture
def colmap(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str, bool]]:
    """Stand in for what reads and writes COLMAP models; returns the list of calls."""
    calls: list[tuple[str, str, bool]] = []

    def load(path: Path) -> str:
        calls.append(("load", str(path), True))
        return "a model"

    def save(_: bundle.Problem, folder: Path, binary: bool = True) -> tuple[str, ...]:
        calls.append(("save", str(folder), binary))
        write_model(folder, ".bin" if binary else ".txt")
        return ("colours",)

    monkeypatch.setattr(bundle.io.colmap, "load", load)
    monkeypatch.setattr(bundle.io.colmap, "save", save)
    return calls


def write_model(folder: Path, suffix: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for stem in ("cameras", "images", "points3D"):
        (folder / (stem + suffix)).write_text("")
    return folder


@pytest.mark.parametrize("suffix", [".bin", ".txt"])
@pytest.mark.parametrize("as_text", [False, True])
def test_a_model_folder_is_colmaps(tmp_path: Path, colmap, suffix: str, as_text: bool) -> None:
    folder = write_model(tmp_path / "model", suffix)
    assert bundle.load(str(folder) if as_text else folder) == "a model"
    assert colmap == [("load", str(folder), True)]


def test_a_folder_that_is_no_model(tmp_path: Path) -> None:
    with pytest.raises(bundle.InputError) as error:
        bundle.load(tmp_path)
    found = "found a folder without cameras.bin, images.bin, points3D.bin"
    assert str(error.value) == f"{tmp_path}: expected a COLMAP model, {found}"

    write_model(tmp_path / "sparse/0", ".bin")
    write_model(tmp_path / "sparse/1", ".txt")
    candidates = " or ".join(str(tmp_path / "sparse" / name) for name in "01")
    for folder in (tmp_path / "sparse", tmp_path):  # the project's folder, too
        with pytest.raises(bundle.InputError) as error:
            bundle.load(folder)
        assert str(error.value).endswith(f"; try {candidates}")

    (write_model(tmp_path / "text", ".txt") / "images.txt").unlink()
    with pytest.raises(bundle.InputError, match=r"found a folder without images\.txt$"):
        bundle.load(tmp_path / "text")

    (tmp_path / "sparse/0/images").mkdir()
    with pytest.raises(bundle.InputError, match=f"; try {tmp_path}/sparse/0$"):
        bundle.load(tmp_path / "sparse/0/images")


def test_a_file_of_a_model_points_to_its_folder(tmp_path: Path) -> None:
    folder = write_model(tmp_path, ".txt")
    with pytest.raises(bundle.InputError, match=f"found one of its files; try {folder}$"):
        bundle.load(folder / "images.txt")


@pytest.mark.parametrize("name", ["a.txt", "a.bz2", "a", "cameras.txt", "a.ply"])
def test_any_other_file_is_bal_whatever_its_name(tmp_path: Path, name: str) -> None:
    text = bal_text(*make_bal(2))
    assert load_bytes(tmp_path, text, name).num_images == 4
    assert load_bytes(tmp_path, gzip_bytes(text), name).num_images == 4


@pytest.mark.parametrize(
    ("source", "name", "format", "expected"),
    [
        ("bal", "out", None, "bal"),
        ("bal", "out.txt", None, "bal"),
        ("bal", "out/", None, "colmap"),
        ("bal", "empty", None, "colmap"),
        ("bal", "out.txt", "colmap", "colmap"),
        ("bal", "out.txt", "colmap-text", "colmap-text"),
        ("colmap", "out", None, "colmap"),
        ("colmap", "out.txt", None, "bal"),
        ("colmap", "OUT.TXT.BZ2", None, "bal"),
        ("colmap", "out.txt.gz", None, "bal"),
        ("colmap", "out.bz2", None, "colmap"),
        ("colmap", "out", "bal", "bal"),
        ("memory", "out", None, "colmap"),
        ("memory", "out.txt", None, "bal"),
    ],
)
def test_choice_of_format(
    tmp_path: Path, problem, colmap, source: str, name: str, format: str | None, expected: str
) -> None:
    (tmp_path / "empty").mkdir()
    target = f"{tmp_path}/{name}"
    problem = problem.replace(format=source)
    assert bundle.io.open.output_format(problem.format, target, format) == expected
    bundle.io.open.check_target(problem, target, format)
    assert bundle.save(problem, target, format) == (() if expected == "bal" else ("colours",))
    if expected == "bal":
        assert not colmap
        assert bundle.load(target).num_observations == problem.num_observations
    else:
        assert [(call[0], call[2]) for call in colmap] == [("save", expected == "colmap")]
        assert len(list(Path(target).iterdir())) == 3


@pytest.mark.parametrize(
    ("name", "magic"), [("o.txt", b"4 9"), ("o.txt.gz", b"\x1f\x8b"), ("O.TXT.BZ2", b"BZh")]
)
def test_the_name_chooses_the_compression(tmp_path: Path, problem, name: str, magic: bytes) -> None:
    bundle.save(problem, tmp_path / name)
    assert (tmp_path / name).read_bytes().startswith(magic)


def test_an_unknown_format_is_named(tmp_path: Path, problem) -> None:
    with pytest.raises(
        bundle.InputError, match=r"expected one of bal, colmap, colmap-text, bundler, .*found 'obj'"
    ):
        bundle.save(problem, tmp_path / "out", "obj")


@pytest.mark.usefixtures("colmap")
def test_check_target_refuses_what_save_would(tmp_path: Path, problem) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder/file.txt").write_text("")
    fisheye = problem.replace(camera_models=("SIMPLE_RADIAL_FISHEYE",) * 4)
    for refused, name, format in (
        (problem, "folder", "bal"),
        (problem, "folder", "colmap"),
        (problem, "folder/file.txt", "colmap"),
        (problem, "folder/file.txt/out.txt", None),
        (fisheye, "out.txt", None),
    ):
        with pytest.raises(bundle.InputError) as checked:
            bundle.io.open.check_target(refused, tmp_path / name, format)
        with pytest.raises(bundle.InputError) as saved:
            bundle.save(refused, tmp_path / name, format)
        assert str(checked.value) == str(saved.value)
        assert len(str(checked.value).splitlines()) == 1
    bundle.io.open.check_target(problem, tmp_path / "out.txt")
    assert not (tmp_path / "out.txt").exists()


def test_a_bal_file_needs_no_pycolmap(tmp_path: Path) -> None:
    """Its import takes longer than most loads."""
    path = tmp_path / "in.txt"
    path.write_bytes(bal_text(*make_bal(3)))
    code = "import bundle, sys; bundle.load(sys.argv[1]); assert 'pycolmap' not in sys.modules"
    subprocess.run([sys.executable, "-c", code, str(path)], check=True)


def test_check_target_refuses_edits_that_colmap_cannot_hold(tmp_path: Path, problem) -> None:
    below = problem.replace(image_ids=[-1, 1, 2, 3])
    for call in (bundle.io.open.check_target, bundle.save):
        with pytest.raises(bundle.InputError, match=r"^image_ids: .* found -1$"):
            call(below, tmp_path / "out", "colmap")
    assert not (tmp_path / "out").exists()
