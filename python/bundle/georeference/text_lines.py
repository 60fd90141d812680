"""Images by name or id, and lines of text files and tables about images or control points."""

from __future__ import annotations

import csv
import math
import os
import re
from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.base.paths import numbered_lines
from bundle.base.words import plural
from bundle.errors import InputError, brief, nearest, shown
from bundle.georeference.reference_system import ReferenceSystem
from bundle.model.problem import Problem

if TYPE_CHECKING:
    from bundle.georeference.vector_priors import ImagePrior

# Images of a problem by name or id, for files and priors.


class ImageIndex:
    """Finder of images by name: the whole name, or its last part, also without the extension.

    Args:
        problem: problem of the images.
        argument: beginning of messages, such as "gps: ".

    Raises:
        InputError: the images have no names.
    """

    def __init__(self, problem: Problem, argument: str = "") -> None:
        if problem.num_images and not any(problem.image_names):
            raise InputError(f"{argument}expected images with names; BAL files have no names")
        self._problem = problem
        self._argument = argument
        self._whole: dict[str, list[int]] = {}
        self._last: dict[str, list[int]] = {}
        self._stems: dict[str, list[int]] = {}
        self._folded: dict[str, int] = {}
        for index, name in enumerate(problem.image_names):
            self._whole.setdefault(name, []).append(index)
            self._last.setdefault(last_part(name), []).append(index)
            self._stems.setdefault(_ENDS_AS_FILES_DO.sub("", last_part(name)), []).append(index)
            self._folded.setdefault(last_part(name).casefold(), index)

    def find(self, name: str, place: str = "", *, stems: bool = True) -> int | None:
        """Return the index of an image; None if the model has no image of this name.

        ``place``: beginning of messages; by default the argument of the constructor. ``stems``:
        names without their extension count, too.
        """
        last = last_part(name)
        found = self._whole.get(name) or self._last.get(last) or []
        found = found or self._stems.get(last, []) if stems else found
        if len(found) > 1:
            names = [self._problem.image_names[index] for index in found]
            ids = ", ".join(str(self._problem.image_ids[index]) for index in found)
            which = f"ids {ids}" if len(set(names)) == 1 else ", ".join(map(shown, names))
            raise InputError(
                f"{place or self._argument}expected one image of the model named {brief(name)}, "
                f"found {len(found)} ({which})"
            )
        return found[0] if found else None

    def differing_in_case(self, name: str) -> str | None:
        """Return the name of an image that differs from an unknown one only in case."""
        index = self._folded.get(last_part(name).casefold())
        return None if index is None else self._problem.image_names[index]


def last_part(name: str) -> str:
    """Return the name of a file without its folders."""
    return name.replace("\\", "/").rpartition("/")[2]


class ImageFinder:
    """Finder of images by name, or by id if no image has this name.

    ``problem``: problem of the images, with or without names.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._index = ImageIndex(problem) if any(problem.image_names) else None
        self._ids = set(problem.image_ids.tolist())

    def find(self, word: str, place: str = "") -> int:
        """Return the id of an image."""
        is_id = word.isascii() and word.isdigit() and int(word) in self._ids
        row = None if self._index is None else self._index.find(word, place, stems=not is_id)
        if row is not None:
            return int(self._problem.image_ids[row])
        if is_id:
            return int(word)
        meant = nearest(last_part(word), [last_part(name) for name in self._problem.image_names])
        raise InputError(
            f"{place}expected an image of the model by name or id, found {brief(word)}{meant}"
        )


def rows_of_images(problem: Problem, priors: Sequence[ImagePrior]) -> NDArray[np.int64]:
    """Return the index of each prior's image."""
    names: dict[str, int] = {}
    twice: set[str] = set()
    for index, name in enumerate(problem.image_names):
        if name in names:
            twice.add(name)
        names[name] = index
    ids = {image_id: index for index, image_id in enumerate(problem.image_ids.tolist())}
    rows: dict[int, int] = {}
    for position, prior in enumerate(priors):
        place = f"priors: [{position}]: image"
        image = prior.image
        row = names.get(image) if isinstance(image, str) else ids.get(int(image))
        if row is None or image in twice:
            meant = nearest(image, list(names)) if isinstance(image, str) else ""
            found = f"0{meant}" if row is None else "several"
            raise InputError(
                f"{place}: expected exactly one image {brief(image)} in the problem, found {found}"
            )
        if row in rows:
            raise InputError(
                f"{place}: expected one prior per image, found another prior of {brief(image)} "
                f"(the first: [{rows[row]}])"
            )
        rows[row] = position
    return np.fromiter(rows, dtype=np.int64, count=len(rows))


# Reader of OpenDroneMap's text files: the header, and the words of each line.
#
# Files contain tabs, blank lines and ``#`` comments. The first remaining line names the coordinate
# reference system. A name with blanks is in quotes, or between tabs in a line whose other fields
# have no blanks.

_COORDINATES = ("x", "y", "z")
_QUOTES = "; put a name with blanks in quotes"
_ENDS_AS_FILES_DO = re.compile(r"\.[A-Za-z]\w{1,4}$")
_WORDS = re.compile(r"""(?<!\S)(?:"([^"]+)"|'([^']+)')(?!\S)|(\S+)""")

LOCAL = "LOCAL"
"""First line of a file whose coordinates are metres in a frame of their own, the third axis up."""


