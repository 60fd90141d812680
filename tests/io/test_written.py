"""A disk that is full is called so, also where COLMAP writes the files."""

import errno
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

import bundle
from bundle.io.colmap import written
from tests.io.trees import tree
from tests.scenes import make_problem, scene


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 256 kB; skips where none may be mounted."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(disk)]
    try:
        subprocess.run(mount, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("may not mount a file system")
    yield disk
    subprocess.run(["umount", "-l", str(disk)], check=True)


@pytest.mark.parametrize("exists", [True, False])
@pytest.mark.parametrize("format", ["colmap", "colmap-text", "bal"])
def test_a_full_disk_is_in_the_message_and_the_old_stays(
    small_disk: Path, format: str, exists: bool
) -> None:
    path = small_disk / "out"
    if exists:
        bundle.save(scene(), path, format)
    before = snapshot(small_disk)
    with pytest.raises(OSError, match="No space left on device") as error:
        bundle.save(scene(20, 5000), path, format)
    assert error.value.errno == errno.ENOSPC
    assert error.value.filename == str(path)
    assert len(str(error.value).splitlines()) == 1
    assert snapshot(small_disk) == before
    if exists:
        assert bundle.load(path).num_points == 30


def snapshot(folder: Path) -> dict[str, bytes]:
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def test_text_that_is_cut_anywhere_is_noticed(tmp_path: Path) -> None:
    """Also at the end of a line, and within its last number."""
    bundle.save(make_problem(num_images=3, num_points=5), tmp_path / "whole", "colmap-text")
    assert written.check_text_files(tmp_path / "whole") is None
    cut = tmp_path / "cut"
    for path in sorted((tmp_path / "whole").iterdir()):
        text = path.read_bytes()
        shutil.copytree(tmp_path / "whole", cut, dirs_exist_ok=True)
        for length in range(0, len(text), 7 if len(text) > 2000 else 1):
            (cut / path.name).write_bytes(text[:length])
            assert str(written.check_text_files(cut)).startswith(path.name)
    assert len(tree(cut)) == 5


def test_what_is_not_explained_is_an_input_output_error(tmp_path: Path) -> None:
    (tmp_path / "cameras.bin").write_bytes(b"half")
    error = written.failure(tmp_path, "not written whole: cameras.bin")
    assert (error.errno, error.filename) == (errno.EIO, str(tmp_path))
    assert "cameras.bin" in str(error)
