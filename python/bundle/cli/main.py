"""The command `bundle`: finds the subcommand and turns every expected error into one line."""

from __future__ import annotations

import gc
import importlib
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import ModuleType
from typing import Any

from bundle import __version__
from bundle.cli import startup
from bundle.cli.error_lines import (
    EXIT_BAD_INPUT,
    EXIT_DONE,
    EXIT_INTERRUPTED,
    describe_error,
    is_interruption,
)
from bundle.cli.parser import Parser, add_common_arguments
from bundle.cli.standard_streams import complain, open_missing_streams, release_broken_streams
from bundle.cli.suggestions import unknown_flag
from bundle.errors import end_in_one_line
from bundle.io.atomic import atomic_write as atomic

__all__ = ["main"]

COMMANDS = (
    "info",
    "inspect",
    "refine",
    "compare",
    "check",
    "covariance",
    "diagnose",
    "align",
    "merge",
    "report",
    "vio",
    "convert",
    "synth",
)
"""Subcommands, in the order of the help; each a module with NAME, HELP, add_arguments and run."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code; ``bundle.cli.error_lines`` has them all."""
    open_missing_streams()
    end_in_one_line()
    with atomic.recording() as written, _noting_recoveries():
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
            if argv is None:  # nothing is left but the interpreter's end, which may take a moment
                startup.ignore_interrupts()
            release_broken_streams()
    if argv is None:
        gc.freeze()  # the interpreter need not search for garbage what the system takes back
    return code


def _run(words: list[str]) -> int:
    # The other commands take a while to import, and are only needed to be listed.
    known = [word for word in words[:1] if word in COMMANDS]
    parser = _parser(known or COMMANDS)
    startup.done()
    code = EXIT_DONE
    try:
        if words:
            arguments = parser.parse_args(words)
            code = arguments.run(arguments)
        else:
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


def _parser(names: Sequence[str]) -> Parser:
    """Return a parser that knows some of the commands."""
    flags: dict[str, tuple[str, ...]] = {}

    def unknown(found: str, command: str) -> str:
        if len(flags) < len(COMMANDS):
            others = _parser([name for name in COMMANDS if name not in flags])
            flags.update(_flags(others))
        return unknown_flag(found, command, {name: flags[name] for name in COMMANDS})

    parser = Parser(
        prog="bundle",
        description="Refines structure-from-motion reconstructions and explains the solve.",
        epilog="bundle COMMAND --help tells more.",
        explain=lambda found: unknown(found, ""),
    )
    parser.add_argument("--version", action="version", version=f"bundle {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name in names:
        command = _module(name)
        subparser = commands.add_parser(
            name,
            help=command.HELP,
            description=command.HELP,
            explain=lambda found, name=name: unknown(found, name),
        )
        command.add_arguments(subparser)
        add_common_arguments(subparser)
        subparser.set_defaults(run=command.run)
        flags[name] = subparser.flags()
    return parser


def _flags(parser: Parser) -> dict[str, tuple[str, ...]]:
    """Return the flags of the commands that a parser knows."""
    return {name: command.flags() for name, command in parser.commands().items()}


def _module(name: str) -> ModuleType:
    return importlib.import_module(f"bundle.cli.{name}")


@contextmanager
def _noting_recoveries() -> Iterator[None]:
    """Print notes on a model, such as that the replacement by a killed run was finished."""
    with warnings.catch_warnings():
        show = warnings.showwarning

        def note(message: Warning | str, category: type[Warning], *where: Any, **how: Any) -> None:
            if issubclass(category, atomic.NoteWarning):
                complain(f"note: {message}")
            else:
                show(message, category, *where, **how)

        warnings.simplefilter("always", atomic.NoteWarning)
        setattr(warnings, "showwarning", note)  # noqa: B010 (the stub knows only functions of its own)
        yield


@contextmanager
def _ignoring_interrupts(for_good: bool) -> Iterator[None]:
    """Let impatience not interrupt the line that says what has happened, nor what follows."""
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
