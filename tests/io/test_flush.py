"""A folder and its files are on the disk, or an error says which is not."""

import errno
import os
import threading
from pathlib import Path

import pytest

from bundle.io.atomic import atomic_write as atomic
from bundle.io.atomic import replacement
from bundle.io.atomic.temporary import flush_with_files
from tests.io.trees import NEW_MODEL, OLD_MODEL, tree, write_tree

FILES = sorted(NEW_MODEL)
ALL = sorted([*FILES, "model"])


def names(folder: Path) -> dict[int, str]:
    """Return the names of a folder and of the files in it by inode."""
    return {file.stat().st_ino: file.name for file in (folder, *folder.iterdir())}


def failing(name: str | None, flushed: list[str], known: dict[int, str]):
    """Return an fsync that notes what it flushes and refuses one name."""

    def fsync(descriptor: int) -> None:
        found = known[os.fstat(descriptor).st_ino]
        flushed.append(found)
        if found == name:
            raise OSError(errno.EIO, f"cannot flush {found}")

    return fsync


@pytest.fixture
def model(tmp_path: Path) -> Path:
    return write_tree(tmp_path / "model", NEW_MODEL)


def test_everything_is_flushed_at_the_same_time(model, monkeypatch):
    together = threading.Barrier(len(NEW_MODEL) + 1, timeout=30)
    flushed: list[str] = []
    note = failing(None, flushed, names(model))

    def fsync(descriptor: int) -> None:
        together.wait()  # breaks if one flush waits for another
        note(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    flush_with_files(model)
    assert sorted(flushed) == ALL


def test_without_threads_everything_is_flushed(model, monkeypatch):
    def start(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", start)
    flushed: list[str] = []
    monkeypatch.setattr(os, "fsync", failing(None, flushed, names(model)))
    flush_with_files(model)
    assert sorted(flushed) == ALL
    monkeypatch.setattr(os, "fsync", failing("images.bin", [], names(model)))
    with pytest.raises(OSError, match=r"cannot flush images\.bin"):
        flush_with_files(model)


def test_the_first_failure_by_name_is_raised_after_all_were_tried(model, monkeypatch):
    flushed: list[str] = []
    known = names(model)

    def fsync(descriptor: int) -> None:
        name = known[os.fstat(descriptor).st_ino]
        failing(name, flushed, known)(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(OSError, match=rf"cannot flush {FILES[0]}"):
        flush_with_files(model)
    assert sorted(flushed) == ALL


def test_a_folder_that_cannot_be_flushed_is_no_error(model, monkeypatch):
    monkeypatch.setattr(os, "fsync", failing("model", [], names(model)))
    flush_with_files(model)


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("exists", [False, True])
def test_a_failure_of_any_file_leaves_what_was_there(tmp_path, monkeypatch, name, exists):
    before = write_tree(tmp_path, {f"model/{k}": v for k, v in OLD_MODEL.items()} if exists else {})
    old = tree(before)
    with (
        pytest.raises(OSError, match=r"cannot flush .*/model'"),
        atomic.replace_folder(tmp_path / "model") as temporary,
    ):
        write_tree(temporary, NEW_MODEL)
        monkeypatch.setattr(os, "fsync", failing(name, [], names(temporary)))
    assert tree(tmp_path) == old


def test_the_folder_moves_when_all_of_it_is_on_the_disk(tmp_path, monkeypatch):
    events: list[str] = []
    move, fsync = replacement.move_new_folder, os.fsync

    def slow(descriptor: int) -> None:
        fsync(descriptor)
        if threading.current_thread() is not threading.main_thread():
            threading.Event().wait(0.2)  # those that the main thread has to wait for
        events.append("flushed")

    def moved(new: Path, target: Path) -> bool:
        events.append("moved")
        return move(new, target)

    monkeypatch.setattr(os, "fsync", slow)
    monkeypatch.setattr(replacement, "move_new_folder", moved)
    with atomic.replace_folder(tmp_path / "model") as temporary:
        write_tree(temporary, NEW_MODEL)
    assert events == ["flushed"] * (len(NEW_MODEL) + 1) + ["moved", "flushed"]
