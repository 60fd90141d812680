"""Errors of a full disk, and what stays on it."""

import errno
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

import bundle
from tests.scenes import scene


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
