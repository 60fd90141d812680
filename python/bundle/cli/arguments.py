"""The parser of the command line, and the arguments that commands share."""

from __future__ import annotations

import argparse
import shutil
import textwrap
from typing import Any, NoReturn

from bundle.errors import InputError
from bundle.io import FORMATS

__all__ = ["Parser", "add_common_arguments", "add_input", "add_output"]


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
