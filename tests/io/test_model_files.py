"""Models that an error can point to: near ones, never a walk over the whole disk."""

from pathlib import Path

from bundle.io.atomic import replaced_paths
from bundle.io.atomic.replaced_paths import missing_model_files, models_below


def make_model(folder: Path) -> Path:
    folder.mkdir(parents=True)
    for stem in ("cameras", "images", "points3D"):
        (folder / f"{stem}.bin").touch()
    return folder


def test_the_nearest_come_first_and_depth_ends(tmp_path: Path) -> None:
    far = make_model(tmp_path / "dense/0/sparse")
    near = make_model(tmp_path / "sparse")
    inside = make_model(tmp_path / "sparse/0")
    make_model(tmp_path / "a/b/c/d")
    assert models_below(tmp_path) == [near, inside, far]


def test_links_are_not_followed(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to(tmp_path, target_is_directory=True)
    model = make_model(tmp_path / "sparse/0")
    assert models_below(tmp_path) == [model]


def test_the_search_is_bounded(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(replaced_paths, "MOST_FOLDERS", 3)
    for name in "abcde":
        make_model(tmp_path / name)
    assert models_below(tmp_path) == [tmp_path / name for name in "abc"]


def test_a_model_has_three_files(tmp_path: Path) -> None:
    folder = make_model(tmp_path / "model")
    assert not missing_model_files(folder)
    assert missing_model_files(tmp_path)
    assert missing_model_files(tmp_path / "nothing")
    (folder / "images.bin").unlink()
    assert missing_model_files(folder) == ("images.bin",)
