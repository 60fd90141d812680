"""Self-contained HTML file: no network, no second file, no external script; its pictures."""

from __future__ import annotations

import base64
import io
import json
import os
import re
import struct
import warnings
import zlib
from collections.abc import Mapping, Sequence
from html import escape
from importlib import resources
from pathlib import Path, PurePosixPath
from typing import Any

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
from bundle.io.atomic import atomic_write as atomic
from bundle.io.atomic.replaced_paths import is_stream
from bundle.io.recognition import PAGE, check_name
from bundle.reports.sections import plain

# The browser may load only content of the page itself; it enforces this for any data.
POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"
VOID = {"img", "input", "meta"}


def tag(name: str, /, *children: str, **attributes: Any) -> str:
    """Return an element. Children are inserted unchanged as markup; attribute values are escaped.

    An attribute of None or False is omitted; an attribute of True has no value. ``class_`` becomes
    ``class``; underscores in other names become hyphens.
    """
    words = [name]
    for key, value in attributes.items():
        if value is None or value is False:
            continue
        shown = key.rstrip("_").replace("_", "-")
        words.append(shown if value is True else f'{shown}="{escape(str(value))}"')
    opening = f"<{' '.join(words)}>"
    return opening if name in VOID else f"{opening}{''.join(children)}</{name}>"


def heading(title: str, name: str = "") -> str:
    """Return the heading of a section; the table of contents of the page links to it."""
    anchor = name or re.sub(r"\W+", "-", title.lower()).strip("-")
    return tag("h2", escape(title), id=anchor)


def prose(words: str) -> str:
    """Return words as markup; lines do not break within ``->`` or an option as ``--max-error``."""
    return re.sub(r"--[a-z][\w-]*|-&gt;", r'<span class="option">\g<0></span>', escape(words))


def lead(sentences: Sequence[str]) -> str:
    """Return the verdict of a page; its first sentence is bold."""
    first, *rest = map(prose, sentences)
    return tag("p", tag("strong", first), " ", " ".join(rest), class_="headline")


def command_box(command: str) -> str:
    """Return a command to copy; its lines break between words, and not after a hyphen."""
    words = " ".join(tag("span", escape(word)) for word in command.split(" "))
    return tag("pre", tag("code", words))


def as_json(data: Any) -> str:
    """Return data as JSON that is safe inside a script element, for all names in the data.

    HTML parsers end a script at ``</script``, so ``<`` is escaped, and ``&`` and ``>`` as well.
    Arrays and dataclasses become lists and objects, numbers that are not finite null.
    """
    text = json.dumps(plain(data), allow_nan=False, separators=(",", ":"))
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


def write_page(
    path: Path,
    title: str,
    sections: list[str],
    data: Mapping[str, Any] | None = None,
    *,
    headline: str = "",
    script: str | None = None,
) -> None:
    """Write a page completely, or leave no file if the write fails.

    Sections are markup; contents at the side list each :func:`heading`. Without data there is no
    script. ``script`` is a module that reads the data instead of the elimination player; "": none.
    """
    if not is_stream(path):
        check_name(path, *PAGE)
    scripts = ""
    if data is not None:
        scripts = tag("script", as_json(data), type="application/json", id="data")
        if script is None:
            scripts += tag("script", asset("elimination.js"))
        elif script:
            scripts += tag("script", script, type="module")
    head = [
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=POLICY),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("title", escape(title)),
        tag("style", asset("page.css")),
    ]
    body = [tag("h1", prose(headline or title)), _contents(sections), tag("main", *sections)]
    page = tag("html", tag("head", *head), tag("body", *body, scripts), lang="en")
    atomic.write_text(path, f"<!doctype html>\n{page}\n")


def _contents(sections: list[str]) -> str:
    found = re.findall(r'<h2 id="([^"]+)">([^<]+)</h2>', "".join(sections))
    items = [tag("li", tag("a", title, href=f"#{name}")) for name, title in found]
    return tag("nav", tag("ul", *items), aria_label="contents") if len(items) > 1 else ""


def asset(*name: str) -> str:
    """Return the text of a file in the assets folder."""
    return resources.files("bundle.reports.page").joinpath("assets", *name).read_text("utf-8")


# Pictures embedded in the page: arrays and matrices as PNG, photographs as small JPEG.


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

    If no file has this relative name, the file with the same base name directly in the folder is
    used; paths that leave the folder are refused. Pixels keep their stored orientation, and the
    EXIF orientation is ignored: reconstructions use the coordinates of the stored pixels.
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
