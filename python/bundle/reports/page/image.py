"""Images that stand in the page itself."""

from __future__ import annotations

import base64
import struct
import zlib

import numpy as np
from numpy.typing import NDArray

__all__ = ["data_uri", "png"]


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
