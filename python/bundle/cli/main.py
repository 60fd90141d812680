"""The command `bundle`: finds the subcommand and turns every expected error into one line."""

from __future__ import annotations

import contextlib
import importlib
import os
import sys
from collections.abc import Sequence
from types import ModuleType

from bundle import __version__
from bundle.cli.arguments import Parser, add_common_arguments
from bundle.cli.errors import EXIT_BAD_INPUT, describe_error
from bundle.errors import end_in_one_line

__all__ = ["main"]

COMMANDS = ("info", "inspect", "refine", "compare", "check", "convert", "synth")
"""Subcommands, in the order of the help; each a module with NAME, HELP, add_arguments and run."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0 done, 1 no usable solution, 2 bad input."""
    _print_any_path()
    end_in_one_line()
    try:
        arguments = _parser().parse_args(argv)
        code: int = arguments.run(arguments)
    except (Exception, KeyboardInterrupt) as error:
        line = describe_error(error)
        if line is None:
            raise
        with contextlib.suppress(OSError):  # nobody reads what went wrong
            print(f"error: {line}", file=sys.stderr, flush=True)
        return EXIT_BAD_INPUT
    finally:
        _let_go_of_broken_streams()
    return code


def _parser() -> Parser:
    parser = Parser(
        prog="bundle",
        description="Refines structure-from-motion reconstructions and explains the solve.",
        epilog="bundle COMMAND --help tells more.",
    )
    parser.add_argument("--version", action="version", version=f"bundle {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name in COMMANDS:
        command = _module(name)
        subparser = commands.add_parser(name, help=command.HELP, description=command.HELP)
        command.add_arguments(subparser)
        add_common_arguments(subparser)
        subparser.set_defaults(run=command.run)
    return parser


def _module(name: str) -> ModuleType:
    return importlib.import_module(f"bundle.cli.{name}")


def _let_go_of_broken_streams() -> None:
    """Drop what a closed pipe or a full disk did not take.

    The interpreter flushes once more at its exit and would turn that into a complaint and a code of
    its own.
    """
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _print_any_path() -> None:
    """Let file names that are not UTF-8 pass through standard output as escapes."""
    reconfigure = getattr(sys.stdout, "reconfigure", None)
    if reconfigure is not None:
        reconfigure(errors="backslashreplace")
