"""Information on a file that the file itself does not have: options, and sizes of photographs."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.optional_packages import allow_heic
from bundle.base.paths import as_path
from bundle.base.records import dataclass
from bundle.errors import InputError, brief, shown
from bundle.interface.option_fields import choice
from bundle.io.database_images import database_sizes, is_database

UNKNOWN = "unknown"
ORIGINS = ("center", "corner")


@dataclass(frozen=True, kw_only=True)
class ReadOptions:
    """Values that a reader uses in addition to the file."""

    format: str | None = None  # name of the format; None: detected from the content
    # width and height of all images in pixels; (0, 0): unknown; a path: COLMAP's database, which
    # has them by name; None: those of the photographs
    image_size: tuple[int, int] | Path | None = None
    # file with the names of the images of a Bundler model; None: list.txt in its folder or in the
    # folder above
    image_list: Path | None = None
    # number of the reconstruction in a file with several, from 0; None: the only one
    reconstruction: int | None = None
    # origin of the pixels of an NVM file: "center" of the image, as VisualSFM has it, or the upper
    # left "corner", as COLMAP writes it
    pixel_origin: str = ORIGINS[0]
    # function that is called repeatedly with the bytes of text read so far
    progress: Callable[[int], None] | None = None

    def changed(self) -> bool:
        """Return True if a value other than ``progress`` was given."""
        return dataclasses.replace(self, progress=None) != ReadOptions()

    @staticmethod
    def of(
        format: str | None = None,
        image_size: Any = None,
        image_list: str | os.PathLike[str] | None = None,
        reconstruction: Any = None,
        pixel_origin: Any = ORIGINS[0],
        progress: Callable[[int], None] | None = None,
    ) -> ReadOptions:
        """Check values from users.

        ``image_size`` may be "W,H", "unknown", two numbers, or the path of COLMAP's database.
        """
        if reconstruction is not None and (
            isinstance(reconstruction, bool) or not isinstance(reconstruction, int)
        ):
            raise InputError(
                f"reconstruction: expected a whole number, found {brief(reconstruction)}"
            )
        return ReadOptions(
            format=format,
            image_size=None if image_size is None else _size(image_size),
            image_list=None if image_list is None else as_path(image_list, "image_list"),
            reconstruction=reconstruction,
            pixel_origin=choice("pixel_origin", pixel_origin, ORIGINS),
            progress=progress,
        )


def _size(given: Any) -> tuple[int, int] | Path:
    if given == UNKNOWN:
        return 0, 0
    if isinstance(given, str | os.PathLike) and is_database(Path(given)):
        return Path(given)
    words = re.split(r"[,x ]+", given.strip()) if isinstance(given, str) else given
    try:
        width, height = (int(word) for word in words)
    except (TypeError, ValueError):
        width = height = 0
    if not (0 < width < 2**31 and 0 < height < 2**31):
        raise InputError(
            f'image_size: expected width,height in pixels or "{UNKNOWN}", or COLMAP\'s database, '
            f"found {brief(given)}"
        )
    return width, height


HINT = f"give --image-size W,H, or --image-size {UNKNOWN}"
UNKNOWN_SIZES = (
    "Image sizes are unknown: positions are relative to the principal point. "
    "--image-size W,H gives them."
)


def image_sizes(
    names: Sequence[str], folders: Sequence[Path], options: ReadOptions, place: str
) -> NDArray[np.int64]:
    """Return (num_images, 2) width and height in pixels; 0 if unknown.

    ``names``: paths of the photographs; empty for an image without a name.
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
        sizes[index] = _size_of(found)
    return sizes


def _size_of(path: Path) -> tuple[int, int]:
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
