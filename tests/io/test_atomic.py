"""Whatever goes wrong while writing, what stood there before is still there, whole."""

import os
import resource
import signal
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import bundle
from bundle.io.atomic import atomic_write as atomic
from bundle.io.atomic.replaced_paths import recording
from tests.io.bal_files import bal_text, load_bytes, make_bal
from tests.io.trees import FOREIGN, NEW_MODEL, OLD_MODEL, tree, write_tree


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
    previous = os.umask(0o077)
    try:
        with atomic.replace_file(path):
            pass
    finally:
        os.umask(previous)
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
    path = write_tree(tmp_path / "model", OLD_MODEL | FOREIGN)
    with atomic.replace_folder(path) as temporary:
        write_tree(temporary, NEW_MODEL)
        assert tree(path) == OLD_MODEL | FOREIGN
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
    (tmp_path / "file").touch()
    for name, message in {
        "folder": "folder: expected a file or a new path, found a folder",
        "pipe": "pipe: expected a file or a new path, found a device or pipe",
        "file/out.txt": "expected a folder .*/file to write into, found a file",
        "pipe/out.txt": "expected a folder .*/pipe to write into, found a file or pipe",
    }.items():
        with pytest.raises(bundle.InputError, match=message):
            atomic.check_file(tmp_path / name)
        with pytest.raises(bundle.InputError, match=message), atomic.replace_file(tmp_path / name):
            pytest.fail("nothing may be written")
    with pytest.raises(bundle.InputError, match="/dev/null: expected a file or a new path"):
        atomic.check_file(Path("/dev/null"))


def test_folders_that_are_refused(tmp_path: Path) -> None:
    write_tree(tmp_path, {"file": "", "thesis/chapter1.tex": "", "half/cameras.bin": ""})
    for name, message in {
        "file": "file: expected a COLMAP model folder or a new path, found a file",
        "thesis": r"expected a COLMAP model, an empty folder or a new path, .*\(chapter1.tex\)",
        "half": r"expected a COLMAP model, an empty folder or a new path, .*\(cameras.bin\)",
        "file/a/model": "expected a folder .*/file to write into, found a file",
    }.items():
        with pytest.raises(bundle.InputError, match=message):
            atomic.check_folder(tmp_path / name)
        with (
            pytest.raises(bundle.InputError, match=message),
            atomic.replace_folder(tmp_path / name),
        ):
            pytest.fail("nothing may be written")


def test_missing_folders_above_are_created_with_the_output_or_not_at_all(tmp_path: Path) -> None:
    with atomic.replace_file(tmp_path / "a/b/out.txt") as temporary:
        temporary.write_text("new")
    with atomic.replace_folder(tmp_path / "c/d/model") as temporary:
        write_tree(temporary, NEW_MODEL)
    assert (tmp_path / "a/b/out.txt").read_text() == "new"
    assert tree(tmp_path / "c/d/model") == NEW_MODEL
    before = tree(tmp_path)
    for replace in (atomic.replace_file, atomic.replace_folder):
        for place in ("e/f/g", "a/b/h/i", "c/d/j"):
            with pytest.raises(KeyboardInterrupt), replace(tmp_path / place):
                raise KeyboardInterrupt
    with pytest.raises(OSError, match="stop"), atomic.made_folder(tmp_path / "k/l"):
        raise OSError("stop")
    assert tree(tmp_path) == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "c"]
    assert sorted(path.name for path in (tmp_path / "a/b").iterdir()) == ["out.txt"]
    # What another process has put there meanwhile stays.
    with pytest.raises(OSError, match="stop"), atomic.made_folder(tmp_path / "k/l"):
        (tmp_path / "k/other").touch()
        raise OSError("stop")
    assert tree(tmp_path / "k") == {"other": ""}
    assert not (tmp_path / "k/l").exists()


@pytest.mark.parametrize("check", [atomic.check_file, atomic.check_folder])
def test_write_protection_is_respected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, check
) -> None:
    """os.access is replaced because tests may run as root, whom nothing stops."""
    monkeypatch.setattr(os, "access", lambda path, _: Path(path) != tmp_path)
    with pytest.raises(PermissionError, match="is not writable"):
        check(tmp_path / "out")
    with pytest.raises(PermissionError, match="is not writable"):
        check(tmp_path / "new/below/out")


