"""Line breaks and widths of text on a terminal, as rich has them.

A line breaks between words; a word that is longer than a line continues on the next one. The width
of a text is its number of cells: Chinese characters take two, combining characters none. rich knows
these widths, and is imported only for text that is not ASCII: with its other modules it takes 15 ms
to import, a tenth of a small refinement.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

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
