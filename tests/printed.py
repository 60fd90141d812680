"""Numbers and kinds in a sentence or a table, whatever its words are."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bundle import Summary


def figures(text: str) -> list[str]:
    """The numbers of a text, in order; those within names and words are left out."""
    return re.findall(r"(?<![\w.])[-+]?\d(?:[\d,]*\d)?(?:\.\d+)?(?:e[-+]?\d+)?(?![\w])", text)


def warning(summary: Summary, kind: str) -> str:
    """Return the only warning of a kind."""
    assert summary.warning_kinds.count(kind) == 1, summary.warnings
    return summary.warnings[summary.warning_kinds.index(kind)]


def in_order(text: str, *tokens: str) -> bool:
    """Return whether names and numbers stand in a text one after the other, as whole words."""
    gap = r"(?![\w-])(?!\.\d).*?(?<![\w.-])"
    return (
        re.search(r"(?<![\w.-])" + gap.join(map(re.escape, tokens)) + r"(?![\w-])", text)
        is not None
    )


def table(text: str) -> dict[str, list[str]]:
    """First column to the others, of a table whose columns are two blanks apart."""
    cells = (re.split(r" {2,}", line.strip()) for line in text.splitlines() if line.strip())
    return {first: rest for first, *rest in cells}
