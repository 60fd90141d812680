"""Flags: those that every command has, and those made from the fields of SolveOptions."""

from __future__ import annotations

import argparse
import dataclasses
import shutil
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

from bundle.errors import InputError
from bundle.io import FORMATS
from bundle.options import SolveOptions

__all__ = [
    "Parser",
    "add_common_arguments",
    "add_input",
    "add_output",
    "add_solve_options",
    "naming_flags",
    "parse_ids",
    "solve_options",
]

MOST_IDS = 10_000_000
"""Ids that a list may hold: a slip in a range must not fill the memory."""


class _Formatter(argparse.HelpFormatter):
    """Help that breaks lines at blanks only: "principal-point" stays one word."""

    def __init__(self, prog: str) -> None:
        width = min(shutil.get_terminal_size().columns, 100)
        super().__init__(prog, max_help_position=28, width=width)

    def _split_lines(self, text: str, width: int) -> list[str]:
        return textwrap.wrap(" ".join(text.split()), width, break_on_hyphens=False)


class Parser(argparse.ArgumentParser):
    """An argument parser whose complaints are InputErrors."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(allow_abbrev=False, formatter_class=_Formatter, **settings)

    def error(self, message: str) -> NoReturn:
        """Raise what is wrong as one line that also says where to read more."""
        raise InputError(f"{message} (see {self.prog} --help)")


def add_common_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags that every command has."""
    parser.add_argument(
        "--json",
        metavar="FILE",
        help="also write a report for programs; -: to standard output, and nothing else there",
    )
    parser.add_argument(
        "--quiet", action="store_true", help="no progress on standard error (default: shown)"
    )


def add_input(parser: argparse.ArgumentParser) -> None:
    """Add INPUT."""
    parser.add_argument(
        "input",
        metavar="INPUT",
        help="a BAL file (plain, .gz or .bz2) or the folder of a COLMAP model (binary or text); "
        "told by its content",
    )


def add_output(parser: argparse.ArgumentParser, *names: str, **settings: Any) -> None:
    """Add OUTPUT under the given names, and --format."""
    parser.add_argument(
        *names,
        metavar="OUTPUT",
        help="what to write, which may be INPUT; NAME.txt, .txt.gz and .txt.bz2 are BAL files, "
        "NAME/ and folders that exist COLMAP models, other names take INPUT's format",
        **settings,
    )
    parser.add_argument(
        "--format", choices=FORMATS, help="format of OUTPUT (default: what its name says)"
    )


def add_solve_options(parser: argparse.ArgumentParser) -> None:
    """Add one flag for each field of SolveOptions."""
    group = parser.add_argument_group("options of the solve")
    for field in dataclasses.fields(SolveOptions):
        _add_option(group, field)


def solve_options(arguments: argparse.Namespace) -> SolveOptions:
    """Return the options that were given.

    Raises:
        InputError: a value is out of range; the message names the flag.

    """
    values = {
        field.name: getattr(arguments, field.name)
        for field in dataclasses.fields(SolveOptions)
        if getattr(arguments, field.name) is not None
    }
    with naming_flags():
        return SolveOptions(**values)


@contextmanager
def naming_flags() -> Iterator[None]:
    """Let an InputError about an option of the solve name its flag, as the user typed it."""
    try:
        yield
    except InputError as error:
        name, _, rest = str(error).partition(":")
        for field in dataclasses.fields(SolveOptions):
            if field.name == name:
                raise InputError(f"{field.metadata['flag']}:{rest}") from None
        raise


def parse_ids(text: str) -> tuple[int, ...]:
    """Return the ids that "1,2,5-9" names, sorted, each once.

    Raises:
        argparse.ArgumentTypeError: anything else, or more than ten million ids.

    """
    ids: set[int] = set()
    for part in text.split(","):
        first, dash, last = (piece.strip() for piece in part.partition("-"))
        if not _is_id(first) or (dash and not _is_id(last)):
            raise argparse.ArgumentTypeError(
                f"expected ids and ranges such as 1,2,5-9, found {text!r}"
            )
        low, high = int(first), int(last) if dash else int(first)
        if high < low:
            raise argparse.ArgumentTypeError(f"the range {part.strip()!r} ends before it starts")
        if high - low >= MOST_IDS - len(ids):
            raise argparse.ArgumentTypeError(f"expected at most {MOST_IDS} ids, found {text!r}")
        ids.update(range(low, high + 1))
    return tuple(sorted(ids))


def _is_id(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) < 20 and int(text) < 2**63


def _add_option(group: argparse._ArgumentGroup, field: dataclasses.Field[Any]) -> None:
    meta = field.metadata
    settings: dict[str, Any] = {"metavar": meta["metavar"]}
    values = ""
    if meta["choices"] is not None:
        choices = [choice.replace("_", "-") for choice in meta["choices"]]
        metavar = meta["flag"].lstrip("-").upper()
        settings = {"metavar": metavar, "choices": choices, "type": _choice}
        values = f"one of {', '.join(choices)}; "
    elif meta["metavar"] == "IDS":
        settings["type"] = parse_ids
        values = "such as 1,2,5-9; "
    elif isinstance(field.default, int | float):
        settings["type"] = type(field.default)
    text = f"{meta['help']} ({values}default: {_shown(field.default)})"
    group.add_argument(
        meta["flag"], dest=field.name, default=None, help=text.replace("%", "%%"), **settings
    )


def _choice(text: str) -> str:
    return text.lower().replace("_", "-")


def _shown(default: Any) -> str:
    if isinstance(default, tuple):
        return ",".join(default).replace("_", "-") or "none"
    return f"{default:g}" if isinstance(default, float) else str(default).replace("_", "-")
