"""Layout of tables, facts and notes, with the same text on a terminal and in a pipe.

A :class:`Block` returns lines for a width, made of pieces of text with a style. rich prints them on
a terminal, in colours that the terminal has; a pipe gets the text and needs no import of rich.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple, Protocol, TextIO, TypeAlias

if TYPE_CHECKING:
    from rich.console import Console

NARROWEST, WIDEST = 60, 100
LABEL_WIDTH = 16
GUTTER = 2
NARROWEST_BAR, BAR_WIDTH = 8, 40
DECIDED_BY_RICH = ("COLUMNS", "FORCE_COLOR", "TTY_COMPATIBLE")
"""Variables by which rich takes a pipe for a terminal, or another width."""


class Piece(NamedTuple):
    """Text in a style of rich, such as "bold"."""

    text: str
    style: str = ""


Line: TypeAlias = "Sequence[Piece]"


class Block(Protocol):
    """A part of a report."""

    def lines(self, width: int) -> Iterable[Line]:
        """Return the lines for a width in cells; a line without blanks may be wider."""


class Paragraph(NamedTuple):
    """Text in a style, with line breaks between words."""

    text: str
    style: str = ""

    def lines(self, width: int) -> Iterable[Line]:
        """See :meth:`Block.lines`."""
        return [[Piece(line, self.style)] for line in wrap(self.text, width)]


def terminal(file: TextIO) -> Console:
    """Return rich's console, which uses colours only on a terminal and prints without markup."""
    from rich.console import Console

    return Console(
        file=file,
        markup=False,
        emoji=False,
        highlight=False,
        force_jupyter=False,  # in a notebook rich would display it instead
    )


def is_terminal(file: TextIO) -> bool:
    """Return True if colours and updating lines are possible."""
    return _rich_decides(file) and terminal(file).is_terminal


def screen_width(file: TextIO) -> int:
    """Return the width of reports on a terminal or in a pipe."""
    width = WIDEST
    if _rich_decides(file):
        found = terminal(file)
        width = found.width if found.is_terminal or "COLUMNS" in os.environ else WIDEST
    return min(max(width, NARROWEST), WIDEST)


def _rich_decides(file: TextIO) -> bool:
    try:
        return file.isatty() or any(name in os.environ for name in DECIDED_BY_RICH)
    except ValueError:  # closed
        return False


def print_styled(blocks: Iterable[Block | str], file: TextIO) -> None:
    """Print blocks on a terminal, in its colours."""
    from rich.text import Text

    screen, width = terminal(file), screen_width(file)
    for line in _lines(blocks, width):
        text = Text.assemble(*((piece.text, piece.style) for piece in line))
        # Do not cut long words of a command.
        screen.print(text, no_wrap=True, overflow="ignore", crop=False)


def render(*blocks: Block | str, width: int = WIDEST) -> str:
    """Return blocks as plain lines, without colours or trailing spaces."""
    return "".join(
        f"{''.join(piece.text for piece in line).rstrip()}\n" for line in _lines(blocks, width)
    )


def _lines(blocks: Iterable[Block | str], width: int) -> Iterable[Line]:
    for block in blocks:
        yield from (Paragraph(block) if isinstance(block, str) else block).lines(width)


class _Pairs(NamedTuple):
    """Labels at the left and texts at the right, which wrap."""

    rows: Sequence[tuple[str, str]]
    gutter: int
    narrowest: int = 0
    label_style: str = ""
    style: str = ""

    def lines(self, width: int) -> Iterable[Line]:
        """See :meth:`Block.lines`."""
        widest = max((longest_line(label) for label, _ in self.rows), default=0)
        left = max(widest, self.narrowest)
        for label, text in self.rows:
            given = clean(label)
            for line in wrap(text, max(width - left - self.gutter, 1)):
                yield [
                    Piece(padded(given, left), self.label_style),
                    Piece(" " * self.gutter),
                    Piece(line, self.style),
                ]
                given = ""


def facts(rows: Iterable[tuple[str, str]]) -> Block:
    """Return a table with labels at the left and facts at the right; long facts are wrapped."""
    return _Pairs([*rows], GUTTER, LABEL_WIDTH, label_style="bold")


def notes(sentences: Iterable[str], *, style: str = "") -> list[Block | str]:
    """Return sentences as dashed paragraphs."""
    rows = [("-", sentence) for sentence in sentences]
    return [_Pairs(rows, 1, label_style=style, style=style)] if rows else []


class _Size(NamedTuple):
    """Widths with all line breaks and without any."""

    least: int
    most: int


