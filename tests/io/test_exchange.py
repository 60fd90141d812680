"""Whole folders change places in one step, and nothing in them is lost."""

import os
import stat
from pathlib import Path

import pytest

from bundle.io.atomic import atomic_write as atomic
from bundle.io.atomic import replacement
from bundle.io.atomic.temporary import temporary_folder
from tests.io.trees import FOREIGN, NEW_MODEL, OLD_MODEL, tree, write_tree


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return write_tree(tmp_path / "model", OLD_MODEL | FOREIGN)


def replace(path: Path) -> None:
    with atomic.replace_folder(path) as temporary:
        write_tree(temporary, NEW_MODEL)


def assert_replaced(path: Path, extra: dict[str, str] | None = None) -> None:
    expected = NEW_MODEL | FOREIGN | (extra or {})
    assert tree(path.parent) == {f"model/{k}": v for k, v in expected.items()}


@pytest.fixture
def exchanged(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The folders that were exchanged; skips where the file system cannot."""
    done, real = [], replacement._exchange

    def noting(first: Path, second: Path) -> None:
        try:
            real(first, second)
        except OSError as error:
            pytest.skip(f"cannot exchange here: {error}")
        done.append(second)

    monkeypatch.setattr(replacement, "_exchange", noting)
    return done


def test_files_beside_the_model_stay_the_same_files(path: Path, exchanged: list[Path]) -> None:
    (path / "link").symlink_to("images")
    (path / "dangling").symlink_to("nowhere")
    (path / "images" / "empty").mkdir()
    write_tree(path, {"backup/cameras.bin": "another model"})
    os.mkfifo(path / "pipe")
    inodes = {name: (path / name).stat().st_ino for name in FOREIGN}
    path.chmod(0o2751)
    times = (path / "images").stat().st_mtime_ns
    replace(path)
    assert exchanged == [path]
    assert stat.S_IMODE(path.stat().st_mode) == 0o2751
    assert inodes == {name: (path / name).stat().st_ino for name in FOREIGN}
    assert all((path / name).stat().st_nlink == 1 for name in FOREIGN)
    assert (path / "link").readlink() == Path("images")
    assert (path / "dangling").is_symlink()
    assert (path / "images" / "empty").is_dir()
    assert (path / "pipe").is_fifo()
    assert (path / "images").stat().st_mtime_ns == times
    (path / "link").unlink()
    (path / "pipe").unlink()
    assert_replaced(path, {"backup/cameras.bin": "another model"})


def test_files_that_come_meanwhile_are_kept(
    path: Path, exchanged: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another program makes, replaces and removes files after they were linked."""
    real = replacement._exchange

    def busy(first: Path, second: Path) -> None:
        write_tree(path, {"images/b.jpg": "new", "notes/a": "new", "changed": "new"})
        (path / "changed").replace(path / "project.ini")
        real(first, second)

    monkeypatch.setattr(replacement, "_exchange", busy)
    replace(path)
    assert exchanged
    assert_replaced(path, {"images/b.jpg": "new", "notes/a": "new", "project.ini": "new"})


def test_a_latecomer_that_cannot_be_moved_is_not_removed(
    path: Path, exchanged: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    real = replacement._exchange

    def busy(first: Path, second: Path) -> None:
        write_tree(path, {"late": "late"})
        real(first, second)

    def refuse(*_: object) -> None:
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as patch:
        patch.setattr(replacement, "_exchange", busy)
        patch.setattr(os, "replace", refuse)
        replace(path)
    assert exchanged
    for _ in range(2):  # the next run does not remove it either
        assert {k: v for k, v in tree(path.parent).items() if k.startswith("model/")} == {
            f"model/{k}": v for k, v in (NEW_MODEL | FOREIGN).items()
        }
        assert "late" in tree(path.parent).values()
        replace(path)


@pytest.mark.parametrize("error", [PermissionError(1, "no"), OSError(18, "no")])
def test_where_links_fail_files_are_replaced_one_by_one(
    path: Path, monkeypatch: pytest.MonkeyPatch, error: OSError
) -> None:
    calls = 0

    def refuse(*_: object, **__: object) -> None:
        nonlocal calls
        calls += 1
        raise error

    monkeypatch.setattr(os, "link", refuse)
    inode = path.stat().st_ino
    replace(path)
    assert calls == 1
    assert path.stat().st_ino == inode
    assert_replaced(path)


def test_the_temporary_of_another_process_stays_where_it_is(path: Path) -> None:
    """A folder in which another process is at work is not exchanged under its feet."""
    inode = path.stat().st_ino
    with temporary_folder(path) as other:
        replace(path)
        assert path.stat().st_ino == inode
        assert other.path.is_dir()
    assert_replaced(path)


def test_too_many_files_are_not_linked(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    inode = path.stat().st_ino
    monkeypatch.setattr(replacement, "MAX_LINKS", 4)  # three files and a folder
    replace(path)
    assert path.stat().st_ino != inode
    monkeypatch.setattr(replacement, "MAX_LINKS", 3)
    inode = path.stat().st_ino
    replace(path)
    assert path.stat().st_ino == inode
    assert_replaced(path)


def test_what_is_not_exchanged(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert replacement.can_exchange(path)
    for inside in (path, path / "images"):
        with monkeypatch.context() as patch:
            patch.chdir(inside)
            assert not replacement.can_exchange(path)
            inode = path.stat().st_ino
            replace(path)
            assert path.stat().st_ino == inode
            assert_replaced(path)
            assert list(Path().iterdir())
    for mounted in (path, path / "images"):
        with monkeypatch.context() as patch:
            patch.setattr(replacement, "mount_points", lambda point=mounted: frozenset({point}))
            assert not replacement.can_exchange(path)
    with monkeypatch.context() as patch:
        patch.setattr(os, "access", lambda name, _: Path(name) != path.parent)
        assert not replacement.can_exchange(path)
    assert not replacement.can_exchange(Path("/"))
