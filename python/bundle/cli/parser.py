"""Parser of the command line: one-line errors with suggestions, and help."""

from __future__ import annotations

import argparse
import sys
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NoReturn

from bundle.cli.standard_streams import print_out
from bundle.errors import InputError, nearest, shown

HELP_COLUMN, WIDEST = 28, 100


class _Formatter(argparse.HelpFormatter):
    """Help formatter that breaks lines only at blanks: "principal-point" stays one word."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=HELP_COLUMN, width=WIDEST)

    def format_help(self) -> str:
        """Return the help in the width of the terminal; each flag makes a formatter, too."""
        import shutil  # late: it loads three compressors

        self._width = min(shutil.get_terminal_size().columns, WIDEST)
        self._max_help_position = min(HELP_COLUMN, max(self._width - 20, 4))
        return super().format_help()

    def _split_lines(self, text: str, width: int) -> list[str]:
        words = " ".join(text.split())
        return textwrap.wrap(words, width, break_on_hyphens=False, break_long_words=False)


class Parser(argparse.ArgumentParser):
    """Argument parser that raises InputErrors.

    An unknown flag is reported before a missing one. A user who misspells ``--output`` sees the
    misspelling, not that ``--output`` is required.

    Args:
        declare: function that adds the arguments when they are first needed.
        explain: function that returns the message about an unknown flag or word.
        **settings: arguments of ``argparse.ArgumentParser``.

    Attributes:
        taken: arguments in the order of the words, each with the words that were its values.
    """

    def __init__(
        self,
        *,
        declare: Callable[[Parser], None] | None = None,
        explain: Callable[[str], str] | None = None,
        **settings: Any,
    ) -> None:
        super().__init__(allow_abbrev=False, formatter_class=_Formatter, **settings)
        self._declare = declare
        self.taken: list[tuple[argparse.Action, list[str]]] = []
        self.check: Callable[[Sequence[argparse.Action], argparse.Namespace], None] | None = None
        self.explain = explain or (lambda found: f"unrecognized arguments: {found}")

    def declared(self) -> Parser:
        """Return this parser with all its arguments."""
        declare, self._declare = self._declare, None
        if declare is not None:
            declare(self)
        return self

    def error(self, message: str) -> NoReturn:
        """Raise the error as one line that also refers to the help."""
        raise InputError(f"{shown(message)} (see {self.prog} --help)")

    def _print_message(self, message: str, file: Any = None) -> None:
        """Print help and versions; unlike the base class, raise an error if printing fails."""
        if file is sys.stderr:
            super()._print_message(message, file)
        else:
            print_out(message)

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parse; unlike the base class, refuse unknown flags and words."""
        flags = self.declared().flags()
        self.taken.clear()
        for word in args or ():
            if word == "--" or (self._subparsers is not None and not word.startswith("-")):
                break  # the following words are no flags, or flags of a command
            if word.startswith("--") and word.partition("=")[0] not in flags:
                self.error(self.explain(word))
        parsed, rest = super().parse_known_args(args, namespace)
        if rest:
            self.error(self.explain(rest[0]))
        if self.check is not None:
            self.check(self._actions, parsed)
        return parsed, rest

    def _get_values(self, action: argparse.Action, arg_strings: list[str]) -> Any:
        """Convert the words of an argument, and record them."""
        self.taken.append((action, list(arg_strings)))
        return super()._get_values(action, arg_strings)

    def flags(self) -> tuple[str, ...]:
        """Return all flags."""
        return tuple(self.declared()._option_string_actions)

    def flags_by_name(self) -> dict[str, str]:
        """Return the flag of each argument that has one; for a switch, its enabling flag."""
        actions = [action for action in self.declared()._actions if action.option_strings]
        switches = argparse.BooleanOptionalAction
        return {a.dest: a.option_strings[0 if isinstance(a, switches) else -1] for a in actions}

    def commands(self) -> dict[str, Parser]:
        """Return the parsers of the commands by name, with all their arguments."""
        found: dict[str, Parser] = {}
        for action in self._subparsers._group_actions if self._subparsers is not None else ():
            if isinstance(action, argparse._SubParsersAction):
                found.update({name: parser.declared() for name, parser in action.choices.items()})
        return found

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is None or value in action.choices:
            return
        if isinstance(action, argparse._SubParsersAction):
            self.error(unknown_command(value, action.choices))
        raise argparse.ArgumentError(action, unknown_value(str(value), map(str, action.choices)))


def unknown_command(found: str, commands: Iterable[str]) -> str:
    """Return the message about an unknown command."""
    names = list(commands)
    listed = ", ".join(names)
    return f"expected a command, one of {listed}, found {found!r}{nearest(found, names)}"


def unknown_value(found: str, values: Iterable[str]) -> str:
    """Return the message about an invalid value of a choice."""
    names = list(values)
    listed = ", ".join(names)
    return f"invalid choice: expected one of {listed}, found {found!r}{nearest(found, names)}"


def unknown_flag(found: str, command: str, flags: Mapping[str, Iterable[str]]) -> str:
    """Return the message about an unknown flag, with the flag that was probably meant.

    ``found`` is as typed, possibly with its value; ``command`` is "" before any command.
    """
    name, _, _ = found.partition("=")
    meant = nearest(name, _long(flags.get(command, ())))
    others = {other: _long(names) for other, names in flags.items() if other != command}
    having = [other for other, names in others.items() if name in names]
    if having:
        listed = " and ".join(filter(None, [", ".join(having[:3][:-1]), having[:3][-1]]))
        meant += f"; {listed} {'has' if len(having) == 1 else 'have'} {name}"
    elif not meant:
        near = ((other, nearest(name, names)) for other, names in others.items())
        meant = next((f"{words[:-1]} of {other}?" for other, words in near if words), "")
    return f"unrecognized arguments: {found}{meant}"


def _long(flags: Iterable[str]) -> list[str]:
    return [flag for flag in flags if flag.startswith("--")]
