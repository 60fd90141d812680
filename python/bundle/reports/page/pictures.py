"""Pictures embedded in the page: arrays and matrices as PNG, photographs as small JPEG."""

from __future__ import annotations

import base64
import io
import os
import struct
import warnings
import zlib
from collections.abc import Mapping
from html import escape
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.base.optional_packages import allow_heic
from bundle.base.records import dataclass
from bundle.figures.matplotlib.matrix_pattern import (
    Density,
    MatrixPattern,
    factor_density,
    matrix_density,
)
from bundle.reports.page.page import tag

WIDEST = 520
QUALITY = 72


def png(rgba: NDArray[np.uint8]) -> bytes:
    """Return a (height, width, 4) image as PNG (ISO 15948): 8 bits a channel, unfiltered rows."""
    height, width = rgba.shape[:2]
    rows = np.zeros((height, 1 + 4 * width), np.uint8)  # first byte of a row: filter type 0
    rows[:, 1:] = rgba.reshape(height, 4 * width)
    header = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    parts = [(b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes(), 9)), (b"IEND", b"")]
    chunks = (
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        for name, body in parts
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def data_uri(rgba: NDArray[np.uint8]) -> str:
    """Return the image as a data URI."""
    return "data:image/png;base64," + base64.b64encode(png(rgba)).decode("ascii")


@dataclass(frozen=True)
class Photograph:
    """Photograph at reduced size, as a data: URI, with the original width and height [pixels]."""

    address: str
    size: tuple[int, int]


def photograph(
    folder: str | os.PathLike[str], name: str, widest: int = WIDEST
) -> Photograph | None:
    """Return the photograph of an image, up to ``widest`` pixels; None if none is readable.

    Without a file of this relative name, that of the same base name directly in the folder is used;
    paths that leave the folder are refused. Pixels keep their stored orientation, and the EXIF
    orientation is ignored: reconstructions use the coordinates of the stored pixels.
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
            allow_heic(path)
            with Image.open(path) as image:
                size = image.size
                image.draft("RGB", (widest, widest))
                small = image.convert("RGB")
                small.thumbnail((widest, widest))
    except Exception:  # broken files raise many kinds of errors; they get no picture
        return None
    data = io.BytesIO()
    small.save(data, "JPEG", quality=QUALITY)
    coded = base64.b64encode(data.getvalue()).decode("ascii")
    return Photograph(f"data:image/jpeg;base64,{coded}", size)


PIXELS = 400


def matrix(pattern: MatrixPattern, name: str) -> str:
    """Return the drawing of a symmetric matrix with both triangles."""
    return _figure(matrix_density(pattern, pixels=PIXELS), name, "both triangles and the diagonal")


def orderings(
    pattern: MatrixPattern, orders: Mapping[str, ArrayLike | None], name: str = "S"
) -> str:
    """Return the drawings of a matrix and of its factor under each order, fill-in in orange."""
    figures = []
    for label, order in orders.items():
        ordered = pattern.permuted(order)
        above = matrix_density(ordered, pixels=PIXELS)
        below = factor_density(ordered, pixels=PIXELS)
        figures += [
            tag("div",
                _figure(above, f"{name}, {label}", "both triangles and the diagonal"),
                _figure(below, f"L, {label}", "lower triangle and diagonal"))
        ]  # fmt: skip
    return tag("div", *figures, class_="grid spies")


def _figure(density: Density, name: str, convention: str) -> str:
    words = f"{name}: {density.num_nonzeros:,} nonzeros ({convention})"
    if density.fill.any():
        words += f", {round(float(density.fill.sum())):,} of them fill"
    if len(density.entries) == 0:
        return tag("figure", tag("figcaption", escape(words)))
    image = tag("img", src=data_uri(density.rgba()), alt=words, class_="spy")
    return tag("figure", tag("div", image, class_="frame"), tag("figcaption", escape(words)))
