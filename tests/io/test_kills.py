"""Killed at any moment, a writer leaves the old or the new, whole; the next one clears up."""

import random
from pathlib import Path

import pytest

from bundle.io.atomic import atomic_write as atomic
from bundle.io.atomic import replacement
from tests.io.kills import killed_before
from tests.io.trees import FOREIGN as BESIDE
from tests.io.trees import NEW_MODEL, OLD_MODEL, tree, write_tree

FOREIGN = BESIDE | {"backup/cameras.txt": "of another model"}
NEW = {"same": {k: v.upper() for k, v in OLD_MODEL.items() if k != "rigs.txt"}, "other": NEW_MODEL}


def replace(path: Path, new: dict[str, str]) -> None:
    with atomic.replace_folder(path) as temporary:
        write_tree(temporary, new)


@pytest.fixture(autouse=True)
def no_waiting_for_the_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.fsync", lambda _: None)


def without_temporaries(found: dict[str, str]) -> dict[str, str]:
    return {name: text for name, text in found.items() if not name.startswith(".bundle-")}


@pytest.mark.parametrize("new", NEW.values(), ids=NEW)
def test_folder_is_exchanged(tmp_path: Path, new: dict[str, str]) -> None:
    """Nobody needs to recover anything: what stands there is whole at every moment."""
    exchange_or_skip(tmp_path)
    old = write_tree(tmp_path / "model", OLD_MODEL | FOREIGN)
    seen = []
    for operation in range(300):
        if not killed_before(operation, lambda: replace(old, new)):
            break
        seen.append(tree(old))
        assert seen[-1] in (OLD_MODEL | FOREIGN, new | FOREIGN)
        replace(old, OLD_MODEL)
    assert seen[0] == OLD_MODEL | FOREIGN
    assert seen[-1] == new | FOREIGN
    assert operation > 30
    assert tree(tmp_path) == {f"model/{k}": v for k, v in (new | FOREIGN).items()}


def exchange_or_skip(folder: Path) -> None:
    for name in ("a", "b"):
        (folder / name).mkdir()
    try:
        replacement._exchange(folder / "a", folder / "b")
    except OSError as error:
        pytest.skip(f"cannot exchange here: {error}")
    for name in ("a", "b"):
        (folder / name).rmdir()


@pytest.mark.parametrize("new", NEW.values(), ids=NEW)
@pytest.mark.parametrize("beside", [False, True])
def test_folder_is_replaced_in_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, new: dict[str, str], beside: bool
) -> None:
    """The next run finishes the work, and says so exactly when there was any."""

    def refuse(*_: object) -> None:
        raise OSError(22, "Invalid argument")

    monkeypatch.setattr(replacement, "can_exchange", lambda _: beside)
    monkeypatch.setattr(replacement, "_exchange", refuse)
    path = write_tree(tmp_path / "model", OLD_MODEL | FOREIGN)
    recovered = 0
    for operation in range(300):
        if not killed_before(operation, lambda: replace(path, new)):
            break
        before = without_temporaries(tree(path))
        said = atomic.recover(path)
        after = without_temporaries(tree(path))
        assert after in (OLD_MODEL | FOREIGN, new | FOREIGN)
        if before not in (after, OLD_MODEL | FOREIGN):
            assert len(said) == 1
            recovered += 1
        replace(path, OLD_MODEL)
    assert recovered >= len(OLD_MODEL) + len(new) - 1
    assert tree(tmp_path) == {f"model/{k}": v for k, v in (new | FOREIGN).items()}


def test_killed_while_recovering(tmp_path: Path) -> None:
    """Recovery can itself be killed anywhere, and again."""
    draw = random.Random(5)
    kills = 0
    for repetition in range(4):
        path = tmp_path / f"{repetition}"
        write_tree(path, FOREIGN | {"rigs.txt": "r", "images.txt": "i"})
        trace = path / ".bundle-0123456789ab.tmp"
        write_tree(trace / "old", {"cameras.txt": "c", "points3D.txt": "p"})
        write_tree(trace / "whole", NEW_MODEL)
        while killed_before(draw.randrange(24), lambda path=path: atomic.recover(path)):
            kills += 1
        assert tree(path) == NEW_MODEL | FOREIGN
    assert kills > 4


@pytest.mark.parametrize("exists", [False, True])
def test_file(tmp_path: Path, exists: bool) -> None:
    path = tmp_path / "out.txt"
    old, new = ({"out.txt": "old"} if exists else {}), {"out.txt": "new"}
    write_tree(tmp_path, old)

    def replace_file() -> None:
        with atomic.replace_file(path) as temporary:
            temporary.write_text("new")

    for operation in range(50):
        if not killed_before(operation, replace_file):
            break
        assert without_temporaries(tree(tmp_path)) in (old, new)
        path.unlink(missing_ok=True)
        write_tree(tmp_path, old)
    assert operation > 4
    assert tree(tmp_path) == new
