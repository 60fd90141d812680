"""Values of flags: parsing of ids, names, lists and paths.

``READERS`` has a parser for each ``value`` in the fields of option classes.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

from bundle.cli.path_checks import PathArgument, a_path
from bundle.model.image_selection import MOST_IDS, id_range


def choice_word(text: str) -> str:
    """Return a choice in the spelling of the command line."""
    return text.lower().replace("_", "-")


def parse_ids(text: str) -> tuple[int, ...]:
    """Return the ids in text such as "1,2,5-9", sorted, without repeats.

    Raises:
        argparse.ArgumentTypeError: the text has another form, or more than ten million ids.
    """
    ids: set[int] = set()
    for part in text.split(","):
        try:
            more = id_range(part)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from None
        if more is None:
            raise argparse.ArgumentTypeError(
                f"expected ids and ranges such as 1,2,5-9, found {text!r}"
            )
        if more.stop - more.start > MOST_IDS - len(ids):  # len() of a range fails above 2^63 - 1
            raise argparse.ArgumentTypeError(f"expected at most {MOST_IDS} ids, found {text!r}")
        ids.update(more)
    return tuple(sorted(ids))


def parse_images(text: str) -> tuple[int, ...] | str:
    """Return the ids of images, or the text if it has names, which need the problem.

    Raises:
        argparse.ArgumentTypeError: the text has neither ids nor names.
    """
    parts = [part.strip() for part in text.split(",")]
    numeric = all(part.replace("-", "").strip().isdigit() for part in parts)
    return parse_ids(text) if numeric or not all(parts) else text


def parse_sensors(text: str) -> tuple[tuple[int, int], ...]:
    """Return the pairs of ids in text such as "1:2,1:3".

    Raises:
        argparse.ArgumentTypeError: the text has another form.
    """
    return _pairs(text, "sensors RIG:CAMERA such as 1:2,1:3")


def _parse_pairs(text: str) -> tuple[tuple[int, int], ...]:
    return _pairs(text, "pairs A:B of image ids such as 1:2,7:3")


def _pairs(text: str, expected: str) -> tuple[tuple[int, int], ...]:
    pairs = []
    for part in text.split(","):
        first, _, second = part.partition(":")
        try:
            pairs.append((int(first), int(second)))
        except ValueError:
            raise argparse.ArgumentTypeError(f"expected {expected}, found {text!r}") from None
    return tuple(pairs)


def _parse_ids_or_all(text: str) -> tuple[int, ...] | bool | str:
    return True if text == "all" else text if text == "size" else parse_ids(text)


def _parse_words(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _parse_counts(text: str) -> tuple[int, ...]:
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isascii() and part.isdigit() and len(part) < 9 for part in parts):
        raise argparse.ArgumentTypeError(f"expected numbers such as 1,2, found {text!r}")
    return tuple(map(int, parts))


_IMAGES = "ids and names, such as 1,2,5-9,left/*.jpg; "

READERS: dict[str, tuple[Callable[[str], Any], str]] = {
    "checkpoint": (PathArgument("checkpoint", replaces=("resume",)), ""),
    "counts": (_parse_counts, ""),
    "exif or path": (PathArgument(words=("exif",)), ""),
    "xmp or path": (PathArgument(words=("xmp",)), ""),
    "ids": (parse_ids, "such as 1,2,5-9; "),
    "ids or all": (_parse_ids_or_all, "such as 1,2,5-9; "),
    "images": (parse_images, _IMAGES),
    "names of images": (str, _IMAGES),
    "pairs": (_parse_pairs, ""),
    "path": (a_path, ""),
    "resumed checkpoint": (PathArgument("checkpoint", replaces=("checkpoint",)), ""),
    "sensors": (parse_sensors, "RIG:CAMERA by ids, such as 1:2,1:3; "),
    "word": (choice_word, ""),
    "words": (_parse_words, ""),
}
"""Parsers of values with an example for the help, by the ``value`` of a field."""