def test_owner_and_permissions_stay(tmp_path: Path) -> None:
    path = write_tree(tmp_path / "model", OLD_MODEL | {"images/a.jpg": "jpg"})
    (path / "images").chmod(0o711)
    (path / "cameras.txt").chmod(0o604)
    path.chmod(0o2750)
    if os.geteuid() == 0:
        os.chown(path, 1234, 2345)
        os.chown(path / "cameras.txt", 1234, 2346)
    before = path.stat()
    with atomic.replace_folder(path) as temporary:
        write_tree(temporary, OLD_MODEL)
    after, file = path.stat(), (path / "cameras.txt").stat()
    assert stat.S_IMODE(after.st_mode) == 0o2750
    assert (after.st_uid, after.st_gid) == (before.st_uid, before.st_gid)
    assert stat.S_IMODE(file.st_mode) == 0o604
    assert stat.S_IMODE((path / "images").stat().st_mode) == 0o711
    if os.geteuid() == 0:
        assert (file.st_uid, file.st_gid) == (1234, 2346)
        assert (path / "rigs.txt").stat().st_gid == 0


def test_what_was_replaced_is_recorded_once_it_is(tmp_path: Path) -> None:
    with recording() as replaced:
        with atomic.replace_file(tmp_path / "a") as temporary:
            assert replaced == []
        assert replaced == [tmp_path / "a"]
        with pytest.raises(ValueError, match="no"), atomic.replace_folder(tmp_path / "b"):
            raise ValueError("no")
        with atomic.replace_folder(tmp_path / "b") as temporary:
            write_tree(temporary, NEW_MODEL)
    assert replaced == [tmp_path / "a", tmp_path / "b"]
    with atomic.replace_file(tmp_path / "a"):
        pass
    assert len(replaced) == 2


@pytest.mark.parametrize("replace", [atomic.replace_file, atomic.replace_folder])
def test_ctrl_c_during_the_replacement_waits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, replace
) -> None:
    real = os.rename, os.replace

    def interrupted(call):
        def rename(*arguments) -> None:
            os.kill(os.getpid(), signal.SIGINT)
            call(*arguments)

        return rename

    monkeypatch.setattr(os, "rename", interrupted(real[0]))
    monkeypatch.setattr(os, "replace", interrupted(real[1]))
    with (
        recording() as replaced,
        pytest.raises(KeyboardInterrupt),
        replace(tmp_path / "out") as temporary,
    ):
        pass
    assert replaced == [tmp_path / "out"]
    assert [child.name for child in tmp_path.iterdir()] == ["out"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert not temporary.exists()


def test_two_writers_of_one_folder(tmp_path: Path) -> None:
    """Each is whole when it comes; the last one wins, and nothing is left behind."""
    path = write_tree(tmp_path / "model", OLD_MODEL | FOREIGN)
    with atomic.replace_folder(path) as first:
        write_tree(first, OLD_MODEL | {"cameras.txt": "first"})
        with atomic.replace_folder(path) as second:
            write_tree(second, NEW_MODEL)
        assert tree(path) == NEW_MODEL | FOREIGN
        assert first.exists()
    assert tree(tmp_path) == {
        f"model/{k}": v for k, v in (OLD_MODEL | FOREIGN | {"cameras.txt": "first"}).items()
    }


def test_two_writers_of_one_new_folder(tmp_path: Path) -> None:
    path = tmp_path / "model"
    with atomic.replace_folder(path) as first:
        write_tree(first, OLD_MODEL)
        with atomic.replace_folder(path) as second:
            write_tree(second, NEW_MODEL)
    assert tree(tmp_path) == {f"model/{k}": v for k, v in OLD_MODEL.items()}


def test_a_folder_where_a_model_file_should_be_is_refused(tmp_path: Path) -> None:
    path = write_tree(tmp_path, OLD_MODEL | {"frames.bin/thesis.tex": ""})
    with pytest.raises(bundle.InputError, match=r"frames\.bin: expected a file of the model"):
        atomic.check_folder(path)


def test_a_mounted_file_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_tree(tmp_path, {"out.txt": "old"})
    monkeypatch.setattr(atomic, "mount_points", lambda: frozenset({tmp_path / "out.txt"}))
    with pytest.raises(bundle.InputError, match="mount point"):
        atomic.check_file(tmp_path / "out.txt")


def test_a_file_that_its_owner_may_only_write_is_replaced_and_stays_so(tmp_path):
    path = tmp_path / "file"
    path.write_text("old")
    path.chmod(0o200)
    with atomic.replace_file(path) as temporary:
        assert stat.S_IMODE(temporary.stat().st_mode) & 0o600 == 0o600
        temporary.write_text("new")
    assert stat.S_IMODE(path.stat().st_mode) == 0o200
    path.chmod(0o600)
    assert path.read_text() == "new"
