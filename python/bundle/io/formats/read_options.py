"""Information on a file that the file itself does not have."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bundle.base.paths import as_path
from bundle.base.records import dataclass
from bundle.errors import InputError, brief
from bundle.interface.option_fields import choice
from bundle.io.database_images import is_database

UNKNOWN = "unknown"
ORIGINS = ("center", "corner")


@dataclass(frozen=True, kw_only=True)
class ReadOptions:
    """Values that a reader uses in addition to the file.

    Attributes:
        format: name of the format; None: detected from the content.
        image_size: width and height of all images in pixels; (0, 0): unknown; a path: COLMAP's
            database, which has them by name; None: those of the photographs.
        image_list: file with the names of the images of a Bundler model; None: list.txt in its
            folder or in the folder above.
        reconstruction: number of the reconstruction in a file with several, from 0; None: the only
            one.
        pixel_origin: origin of the pixels of an NVM file: "center" of the image, as VisualSFM has
            it, or the upper left "corner", as COLMAP writes it.
        progress: function that is called repeatedly with the bytes of text read so far.
    """

    format: str | None = None
    image_size: tuple[int, int] | Path | None = None
    image_list: Path | None = None
    reconstruction: int | None = None
    pixel_origin: str = ORIGINS[0]
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

        Raises:
            InputError: a value is invalid; the message names it.
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
