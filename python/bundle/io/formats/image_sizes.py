"""Sizes of photographs, for formats that do not store them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bundle.base.optional_packages import allow_heic
from bundle.errors import InputError, shown
from bundle.io.database_images import database_sizes
from bundle.io.formats.read_options import UNKNOWN, ReadOptions

HINT = f"give --image-size W,H, or --image-size {UNKNOWN}"
UNKNOWN_SIZES = (
    "Image sizes are unknown: positions are relative to the principal point. "
    "--image-size W,H gives them."
)


def image_sizes(
    names: Sequence[str], folders: Sequence[Path], options: ReadOptions, place: str
) -> NDArray[np.int64]:
    """Return (num_images, 2) width and height in pixels; 0 if unknown.

    Args:
        names: paths of the photographs; empty for an image without a name.
        folders: folders that relative paths may start from.
        options: sizes from the user.
        place: file with the names, for messages.

    Raises:
        InputError: a photograph is missing or is not a picture, and no size was given; or the
            database has no such image.
    """
    if isinstance(options.image_size, Path):
        return database_sizes(options.image_size, names)
    sizes = np.zeros((len(names), 2), np.int64)
    if options.image_size is not None:
        sizes[:] = options.image_size
        return sizes
    for index, name in enumerate(names):
        if not name:
            continue
        found = next((folder / name for folder in folders if (folder / name).is_file()), None)
        if found is None:
            raise InputError(
                f"{place}: expected photographs, which have the image sizes, found no file "
                f"{shown(name)}; {HINT}"
            )
        sizes[index] = _size(found)
    return sizes


def _size(path: Path) -> tuple[int, int]:
    from PIL import Image, UnidentifiedImageError  # late: most inputs have sizes

    allow_heic(path)
    try:
        with Image.open(path) as picture:
            return picture.size
    except (UnidentifiedImageError, OSError, ValueError, Image.DecompressionBombError):
        raise InputError(
            f"{shown(path)}: expected a photograph, which has the image size, found another file; "
            f"{HINT}"
        ) from None
