"""The parser of the command line, and the arguments that commands share."""

from __future__ import annotations

import argparse
import shutil
import sys
import textwrap
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NoReturn

from bundle.cli.path_checks import PathArgument, a_path, check_paths, reconstruction, report_path
from bundle.cli.standard_streams import print_out
from bundle.cli.suggestions import unknown_command, unknown_value
from bundle.errors import InputError, shown
from bundle.io.open import FORMATS

if TYPE_CHECKING:
    from bundle.model.problem import Problem

__all__ = [
    "Parser",
    "add_common_arguments",
    "add_input",
    "add_output",
    "add_rig_config",
    "with_rigs",
]


class _Formatter(argparse.HelpFormatter):
    """Help that breaks lines at blanks only: "principal-point" stays one word."""

    def __init__(self, prog: str) -> None:
        width = min(shutil.get_terminal_size().columns, 100)
        super().__init__(prog, max_help_position=28, width=width)

    def _split_lines(self, text: str, width: int) -> list[str]:
        words = " ".join(text.split())
        return textwrap.wrap(words, width, break_on_hyphens=False, break_long_words=False)


class Parser(argparse.ArgumentParser):
    """An argument parser whose complaints are InputErrors.

    A flag that does not exist comes before anything that is missing: who misspells ``--output``
    learns that, not that ``--output`` is required.
    """

    def __init__(self, *, explain: Callable[[str], str] | None = None, **settings: Any) -> None:
        super().__init__(allow_abbrev=False, formatter_class=_Formatter, **settings)
        self.explain = explain or (lambda found: f"unrecognized arguments: {found}")

    def error(self, message: str) -> NoReturn:
        """Raise what is wrong as one line that also says where to read more."""
        raise InputError(f"{shown(message)} (see {self.prog} --help)")

    def _print_message(self, message: str, file: Any = None) -> None:
        """Print help and versions; unlike the base class, say so where they do not arrive."""
        if file is sys.stderr:
            super()._print_message(message, file)
        else:
            print_out(message)

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parse; unlike the base class, take no flag or word that is not known."""
        for word in args or ():
            if word == "--" or (self._subparsers is not None and not word.startswith("-")):
                break  # what follows is no flag, or those of a command
            if word.startswith("--") and word.partition("=")[0] not in self.flags():
                self.error(self.explain(word))
        parsed, rest = super().parse_known_args(args, namespace)
        if rest:
            self.error(self.explain(rest[0]))
        check_paths(self._actions, parsed)
        return parsed, rest

    def flags(self) -> tuple[str, ...]:
        """Return every flag."""
        return tuple(self._option_string_actions)

    def commands(self) -> dict[str, Parser]:
        """Return the parsers of the commands by name."""
        found: dict[str, Parser] = {}
        for action in self._subparsers._group_actions if self._subparsers is not None else ():
            if isinstance(action, argparse._SubParsersAction):
                found.update(action.choices)
        return found

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is None or value in action.choices:
            return
        if isinstance(action, argparse._SubParsersAction):
            self.error(unknown_command(value, action.choices))
        raise argparse.ArgumentError(action, unknown_value(str(value), map(str, action.choices)))


def add_common_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags that every command has."""
    parser.add_argument(
        "--json",
        metavar="FILE",
        type=report_path,
        help="also write a report for programs; -: to standard output, and nothing else there",
    )
    parser.add_argument(
        "--quiet", action="store_true", help="no progress on standard error (default: shown)"
    )


def add_input(
    parser: argparse.ArgumentParser, name: str = "input", nargs: str | None = None
) -> None:
    """Add INPUT."""
    parser.add_argument(
        name,
        metavar="INPUT",
        nargs=nargs,
        type=reconstruction,
        help="a BAL file (plain, .gz or .bz2), the folder of a COLMAP model (binary or text) or, "
        "for info, refine, compare, inspect, diagnose, covariance and convert, a pose graph (g2o, "
        "plain, .gz or .bz2), or, for info and convert, the folder of a visual-inertial sequence; "
        "told by its content",
    )


def add_rig_config(parser: argparse.ArgumentParser) -> None:
    """Add --rig-config."""
    parser.add_argument(
        "--rig-config",
        metavar="FILE",
        type=a_path,
        help="make rigs out of the images, as COLMAP's rig_config.json says: images whose names "
        "differ in their prefix only are a frame; poses of sensors that it does not have are means "
        "over the frames (default: the rigs of INPUT)",
    )


def with_rigs(problem: Problem, path: str | None) -> Problem:
    """Return the problem with the rigs of a file, if there is one."""
    if path is None:
        return problem
    from bundle.editing.rig_config import apply_rig_config

    return apply_rig_config(problem, path)


def add_output(
    parser: argparse.ArgumentParser,
    *names: str,
    replaces: tuple[str, ...] = ("input",),
    **settings: Any,
) -> None:
    """Add OUTPUT under the given names, --format and --overwrite.

    Args:
        parser: of the command.
        *names: of the argument.
        replaces: destinations of the arguments that may name the same model.
        **settings: of ``add_argument``.
    """
    parser.add_argument(
        *names,
        metavar="OUTPUT",
        type=PathArgument("output", is_data=True, replaces=replaces),
        help="what to write, which may be INPUT; NAME.txt, .txt.gz and .txt.bz2 are BAL files, "
        "NAME/ and folders that exist COLMAP models, other names take INPUT's format",
        **settings,
    )
    parser.add_argument(
        "--format", choices=FORMATS, help="format of OUTPUT (default: what its name says)"
    )
    parser.add_argument(
        "--overwrite",
        action="store_true",
        help="replace a model of other images at OUTPUT (default: stop if there is one)",
    )
