"""Names of the images of a model on the disk, read without keypoints and points."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from bundle.errors import InputError, shown
from bundle.io.atomic.model_files import is_text_model
from bundle.io.formats.read_options import ReadOptions
from bundle.io.formats.registry import file_at
from bundle.io.recognition import imported_format

_HEAD = struct.Struct("<I7dI")  # id, pose, camera
_COUNT = struct.Struct("<Q")
_KEYPOINT = 24  # bytes: x, y, point


def has_same_images(path: Path, names: Sequence[str]) -> bool:
    """Return True if a model on the disk has images with exactly these names.

    Only the number of images is compared if names are empty, and for BAL files, which have no
    names.

    Raises:
        InputError, OSError: the model cannot be read.
    """
    imported = imported_format(path, others=False)
    if imported is not None:
        problem = imported.reading().read(file_at(path, imported), ReadOptions(image_size=(0, 0)))
        return _same(list(problem.image_names), names)
    if path.is_file():
        return _bal_images(path) == len(names)
    found = list(_text_names(path) if is_text_model(path) else _binary_names(path))
    return _same(found, names)


def _same(found: list[str], names: Sequence[str]) -> bool:
    if all(names) and all(found):
        return Counter(found) == Counter(names)
    return len(found) == len(names)


def _binary_names(folder: Path) -> Iterator[str]:
    path = folder / "images.bin"
    data = path.read_bytes()
    try:
        place = _COUNT.size
        for _ in range(_COUNT.unpack_from(data)[0]):
            begin = place + _HEAD.size
            end = data.index(b"\0", begin)
            yield data[begin:end].decode(errors="surrogateescape")
            place = end + 1 + _COUNT.size + _KEYPOINT * _COUNT.unpack_from(data, end + 1)[0]
    except (struct.error, ValueError):
        raise InputError(f"{shown(path)}: expected images, found the end of the file") from None


def _text_names(folder: Path) -> Iterator[str]:
    is_image = True
    with (folder / "images.txt").open(encoding="utf-8", errors="surrogateescape") as lines:
        for line in lines:
            if line.startswith("#"):
                continue
            if is_image:
                words = line.strip().split(" ", 9)
                if len(words) < 10:
                    continue
                yield words[9]
            is_image = not is_image


def _bal_images(path: Path) -> int:
    with path.open("rb") as file:
        start = file.read(64)
        file.seek(0)
        if start.startswith(b"\x1f\x8b"):
            import gzip  # late: models need no compressors

            start = gzip.GzipFile(fileobj=file).read(64)
        elif start.startswith(b"BZh"):
            import bz2

            start = bz2.BZ2File(file).read(64)
    try:
        return int(start.split()[0])
    except (IndexError, ValueError):
        raise InputError(
            f"{shown(path)}: expected a BAL file, which begins with counts, found other content"
        ) from None
