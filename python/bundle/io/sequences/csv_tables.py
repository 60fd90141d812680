"""Reading and writing of CSV tables of integers (nanoseconds) and floating-point numbers.

The reader records the line of each row. Time stamps have 19 digits, more than a double holds, and
are therefore parsed as integers. Numbers are written with enough digits to read back unchanged.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.paths import numbered_lines
from bundle.base.records import dataclass
from bundle.errors import InputError, brief, shown


@dataclass(frozen=True, eq=False)
class CsvTable:
    """Columns of a file."""

    whole: NDArray[np.int64]  # (n, number of integer columns) int64
    numbers: NDArray[np.float64]  # (n, number of other columns)
    lines: NDArray[np.int64]  # (n,) line number of each row in the file, from 1
    name: str  # name of the file, for messages

    def place(self, row: int) -> str:
        """Return "imu.csv: line 12"."""
        return f"{self.name}: line {self.lines[row]}" if row < len(self.lines) else self.name

    def __len__(self) -> int:
        return len(self.lines)


def read_csv(
    path: str | os.PathLike[str],
    whole: Sequence[str],
    numbers: Sequence[str],
    delimiter: str | None = ",",
    extra: bool = False,
) -> CsvTable:
    """Read integer columns, then numbers; skip empty lines, comments and a header.

    Args:
        whole: names of the integer columns, for messages.
        numbers: names of the other columns, which follow the integer columns.
        delimiter: delimiter between columns; None for white space.
    """
    name = shown(path)
    lines, rows = [], []
    for number, line in numbered_lines(path):
        text = line.strip()
        if text and text[0] != "#":
            lines.append(number)
            rows.append(text)
    if rows and rows[0][0].isalpha() and rows[0][:3].lower() not in ("nan", "inf"):
        del lines[0], rows[0]  # a header
    columns = [*whole, *numbers]
    kind = np.dtype([("whole", np.int64, (len(whole),)), ("numbers", np.float64, (len(numbers),))])
    wanted = range(len(columns)) if extra else None
    try:
        table = (
            np.loadtxt(rows, kind, comments=None, delimiter=delimiter, ndmin=1, usecols=wanted)
            if rows
            else np.zeros(0, kind)
        )
    except ValueError:
        for number, text in zip(lines, rows, strict=True):
            _check_line(f"{name}: line {number}", text.split(delimiter), whole, numbers, extra)
        raise
    return CsvTable(
        whole=np.ascontiguousarray(table["whole"]),
        numbers=np.ascontiguousarray(table["numbers"]),
        lines=np.array(lines, np.int64),
        name=name,
    )


def csv_lines(head: str, *columns: Any) -> str:
    """Return the text of a file: a header, then one row for each entry of the 1-D columns."""
    cells = [[repr(value) for value in np.asarray(column).tolist()] for column in columns]
    rows: Iterable[str] = (",".join(row) for row in zip(*cells, strict=True))
    return "\n".join([head, *rows, ""])


def _check_line(
    place: str, words: list[str], whole: Sequence[str], numbers: Sequence[str], extra: bool
) -> None:
    expected = len(whole) + len(numbers)
    if len(words) < expected or (len(words) > expected and not extra):
        raise InputError(
            f"{place}: expected {expected} columns ({', '.join([*whole, *numbers])}), "
            f"found {len(words)}"
        )
    for index, name in enumerate([*whole, *numbers]):
        word = words[index].strip()
        try:
            value = int(word) if index < len(whole) else float(word)
            valid = index >= len(whole) or -(2**63) <= value < 2**63
        except ValueError:
            valid = False
        if not valid:
            sort = "an integer of 64 bits" if index < len(whole) else "a number"
            hint = "; seconds instead of nanoseconds?" if _is_seconds(name, word) else ""
            raise InputError(f"{place}: {name}: expected {sort}, found {brief(word)}{hint}")


def _is_seconds(name: str, word: str) -> bool:
    try:
        return name.startswith("timestamp") and 0 <= float(word) < 1e11
    except ValueError:
        return False
