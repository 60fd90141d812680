"""Entry point of `bundle`: run the subcommand, print expected errors as one line; completion."""

from __future__ import annotations

import argparse
import gc
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

from bundle import __version__
from bundle.base import own_process
from bundle.cli import startup
from bundle.cli.commands import COMMANDS
from bundle.cli.error_lines import (
    EXIT_BAD_INPUT,
    EXIT_DONE,
    EXIT_INTERRUPTED,
    complain,
    describe_error,
    is_interruption,
    open_missing_streams,
    release_broken_streams,
)
from bundle.cli.parser import HelpAll, Parser, naming_config, unknown_flag
from bundle.errors import InputError, end_in_one_line
from bundle.io.atomic.replaced_paths import NoteWarning, recording

__all__ = ["COMMANDS", "command_parser", "main"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code; see ``bundle.cli.error_lines``."""
    open_missing_streams()
    end_in_one_line()
    with recording() as written, _noting_recoveries():
        try:
            code = _run(sys.argv[1:] if argv is None else list(argv))
        except (Exception, KeyboardInterrupt) as error:
            startup.is_over = argv is None
            with _ignoring_interrupts(for_good=argv is None):
                line = describe_error(error, written)
                if line is None:
                    raise
                complain(f"error: {line}")
                code = EXIT_INTERRUPTED if is_interruption(error) else EXIT_BAD_INPUT
        finally:
            startup.is_over = argv is None
            if argv is None:  # only the exit of the interpreter follows, which may take a moment
                startup.ignore_interrupts()
            release_broken_streams()
    if argv is None:
        gc.freeze()  # skip a garbage collection at exit; the system frees the memory
    return code


def _run(words: list[str]) -> int:
    parser = command_parser()
    code = EXIT_DONE
    if words[:1] == ["help"]:
        words = [*words[1:], "--help"]
    try:
        if words:
            arguments = parser.parse_args(words)
            from bundle.cli.run import prepare  # late, for fast --version and --help

            with naming_config(arguments.config):
                run = prepare(arguments)
                startup.done()
                code = run()
        else:
            startup.done()
            parser.print_help()
    except SystemExit:  # after --help and --version
        _flush()
        raise
    _flush()
    return code


def _flush() -> None:
    lost = release_broken_streams()
    if lost is not None:
        raise lost


SHELLS = ("bash", "zsh", "tcsh")


class PrintCompletion(argparse.Action):
    """Action that prints the completion script of a shell and exits."""

    def __call__(self, parser: Any, _namespace: Any, shell: Any, _flag: str | None = None) -> None:
        """Print the script, which shtab generates from the parser.

        It is static, so a shell completes without starting Python.
        """
        # Only this flag needs these imports; shtab is an optional dependency.
        from bundle.cli.path_checks import PathArgument

        try:
            import shtab
        except ImportError:
            raise InputError(
                "--print-completion: expected the package shtab, which is not installed: pip "
                "install shtab"
            ) from None
        for command in parser.commands().values():
            for action in command._actions:
                if isinstance(action.type, PathArgument):
                    action.complete = shtab.FILE
        parser._print_message(shtab.complete(parser, shell=shell))
        parser.exit()


def command_parser() -> Parser:
    """Return the parser of all commands; their arguments are declared when needed."""

    def unknown(found: str, command: str) -> str:
        flags = {name: each.flags() for name, each in parser.commands().items()}
        return unknown_flag(found, command, flags)

    parser = Parser(
        prog="bundle",
        description="Refines structure-from-motion reconstructions and explains the solve.",
        epilog="bundle help COMMAND describes a command.",
        spellings={word: name for name, row in COMMANDS.items() for word in row.also.split()},
        explain=lambda found: unknown(found, ""),
    )
    parser.add_argument("--version", action="version", version=f"bundle {__version__}")
    parser.add_argument(
        "--print-completion",
        choices=SHELLS,
        action=PrintCompletion,
        help="print a script that completes commands, flags and values in a shell (needs shtab)",
    )
    commands = parser.add_subparsers(
        title="commands",
        metavar="COMMAND",
        required=True,
        prog="bundle",  # otherwise argparse formats a usage, which takes milliseconds
    )
    for name, row in COMMANDS.items():
        commands.add_parser(
            name,
            help=row.help,
            description=row.help,
            declare=partial(_declare, name),
            explain=lambda found, name=name: unknown(found, name),
        )
    return parser


def _declare(name: str, parser: Parser) -> None:
    """Declare the arguments of a command."""
    own_process.load_numpy()
    from bundle.cli import declarations  # late, for fast --version and --help
    from bundle.cli.option_flags import add_all
    from bundle.cli.path_checks import check_paths

    row = COMMANDS[name]
    parser.check = check_paths
    parser.set_defaults(command=name)
    if row.usage:
        parser.usage = f"bundle {name} {row.usage}"
    parser.add_argument("--help-all", action=HelpAll, nargs=0, help="show all options and exit")
    add_all(parser, (*row.arguments(declarations), *declarations.COMMON))
    parser.set_defaults(flags=parser.flags_by_name(), taken=parser.taken)


@contextmanager
def _noting_recoveries() -> Iterator[None]:
    """Print notes about a model, such as a completed replacement after a killed run."""
    with warnings.catch_warnings():
        show = warnings.showwarning

        def note(message: Warning | str, category: type[Warning], *where: Any, **how: Any) -> None:
            if issubclass(category, NoteWarning):
                complain(f"note: {message}")
            else:
                show(message, category, *where, **how)

        warnings.simplefilter("always", NoteWarning)
        setattr(warnings, "showwarning", note)  # noqa: B010 (the stub allows only its own type)
        yield


@contextmanager
def _ignoring_interrupts(for_good: bool) -> Iterator[None]:
    """Prevent Ctrl-C from interrupting the last line about the outcome, and the exit after it."""
    if for_good:
        startup.ignore_interrupts()
    if for_good or threading.current_thread() is not threading.main_thread():
        yield
        return
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
