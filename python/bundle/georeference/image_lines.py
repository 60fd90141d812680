"""Lines of text files with numbers of images: words, images, headers.

Lines have words between blanks, tabs or commas; lines that begin with ``#`` are comments. A name
with blanks is in quotes. An image is given by its name (the last part is sufficient if it is
unique) or, if no image has this name, by its id.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Collection, Mapping, Sequence

from bundle.base.paths import numbered_lines
from bundle.errors import InputError, brief, shown
from bundle.georeference.image_finder import ImageFinder
from bundle.georeference.odm_lines import parse_number, split_words


def headed_rows(
    path: str | os.PathLike[str],
    images: ImageFinder,
    layouts: Mapping[tuple[str, ...], Sequence[str]],
    example: str,
) -> tuple[tuple[str, ...], list[str], list[tuple[str, int, list[str]]]]:
    """Return the columns of values that the header names, all columns after the name, and the rows.

    Args:
        path: path of the file.
        images: images of the problem.
        layouts: allowed columns after the name, and the standard deviations that may follow them.
        example: a header, for messages.

    Raises:
        InputError: the header is unknown, or as :func:`image_rows`.
        OSError: the file cannot be read.
    """
    (number, header), *lines = content_lines(path) or [(0, [])]
    found = next(
        (
            (columns, layout)
            for columns, sigmas in layouts.items()
            for count in range(len(sigmas) + 1)
            if header == (layout := ["name", *columns, *sigmas[:count]])
        ),
        None,
    )
    if found is None:
        raise InputError(
            f"{shown(path)}: line {number}: expected a header such as {example}, found "
            f"{brief(' '.join(header))}"
            if number
            else f"{shown(path)}: expected a header and a line for each image, found 0 lines"
        )
    columns, layout = found
    return columns, layout[1:], image_rows(path, images, lines, " ".join(layout))


def content_lines(path: str | os.PathLike[str]) -> list[tuple[int, list[str]]]:
    """Return the words of every line with content, with its number from 1."""
    lines = []
    for number, line in numbered_lines(path):
        text = line.strip()
        if not text or text.startswith("#"):
            continue
        if "," in text:
            (words,) = csv.reader([text], skipinitialspace=True)
            lines.append((number, [word.strip() for word in words]))
        else:
            lines.append((number, split_words(text, 0)))
    return lines


def image_rows(
    path: str | os.PathLike[str],
    images: ImageFinder,
    lines: list[tuple[int, list[str]]],
    layout: str,
) -> list[tuple[str, int, list[str]]]:
    """Return place, id of the image and numbers of each line.

    Raises:
        InputError: there is no line, an image is unknown, or has two lines.
    """
    if not lines:
        raise InputError(f"{shown(path)}: expected lines of {layout}, found 0")
    seen: dict[int, int] = {}
    rows = []
    for number, (name, *words) in lines:
        place = f"{shown(path)}: line {number}"
        image = images.find(name, f"{place}: ")
        if image in seen:
            raise InputError(
                f"{place}: expected one line for each image, found {brief(name)} again (first in "
                f"line {seen[image]})"
            )
        seen[image] = number
        rows.append((place, image, words))
    return rows


def row_numbers(
    place: str,
    names: Sequence[str],
    words: Sequence[str],
    required: int,
    unknown: Collection[str] = (),
) -> list[float]:
    """Return the numbers of a line; those named in ``unknown`` may be nan.

    Raises:
        InputError: a word is missing, superfluous or no number.
    """
    if not required <= len(words) <= len(names):
        optional = "".join(f" [{name}]" for name in names[required:])
        raise InputError(
            f"{place}: expected name {' '.join(names[:required])}{optional}, "
            f"found {len(words)} words after the name"
        )
    return [
        parse_number(place, name, word, unknown=name in unknown)
        for name, word in zip(names, words, strict=False)
    ]
