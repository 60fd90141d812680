"""Whatever goes wrong while writing, what stood there before is still there, whole."""

import os
import resource
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import bundle
from bundle.io import atomic
from tests.io.bal_files import bal_text, load_bytes, make_bal

OLD_MODEL = {"cameras.txt": "c", "images.txt": "i", "points3D.txt": "p", "rigs.txt": "r"}
FOREIGN = {"project.ini": "ini", "points3D.ply": "ply", "images/a.jpg": "jpg"}
NEW_MODEL = {"cameras.bin": "C", "images.bin": "I", "points3D.bin": "P", "frames.bin": "F"}


def write_tree(folder: Path, files: dict[str, str]) -> Path:
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content)
    return folder


def tree(folder: Path) -> dict[str, str]:
    """Every file below the folder, hidden and temporary ones too."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {str(path.relative_to(folder)): path.read_text() for path in files}


@contextmanager
def file_size_limit(size: int) -> Iterator[None]:
    """Let the system refuse to let files grow, as a full disk does (EFBIG for ENOSPC)."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


class Interruption(BaseException):
    """Like KeyboardInterrupt, which pytest would take personally."""


def test_file_appears_or_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "out.txt"
    for content in ("first", "second"):
        with atomic.replace_file(path) as temporary:
            temporary.write_text(content)
            assert tree(tmp_path).get("out.txt") != content
        assert tree(tmp_path) == {"out.txt": content}


def test_mode_is_the_users_and_stays(tmp_path: Path) -> None:
    path = tmp_path / "out.txt"
    previous = os.umask(0o027)
    try:
        with atomic.replace_file(path):
            pass
    finally:
        os.umask(previous)
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    path.chmod(0o604)
    with atomic.replace_file(path):
        pass
    assert stat.S_IMODE(path.stat().st_mode) == 0o604


@pytest.mark.parametrize("error", [ValueError, OSError, Interruption])
@pytest.mark.parametrize("before", [{}, {"out.txt": "old"}])
def test_file_stays_when_the_writer_fails(tmp_path: Path, error, before: dict[str, str]) -> None:
    write_tree(tmp_path, before)
    with pytest.raises(error), atomic.replace_file(tmp_path / "out.txt") as temporary:
        temporary.write_text("half")
        raise error("no")
    assert tree(tmp_path) == before


@pytest.mark.parametrize("suffix", [".txt", ".txt.gz", ".txt.bz2"])
def test_a_disk_that_fills_is_noticed(tmp_path: Path, suffix: str) -> None:
    problem = load_bytes(tmp_path, bal_text(*make_bal(1, num_points=20_000)), "in")
    out = tmp_path / "out"
    path = write_tree(out, {f"problem{suffix}": "old"}) / f"problem{suffix}"
    with file_size_limit(300_000), pytest.raises(OSError, match="File too large") as error:
        bundle.save(problem, path)
    assert error.value.filename == str(path)
    assert len(str(error.value).splitlines()) == 1
    assert tree(out) == {path.name: "old"}
    bundle.save(problem, path)
    assert bundle.load(path).num_points == 20_000


def test_a_flush_that_fails_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_space(_: int) -> None:
        raise OSError(28, "No space left on device")

    write_tree(tmp_path, {"out.txt": "old", **{f"model/{k}": v for k, v in OLD_MODEL.items()}})
    before = tree(tmp_path)
    monkeypatch.setattr(os, "fsync", no_space)
    with (
        pytest.raises(OSError, match=r"No space left on device: .*/out\.txt'"),
        atomic.replace_file(tmp_path / "out.txt") as temporary,
    ):
        temporary.write_text("new")
    with (
        pytest.raises(OSError, match=r"No space left on device: .*/model'"),
        atomic.replace_folder(tmp_path / "model") as temporary,
    ):
        write_tree(temporary, NEW_MODEL)
    assert tree(tmp_path) == before


@pytest.mark.parametrize("exists", [False, True])
def test_folder_appears(tmp_path: Path, exists: bool) -> None:
    path = tmp_path / "model"
    if exists:
        path.mkdir()
    with atomic.replace_folder(path) as temporary:
        write_tree(temporary, NEW_MODEL)
    assert tree(tmp_path) == {f"model/{name}": content for name, content in NEW_MODEL.items()}


def test_folder_in_place_keeps_what_is_no_model(tmp_path: Path) -> None:
    path = write_tree(tmp_path, OLD_MODEL | FOREIGN)
    with atomic.replace_folder(path) as temporary:
        write_tree(temporary, NEW_MODEL)
        assert {k: v for k, v in tree(path).items() if "/new/" not in k} == OLD_MODEL | FOREIGN
    assert tree(path) == NEW_MODEL | FOREIGN
    assert {child.name for child in path.iterdir()} == {*NEW_MODEL, *map(_top, FOREIGN)}


def _top(name: str) -> str:
    return name.split("/")[0]


