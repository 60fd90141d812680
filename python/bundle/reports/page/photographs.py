"""Photographs as small pictures of the page."""

from __future__ import annotations

import base64
import io
import os
import warnings
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

__all__ = ["Photograph", "photograph"]

WIDEST = 520
QUALITY = 72


@dataclass(frozen=True)
class Photograph:
    """A photograph, made small.

    Attributes:
        address: data: URI.
        size: (2,) width and height of the file [pixels], before it was made small.
    """

    address: str
    size: tuple[int, int]


def photograph(folder: str | os.PathLike[str], name: str) -> Photograph | None:
    """Return the photograph of an image; None where there is none that can be read.

    Pixels are taken as they are stored, whatever EXIF says of the orientation: that is how
    reconstructions count them.

    Args:
        folder: of the photographs.
        name: of the image, a path from the folder on; where there is no such file, one of that name
            directly in the folder is taken. A path that leaves the folder is none.
    """
    from PIL import Image

    relative = PurePosixPath(name)
    if not name or relative.is_absolute() or ".." in relative.parts:
        return None
    root = Path(folder)
    path = next((p for p in (root / relative, root / relative.name) if p.is_file()), None)
    if path is None:
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(path) as image:
                size = image.size
                image.draft("RGB", (WIDEST, WIDEST))
                small = image.convert("RGB")
                small.thumbnail((WIDEST, WIDEST))
    except Exception:  # whatever broken files make of it: they have no picture
        return None
    data = io.BytesIO()
    small.save(data, "JPEG", quality=QUALITY)
    coded = base64.b64encode(data.getvalue()).decode("ascii")
    return Photograph(f"data:image/jpeg;base64,{coded}", size)