class Columns:
    """A table without frames: columns of text, then right-aligned columns of numbers.

    If it is wider than the terminal, text wraps between words. If that is not enough, the table is
    divided into several tables below each other. Each repeats the first `keys` columns. No text is
    cut.
    """

    def __init__(
        self, head: Sequence[str], rows: Iterable[Sequence[str | Bar]], left: int, keys: int
    ) -> None:
        self.head = tuple(head)
        self.rows = [tuple(row) for row in rows]
        self._left = left
        self._keys = keys

    def lines(self, width: int) -> Iterable[Line]:
        """Yield the table, divided if it is wider than the terminal."""
        sizes = self._sizes()
        narrowest = [min(size.least, width) for size in sizes]
        narrowest[0] = min(narrowest[0], width // 2)
        for position, group in enumerate(_groups(narrowest, width, self._keys)):
            if position:
                yield []
            spare = width - sum(narrowest[index] + GUTTER for index in group) + GUTTER
            widths = {}
            for index in group:
                taken = min(sizes[index].most - narrowest[index], max(spare, 0))
                widths[index] = narrowest[index] + taken
                spare -= taken
            yield from self._table(_shrunk(widths, width))

    def _sizes(self) -> list[_Size]:
        """Return, for each column, its width with all line breaks and its width without any."""
        sizes = []
        for index, cells in enumerate(zip(self.head, *self.rows, strict=True)):
            found = [_size(cell) for cell in cells]
            widest = max(size.most for size in found)
            wraps = index < self._left
            narrowest = max(size.least for size in found) if wraps else widest
            least = LABEL_WIDTH if index == 0 else 0
            sizes.append(_Size(max(narrowest, least), max(widest, least)))
        return sizes

    def _table(self, widths: Mapping[int, int]) -> Iterable[Line]:
        yield from self._row(self.head, widths, "bold", top=False)
        for row in self.rows:
            is_total = isinstance(row[0], str) and row[0].startswith("total")
            yield from self._row(row, widths, "bold" if is_total else "")

    def _row(
        self, cells: Sequence[str | Bar], widths: Mapping[int, int], style: str, top: bool = True
    ) -> Iterable[Line]:
        parts = {index: _cell_lines(cells[index], width) for index, width in widths.items()}
        height = max(map(len, parts.values()))
        filled = []
        for index, part in parts.items():
            empty = [""] * (height - len(part))
            lines = [*part, *empty] if top else [*empty, *part]
            filled.append([padded(line, widths[index], index >= self._left) for line in lines])
        for line in zip(*filled, strict=True):
            yield [Piece((" " * GUTTER).join(line), style)]


def _shrunk(widths: Mapping[int, int], limit: int) -> Mapping[int, int]:
    """Return narrower widths if a long key and a long column together exceed the limit."""
    excess = sum(widths.values()) + GUTTER * (len(widths) - 1) - limit
    shrunk = dict(widths)
    while excess > 0:
        widest = max(shrunk, key=lambda index: shrunk[index])
        shrunk[widest] -= 1
        excess -= 1
    return shrunk


def _groups(widths: Sequence[int], limit: int, keys: int) -> list[list[int]]:
    """Return the columns of each table; every table has the first `keys` columns."""
    first = list(range(keys))
    keys_width = sum(widths[:keys]) + GUTTER * (keys - 1)
    groups, used = [[*first]], keys_width
    for index, width in enumerate(widths[keys:], keys):
        if used + GUTTER + width > limit and len(groups[-1]) > keys:
            groups.append([*first])
            used = keys_width
        groups[-1].append(index)
        used += GUTTER + width
    return groups


def columns(
    head: Sequence[str], rows: Iterable[Sequence[str | Bar]], *, left: int = 1, keys: int = 1
) -> Columns:
    """Return a table of `left` columns of text, then numbers; see :class:`Columns`.

    The first `keys` columns identify a row. A row whose first cell starts with "total" is
    highlighted.
    """
    return Columns(head, rows, left, keys)


class Bar(NamedTuple):
    """A bar of at most `BAR_WIDTH` characters; shorter on a narrow terminal."""

    share: float  # length, 0 to 1; a positive share has at least one character


def _size(cell: str | Bar) -> _Size:
    if isinstance(cell, Bar):
        return _Size(NARROWEST_BAR, BAR_WIDTH)
    return _Size(longest_word(cell), longest_line(cell))


def _cell_lines(cell: str | Bar, width: int) -> list[str]:
    if isinstance(cell, Bar):
        return ["#" * math.ceil(cell.share * min(width, BAR_WIDTH))]
    return wrap(cell, width)


# Line breaks and widths of text on a terminal, as rich has them.
#
# A line breaks between words; a word that is longer than a line continues on the next one. The
# width of a text is its number of cells: Chinese characters take two, combining characters none.
# rich knows these widths, and is imported only for text that is not ASCII: with its other modules
# it takes 15 ms to import, a tenth of a small refinement.

_WORD = re.compile(r"\s*\S+\s*")
_CONTROL = dict.fromkeys((7, 8, 11, 12, 13))
"""Control characters without a width: they would move the cursor."""

TAB = 8


def clean(text: str) -> str:
    """Return text without tabs and control characters."""
    return text.translate(_CONTROL).expandtabs(TAB)


def cell_width(text: str) -> int:
    """Return the number of cells of a text in one line."""
    if text.isascii():
        return len(text)
    from rich.cells import cell_len

    return cell_len(text)


def longest_line(text: str) -> int:
    """Return the width of a text without further line breaks."""
    return max(map(cell_width, text.splitlines()), default=0)


def longest_word(text: str) -> int:
    """Return the width of a text with all possible line breaks."""
    return max(map(cell_width, text.split()), default=0)


def padded(text: str, width: int, is_right: bool = False) -> str:
    """Return a line with blanks up to a width, at its left if it is right-aligned."""
    blanks = " " * (width - cell_width(text))
    return blanks + text if is_right else text + blanks


def wrap(text: str, width: int) -> list[str]:
    """Return the lines of a text, none wider than `width`, without blanks at their ends."""
    return [part.rstrip() for line in clean(text).split("\n") for part in _broken(line, width)]


def _broken(line: str, width: int) -> Iterator[str]:
    if cell_width(line) <= width:
        yield line
        return
    part = ""
    for word in _WORD.findall(line):
        if part and cell_width(part) + cell_width(word.rstrip()) > width:
            yield part
            part = ""
        *full, rest = _folded(word, width)
        yield from full
        part += rest
    yield part


def _folded(word: str, width: int) -> list[str]:
    """Return the parts of a word that is longer than a line."""
    if cell_width(word.rstrip()) <= width:
        return [word]
    if word.isascii():
        return [word[begin : begin + width] for begin in range(0, len(word), width)]
    from rich.cells import chop_cells

    return chop_cells(word, width)
