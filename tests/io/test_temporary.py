"""Leftovers of killed processes are removed, and nothing else."""

import os
import signal
from pathlib import Path

import pytest

from bundle.io.atomic import atomic_write as atomic
from bundle.io.atomic import temporary
from bundle.io.atomic.replaced_paths import mount_points
from tests.io.trees import FOREIGN, NEW_MODEL, OLD_MODEL, tree, write_tree


def killed(path: Path, replace) -> None:
    """Leave what a process leaves that is killed while it writes."""
    child = os.fork()
    if child == 0:
        with replace(path) as new:
            if new.is_dir():
                write_tree(new, NEW_MODEL)
            os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(child, 0)


@pytest.mark.parametrize("replace", [atomic.replace_file, atomic.replace_folder])
def test_the_next_run_removes_leftovers(tmp_path: Path, replace) -> None:
    killed(tmp_path / "out", replace)
    assert len(list(tmp_path.iterdir())) == 1
    with atomic.replace_file(tmp_path / "other"):
        pass
    assert [child.name for child in tmp_path.iterdir()] == ["other"]


@pytest.mark.parametrize("replace", [atomic.replace_file, atomic.replace_folder])
def test_a_running_process_keeps_its_temporary(tmp_path: Path, replace) -> None:
    with replace(tmp_path / "out") as mine:
        temporary.remove_leftovers(tmp_path)
        assert mine.exists()
    assert [child.name for child in tmp_path.iterdir()] == ["out"]


def test_a_folder_with_leftovers_only_counts_as_empty(tmp_path: Path) -> None:
    write_tree(tmp_path / "model", {".bundle-0123456789ab.tmp/new/cameras.bin": "half"})
    with atomic.replace_folder(tmp_path / "model") as new:
        write_tree(new, NEW_MODEL)
    assert tree(tmp_path / "model") == NEW_MODEL


@pytest.mark.parametrize(
    "kept",
    [
        ".bundle-0123456789ab.tmp/old/cameras.txt",  # what the only copy of a model looks like
        ".bundle-0123456789ab.tmp/whole/cameras.txt",
        ".bundle-0123456789ab.tmp/entering/cameras.txt",
        ".bundle-0123456789ab.tmp/new/notes.txt",
        ".bundle-0123456789ab.tmp/new/images/cameras.txt",
        ".bundle-0123456789ab.tmp/thesis.tex",
        ".bundle-0123456789ab.tmp.tex",
        ".bundle-012345.tmp",
    ],
)
def test_only_copies_stay(tmp_path: Path, kept: str) -> None:
    write_tree(tmp_path, {kept: "the only one"})
    temporary.remove_leftovers(tmp_path)
    assert tree(tmp_path) == {kept: "the only one"}


def test_links_in_leftovers_are_removed_and_not_followed(tmp_path: Path) -> None:
    write_tree(tmp_path, FOREIGN | OLD_MODEL)
    new = write_tree(tmp_path / ".bundle-0123456789ab.tmp" / "new", NEW_MODEL)
    (new / "project.ini").hardlink_to(tmp_path / "project.ini")
    (tmp_path / ".bundle-ffffffffffff.tmp").symlink_to(tmp_path / "images")
    temporary.remove_leftovers(tmp_path)
    assert not new.exists()
    (tmp_path / ".bundle-ffffffffffff.tmp").unlink()
    assert tree(tmp_path) == FOREIGN | OLD_MODEL


def test_without_locks_leftovers_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_locks(*_: object) -> None:
        raise OSError(37, "No locks available")

    monkeypatch.setattr("fcntl.flock", no_locks)
    killed(tmp_path / "out", atomic.replace_file)
    with atomic.replace_folder(tmp_path / "out") as new:
        write_tree(new, NEW_MODEL)
    with atomic.replace_folder(tmp_path / "out") as new:
        write_tree(new, OLD_MODEL)
    assert tree(tmp_path / "out") == OLD_MODEL
    assert len(list(tmp_path.iterdir())) == 2


def test_taken_for_a_leftover_before_it_was_locked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another process removes it between its making and its lock: a new one is made."""
    lock, removed = temporary.lock, []

    def late(descriptor: int, *, wait: bool = True) -> bool | None:
        if not removed:
            removed.extend(tmp_path.iterdir())
            removed[0].unlink()
        return lock(descriptor, wait=wait)

    monkeypatch.setattr(temporary, "lock", late)
    with atomic.replace_file(tmp_path / "out") as new:
        assert new != removed[0]
        new.write_text("new")
    assert tree(tmp_path) == {"out": "new"}


def test_mount_points() -> None:
    points = mount_points()
    assert not points or Path("/proc") in points  # "/" is none where the root was changed