def read_lines(
    path: str | os.PathLike[str], name_at: int, wanted: str
) -> tuple[ReferenceSystem | None, list[tuple[int, list[str]]]]:
    """Return the reference system, and the words of every further line with its number from 1.

    The system is None after a first line LOCAL: coordinates are metres in a frame of their own.
    """
    lines = [
        (number, line)
        for number, line in numbered_lines(path)
        if line.strip() and not line.strip().startswith("#")
    ]
    if not lines:
        raise InputError(
            f"{shown(path)}: expected a line with the coordinate reference system, found 0 lines"
        )
    (number, header), *rows = lines
    split = [(place, split_words(line, name_at)) for place, line in rows]
    return system_of(f"{shown(path)}: line {number}", header, wanted), split


def system_of(place: str, text: str, wanted: str = "") -> ReferenceSystem | None:
    """Return the reference system that a line names; None for LOCAL."""
    if text.strip().upper() == LOCAL:
        return None
    try:
        return ReferenceSystem(text.strip())
    except InputError as error:
        raise InputError(f"{place}: {error}{wanted}") from None


def split_fields(text: str, separator: str) -> list[str]:
    """Return the fields of a line of a table; quotes may be around them."""
    try:
        (fields,) = csv.reader([text], delimiter=separator, skipinitialspace=True)
    except csv.Error:  # longer than any table has
        return [text]
    return [field.strip() for field in fields]


def split_words(line: str, name_at: int) -> list[str]:
    """Return the words of a line: the fields between tabs or commas if only the name has blanks."""
    for mark in "\t,":
        fields = [field.strip().strip("'\"") for field in line.split(mark) if field.strip()]
        others = fields[:name_at] + fields[name_at + 1 :]
        is_split = len(fields) > max(name_at, 1) and not re.search(r"\s", "".join(others))
        if is_split and (mark == "," or _ENDS_AS_FILES_DO.search(fields[name_at])):
            return fields
    return [next(filter(None, groups)) for groups in _WORDS.findall(line)]


def parse_number(place: str, name: str, word: str, *, unknown: bool = False) -> float:
    """Return a word as a number.

    ``unknown``: allow nan for unknown values.
    """
    try:
        value = float(word)
    except ValueError:
        value = math.inf
    if math.isinf(value) or (math.isnan(value) and not unknown):
        kind = "a number or nan" if unknown else "a number"
        hint = "" if name not in _COORDINATES or not re.search("[^\\W\\d]", word) else _QUOTES
        raise InputError(f"{place}: {name}: expected {kind}, found {brief(word)}{hint}")
    return value


UNIT = re.compile(
    r"(?<![^\W_])(?:(?P<us>us\W*(?:survey\W*)?(?:ft|feet|foot)|ft\W*us)|(?P<ft>ft|feet|foot)|(?P<cm>cm)"
    r"|(?P<mm>mm)|m|met(?:er|re)s?|deg(?:rees?)?)(?![^\W_])",
    re.IGNORECASE,
)


class Table(NamedTuple):
    """Table with titles of columns."""

    place: str  # file and line of the titles
    above: list[str]  # lines above them
    titles: list[str]
    letters: list[str]  # of the titles, in lower case, without units
    columns: list[int]  # index of each known title; -1 without it
    rows: list[tuple[int, list[str]]]  # number from 1 and fields of each line
    comma: str  # "." for decimal commas; "," between fields


def read_table(path: str | os.PathLike[str], known: Mapping[str, str]) -> Table | None:
    """Return a table with one of the first three columns of ``known``; None without titles.

    ``known``: letters of the titles of each column, preferred ones first.
    """
    lines = [(number, line.strip(" \r")) for number, line in numbered_lines(path) if line.strip()]
    for first, (number, header) in enumerate(lines[:5]):
        place = f"{shown(path)}: line {number}"
        mark = next((mark for mark in ";\t," if mark in header), "\t")
        titles = split_fields(header.lstrip("# ").rstrip(mark), mark)
        letters = [
            re.sub(r"[\[(].*?[\])]|[\W_]", "", UNIT.sub("", title).lower()) for title in titles
        ]
        columns = [
            next((letters.index(title) for title in words.split() if title in letters), -1)
            for words in known.values()
        ]
        below = lines[first : first + 2][-1][1]
        if max(columns[:3]) >= 0 and mark in header and mark in below:
            break
    else:
        return None
    rows = []
    for number, line in lines[first + 1 :]:
        fields = split_fields(line, mark)
        if line[0] == "#" or not any(fields):
            continue
        if len(fields) < len(titles) or any(fields[len(titles) :]):
            raise InputError(
                f"{shown(path)}: line {number}: expected {plural(len(titles), 'field')}, one for "
                f"each title, found {len(fields)}"
            )
        rows.append((number, fields))
    above = [line for _, line in lines[:first]]
    return Table(place, above, titles, letters, columns, rows, "," if mark == "," else ".")


# Lines of text files with numbers of images: words, images, headers.
#
# Lines have words between blanks, tabs or commas; lines that begin with ``#`` are comments. A name
# with blanks is in quotes. An image is given by its name (the last part is sufficient if it is
# unique) or, if no image has this name, by its id.


def headed_rows(
    path: str | os.PathLike[str],
    images: ImageFinder,
    layouts: Mapping[tuple[str, ...], Sequence[str]],
    example: str,
) -> tuple[tuple[str, ...], list[str], list[tuple[str, int, list[str]]]]:
    """Return the columns of values in the header, all columns after the name, and the rows."""
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
            lines.append((number, split_fields(text, ",")))
        else:
            lines.append((number, split_words(text, 0)))
    return lines


def image_rows(
    path: str | os.PathLike[str],
    images: ImageFinder,
    lines: list[tuple[int, list[str]]],
    layout: str,
) -> list[tuple[str, int, list[str]]]:
    """Return place, id of the image and numbers of each line."""
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
    """Return the numbers of a line; those named in ``unknown`` may be nan."""
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
