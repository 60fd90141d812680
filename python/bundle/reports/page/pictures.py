"""Pictures that stand in the page itself: arrays as PNG, photographs as small JPEG."""

from __future__ import annotations

import base64
import io
import os
import struct
import warnings
import zlib
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

__all__ = ["Photograph", "data_uri", "photograph", "png"]

WIDEST = 520
QUALITY = 72


def png(rgba: NDArray[np.uint8]) -> bytes:
    """Return a (height, width, 4) image as PNG (ISO 15948): 8 bits a channel, unfiltered rows."""
    height, width = rgba.shape[:2]
    rows = np.zeros((height, 1 + 4 * width), np.uint8)  # the first byte says: no filter
    rows[:, 1:] = rgba.reshape(height, 4 * width)
    header = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    parts = [(b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes(), 9)), (b"IEND", b"")]
    chunks = (
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        for name, body in parts
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def data_uri(rgba: NDArray[np.uint8]) -> str:
    """Return the image as the address of itself."""
    return "data:image/png;base64," + base64.b64encode(png(rgba)).decode("ascii")


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