@pytest.mark.parametrize("error", [ValueError, OSError, Interruption])
@pytest.mark.parametrize("before", [{}, OLD_MODEL | FOREIGN])
def test_folder_stays_when_the_writer_fails(tmp_path: Path, error, before: dict[str, str]) -> None:
    write_tree(tmp_path / "model", before)
    with pytest.raises(error), atomic.replace_folder(tmp_path / "model") as temporary:
        (temporary / "cameras.bin").write_text("half")
        raise error("no")
    assert tree(tmp_path / "model") == before
    assert all(child.name == "model" for child in tmp_path.iterdir())


@pytest.mark.parametrize("after", [False, True])
@pytest.mark.parametrize("failing", range(8))
def test_folder_is_rolled_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: int, after: bool
) -> None:
    """Each rename in turn fails, or is interrupted right after it has happened."""
    path = write_tree(tmp_path / "model", OLD_MODEL | FOREIGN)
    rename = Path.rename
    calls = 0

    def fail_once(self: Path, target: Path) -> Path:
        nonlocal calls
        calls += 1
        if calls - 1 != failing:
            return rename(self, target)
        if after:
            rename(self, target)
        raise Interruption

    monkeypatch.setattr(Path, "rename", fail_once)
    with pytest.raises(Interruption), atomic.replace_folder(path) as temporary:
        write_tree(temporary, NEW_MODEL)
    assert tree(tmp_path) == {f"model/{k}": v for k, v in (OLD_MODEL | FOREIGN).items()}


def test_the_only_copies_are_kept_when_rolling_back_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_tree(tmp_path / "model", OLD_MODEL)
    rename = Path.rename

    def fail_from_the_third(self: Path, target: Path) -> Path:
        if len(list(path.glob("*.txt"))) <= 2:
            raise OSError(5, "Input/output error")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", fail_from_the_third)
    with pytest.raises(OSError, match="Input/output error"), atomic.replace_folder(path) as new:
        write_tree(new, NEW_MODEL)
    left = {Path(name).name: content for name, content in tree(path).items()}
    assert OLD_MODEL.items() <= left.items()


def test_links_stay_links(tmp_path: Path) -> None:
    write_tree(
        tmp_path, {"real/out.txt": "old", **{f"real/model/{k}": v for k, v in OLD_MODEL.items()}}
    )
    (tmp_path / "link.txt").symlink_to("real/out.txt")
    (tmp_path / "link").symlink_to("real/model")
    with atomic.replace_file(tmp_path / "link.txt") as temporary:
        temporary.write_text("new")
    with atomic.replace_folder(tmp_path / "link") as temporary:
        write_tree(temporary, NEW_MODEL)
    assert (tmp_path / "link.txt").is_symlink()
    assert (tmp_path / "real/out.txt").read_text() == "new"
    assert (tmp_path / "link").is_symlink()
    assert tree(tmp_path / "real/model") == NEW_MODEL


def test_files_that_are_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    for name, message in {
        "folder": "folder: expected a file or nothing, found a folder",
        "pipe": "pipe: expected a file or nothing, found a device or pipe",
        "missing/out.txt": "expected a folder .*/missing to write into, found none",
        "pipe/out.txt": "expected a folder .*/pipe to write into, found none",
    }.items():
        with pytest.raises(bundle.InputError, match=message):
            atomic.check_file(tmp_path / name)
        with pytest.raises(bundle.InputError, match=message), atomic.replace_file(tmp_path / name):
            pytest.fail("nothing may be written")
    with pytest.raises(bundle.InputError, match="/dev/null: expected a file or nothing"):
        atomic.check_file(Path("/dev/null"))


def test_folders_that_are_refused(tmp_path: Path) -> None:
    write_tree(tmp_path, {"file": "", "thesis/chapter1.tex": "", "half/cameras.bin": ""})
    for name, message in {
        "file": "file: expected a COLMAP model folder or nothing, found a file",
        "thesis": r"expected a COLMAP model, an empty folder or nothing, .*\(chapter1.tex\)",
        "half": r"expected a COLMAP model, an empty folder or nothing, .*\(cameras.bin\)",
        "missing/model": "expected a folder .*/missing to write into, found none",
    }.items():
        with pytest.raises(bundle.InputError, match=message):
            atomic.check_folder(tmp_path / name)
        with (
            pytest.raises(bundle.InputError, match=message),
            atomic.replace_folder(tmp_path / name),
        ):
            pytest.fail("nothing may be written")


@pytest.mark.parametrize("check", [atomic.check_file, atomic.check_folder])
def test_write_protection_is_respected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, check
) -> None:
    """os.access is replaced because tests may run as root, whom nothing stops."""
    monkeypatch.setattr(os, "access", lambda path, _: Path(path) != tmp_path)
    with pytest.raises(PermissionError, match="is not writable"):
        check(tmp_path / "out")
