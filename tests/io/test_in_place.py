"""Where folders cannot be exchanged: files change places one by one, and a trace tells how far."""

import os
from pathlib import Path

import pytest

import bundle
from bundle.io.atomic import atomic_write as atomic
from bundle.io.atomic import replacement
from bundle.io.atomic.temporary import temporaries_in
from tests.io.trees import FOREIGN, NEW_MODEL, OLD_MODEL, tree, write_tree
from tests.scenes import scene

SAME_FORMAT = {name: content.upper() for name, content in OLD_MODEL.items()} | {"frames.txt": "F"}


@pytest.fixture(autouse=True, params=["inside", "beside"])
def no_exchange(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Do not even try to replacement, or notice at the last moment that the kernel cannot."""
    if request.param == "inside":
        monkeypatch.setattr(replacement, "can_exchange", lambda _: False)
    else:
        monkeypatch.setattr(replacement, "_renameat2", lambda: None)


class Interruption(BaseException):
    """Like KeyboardInterrupt, which pytest would take personally."""


def replace(path: Path, new: dict[str, str]) -> None:
    with atomic.replace_folder(path) as temporary:
        write_tree(temporary, new)


@pytest.mark.parametrize("new", [NEW_MODEL, SAME_FORMAT])
def test_replaced_and_nothing_left(tmp_path: Path, new: dict[str, str]) -> None:
    path = write_tree(tmp_path / "model", OLD_MODEL | FOREIGN)
    inode = path.stat().st_ino
    replace(path, new)
    assert tree(tmp_path) == {f"model/{k}": v for k, v in (new | FOREIGN).items()}
    assert path.stat().st_ino == inode


@pytest.mark.parametrize("new", [NEW_MODEL, SAME_FORMAT])
@pytest.mark.parametrize("after", [False, True])
def test_rolled_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, new: dict[str, str], after: bool
) -> None:
    """Each rename in turn fails, or is interrupted right after it has happened."""
    path = write_tree(tmp_path / "model", OLD_MODEL | FOREIGN)
    rename = os.rename
    for failing in range(len(OLD_MODEL) + len(new) + 2):
        calls = 0

        def fail_once(source: Path, target: Path, failing: int = failing) -> None:
            nonlocal calls
            if not target.parent.samefile(path) or target.name in OLD_MODEL | new:
                calls += 1
                if calls - 1 == failing:
                    if after:
                        rename(source, target)
                    raise Interruption
            rename(source, target)

        with monkeypatch.context() as patch:
            patch.setattr(os, "rename", fail_once)
            with pytest.raises(Interruption):
                replace(path, new)
        assert tree(tmp_path) == {f"model/{k}": v for k, v in (OLD_MODEL | FOREIGN).items()}
    replace(path, new)
    assert tree(tmp_path) == {f"model/{k}": v for k, v in (new | FOREIGN).items()}


def test_a_trace_is_kept_when_rolling_back_fails_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_tree(tmp_path / "model", OLD_MODEL)
    rename = os.rename

    def fail_from_the_third(source: Path, target: Path) -> None:
        if len(list(path.glob("*.txt"))) <= 2:
            raise OSError(5, "Input/output error")
        rename(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(os, "rename", fail_from_the_third)
        with pytest.raises(OSError, match="Input/output error"):
            replace(path, SAME_FORMAT)
        left = [(Path(name).name, content) for name, content in tree(path).items()]
        assert {*OLD_MODEL.items(), *SAME_FORMAT.items()} <= set(left)
        with pytest.raises(bundle.InputError, match=r"killed run .*\(Input/output error\).*/old"):
            atomic.recover(path)
    assert len(atomic.recover(path)) == 1
    assert tree(tmp_path) == {f"model/{k}": v for k, v in SAME_FORMAT.items()}
    assert atomic.recover(path) == ()


@pytest.mark.parametrize("what", ["load", "save", "check_target"])
def test_what_reads_or_writes_recovers_and_says_so(tmp_path: Path, what: str) -> None:
    problem, path = scene(kind="colmap"), tmp_path / "model"
    bundle.save(problem, path)
    half_replaced(path)
    with pytest.warns(UserWarning, match=f"^{path}: finished the replacement"):
        bundle.load(path) if what == "load" else getattr(bundle.io.open, what)(problem, path)
    assert not temporaries_in(path)
    assert bundle.load(path).num_points == problem.num_points


def half_replaced(path: Path) -> None:
    """Leftovers of a process that was killed between two renames."""
    temporary = path / ".bundle-0123456789ab.tmp"
    (temporary / "entering").mkdir(parents=True)
    (temporary / "old").mkdir()
    (path / "cameras.bin").rename(temporary / "entering" / "cameras.bin")
    (path / "rigs.bin").rename(temporary / "entering" / "rigs.bin")


def test_a_running_process_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_tree(tmp_path / "model", OLD_MODEL)
    monkeypatch.setattr(replacement, "PATIENCE", 0.05)
    finish = replacement._finish

    def look(target: Path, folder: Path, done: list) -> None:
        assert atomic.recover(target) == ()
        finish(target, folder, done)

    monkeypatch.setattr(replacement, "_finish", look)
    replace(path, NEW_MODEL)
    assert tree(path) == NEW_MODEL
