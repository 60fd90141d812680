"""Parser of the command line: help, config files, one-line errors with suggestions."""

from __future__ import annotations

import argparse
import re
import shlex
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple, NoReturn

from bundle.cli.error_lines import print_out
from bundle.errors import InputError, brief, nearest, shown

HELP_COLUMN, WIDEST = 28, 100
_NUMBERS: Mapping[Any, str] = {int: "a whole number", float: "a number"}
MOST_FLAGS = 30  # flags of a command up to which ``--help`` shows all of them


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


class HelpAll(argparse.Action):
    """Action that prints the help with all options and exits."""

    def __call__(self, parser: Any, *_: Any) -> None:
        """Print the help."""
        parser._print_message(parser.format_help())
        parser.exit()


class Parser(argparse.ArgumentParser):
    """Argument parser that raises InputErrors.

    An unknown flag is reported before a missing one. A user who misspells ``--output`` sees the
    misspelling, not that ``--output`` is required.

    Args:
        declare: function that adds the arguments when they are first needed.
        explain: function that returns the message about an unknown flag or word.
        spellings: commands by other words that users type for them.
        **settings: arguments of ``argparse.ArgumentParser``.

    Attributes:
        taken: arguments in the order of the words, each with the words that were its values.
        config: file of --config in the last command line, or None.
    """

    def __init__(
        self,
        *,
        declare: Callable[[Parser], None] | None = None,
        explain: Callable[[str], str] | None = None,
        spellings: Mapping[str, str] | None = None,
        **settings: Any,
    ) -> None:
        super().__init__(allow_abbrev=False, formatter_class=_Formatter, **settings)
        self.spellings = spellings or {}
        self._declare = declare
        self.taken: list[tuple[argparse.Action, list[str]]] = []
        self.check: Callable[[Sequence[argparse.Action], argparse.Namespace], None] | None = None
        self.explain = explain or (lambda found: f"unrecognized arguments: {found}")
        self.config: Config | None = None

    def declared(self) -> Parser:
        """Return this parser with all its arguments."""
        declare, self._declare = self._declare, None
        if declare is not None:
            declare(self)
        return self

    def print_help(self, file: Any = None) -> None:
        """Print the help; if there are many flags, those with a ``use``, in that order."""
        flags = [action for action in self._actions if action.option_strings]
        used = [action for action in flags if vars(action).get("use")]
        if len(flags) <= MOST_FLAGS or not used:
            super().print_help(file)
            return
        formatter = self._get_formatter()
        formatter.add_usage(self.usage, self._actions, self._mutually_exclusive_groups)
        formatter.add_text(self.description)
        helps = [action for action in flags if action.nargs == 0 and action not in used][:2]
        used.sort(key=lambda action: vars(action)["use"])
        for title, shown_here in (
            ("arguments", [action for action in self._actions if not action.option_strings]),
            (f"most used of {len(flags)} options", [*used, *helps]),
        ):
            formatter.start_section(title)
            formatter.add_arguments(shown_here)
            formatter.end_section()
        self._print_message(formatter.format_help(), file)

    def error(self, message: str) -> NoReturn:
        """Raise the error as one line that also refers to the help."""
        with naming_config(self.config):
            words = shown(message.removeprefix("argument "))
            raise InputError(f"{words} (see {self.prog} --help)")

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
        self.config = None
        words = self._with_config(list(args or ()))
        required = [action for action in self._actions if action.required]
        for action in required:  # the base class does not say which words it could not use
            action.required = False
        try:
            parsed, rest = super().parse_known_args(words, namespace)
        finally:
            for action in required:
                action.required = True
        missing = [action for action in required if action not in dict(self.taken)]
        if rest and (rest[0].startswith("-") or not missing):
            self.error(self.explain(rest[0]))
        if missing:
            names = ", ".join(str(argparse._get_action_name(action)) for action in missing)
            hint = ""
            if rest and len(missing) == 1:
                hint = f"; did you mean {missing[0].option_strings[0]} {shlex.quote(rest[0])}?"
            self.error(f"the following arguments are required: {names}{hint}")
        if self.check is not None:
            with naming_config(self.config):
                self.check(self._actions, parsed)
        if "--config" in self._option_string_actions:
            parsed.config = self.config
        return parsed, rest

    def _with_config(self, words: list[str]) -> list[str]:
        """Return the words after those of the file of --config; flags replace its entries."""
        end = words.index("--") if "--" in words else len(words)
        flags = [word.partition("=") for word in words[:end]]
        at = max((k for k, (flag, _, _) in enumerate(flags) if flag == "--config"), default=-1)
        actions = self._option_string_actions
        if at < 0 or "--config" not in actions:
            return words
        path = flags[at][2] if flags[at][1] else "".join(words[at + 1 : at + 2])
        if not path:
            return words
        given = {actions[flag].dest for flag, _, _ in flags if flag in actions}
        lines, replaced, found = dict[str, int](), [], []
        for key, value, line in entries(path, self.prog.rpartition(" ")[2]):
            flag = f"--{key}"
            action = actions.get(flag)
            place = f"{shown(path)}:{line}"
            if action is None or action.dest in ("help", "help_all", "config"):
                keys = [name[2:] for name in actions if name.startswith("--")]
                raise InputError(f"{place}: there is no key {brief(key)}{nearest(key, keys)}")
            as_words = _as_words(action, flag, value, place)
            if action.dest in given:
                replaced.append(flag)
            else:
                lines[flag] = line
                found += as_words
        self.config = Config(path, lines, tuple(replaced))
        return [*found, *words]

    def _get_values(self, action: argparse.Action, arg_strings: list[str]) -> Any:
        """Convert the words of an argument, and record them."""
        self.taken.append((action, list(arg_strings)))
        return super()._get_values(action, arg_strings)

    def _get_value(self, action: argparse.Action, arg_string: str) -> Any:
        """Convert a word; unlike the base class, name the expected kind of number."""
        try:
            return super()._get_value(action, arg_string)
        except argparse.ArgumentError as error:
            if action.type in _NUMBERS:
                error.message = f"expected {_NUMBERS[action.type]}, found {brief(arg_string)}"
            raise

    def _match_argument(self, action: argparse.Action, arg_strings_pattern: str) -> int:
        """Return the number of values; unlike the base class, name values that are missing."""
        try:
            return super()._match_argument(action, arg_strings_pattern)
        except argparse.ArgumentError as error:
            shown_here = [self._get_formatter()._format_args(action, action.dest.upper())]
            error.message += f": {', '.join(map(str, action.choices or shown_here))}"
            raise

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
        names = {str(name): str(name) for name in action.choices}
        is_command = isinstance(action, argparse._SubParsersAction)
        near = nearest(str(value), {**names, **self.spellings} if is_command else names)
        expected = f"one of {', '.join(names)}, found {str(value)!r}{near}"
        if is_command:
            self.error(f"expected a command, {expected}")
        raise argparse.ArgumentError(action, f"expected {expected}")


# Config files: TOML whose keys are the flags of a command without their hyphens.
#
# Keys at the top are for any command; the table [refine] is for `bundle refine` alone. The entries
# become words before those of the command line, so that every check, report and next command treats
# them as flags.


class Config(NamedTuple):
    """Config file of a command line."""

    path: str  # path of the file
    lines: Mapping[str, int]  # line of each flag that it gives
    replaced: tuple[str, ...]  # flags of the file that the command line replaces

    @property
    def fact(self) -> str:
        """Flags that come from the file, and those that the command line replaces."""
        given = ", ".join(self.lines) or "no flag"
        replaced = f"; {', '.join(self.replaced)} replaced by flags" if self.replaced else ""
        return f"{given} from {shown(self.path)}{replaced}"


@contextmanager
def naming_config(config: Config | None) -> Iterator[None]:
    """Put file and line before an error about a flag that a config file gives."""
    try:
        yield
    except InputError as error:
        for flag, line in config.lines.items() if config is not None else ():
            if config is not None and re.search(rf"(?<![\w-]){flag}(?![\w-])", str(error)):
                raise InputError(f"{shown(config.path)}:{line}: {error}") from None
        raise


def entries(path: str, command: str) -> Iterator[tuple[str, Any, int]]:
    """Yield key, value and line of the entries of a config file for a command.

    Raises:
        InputError: the file is not TOML.
        OSError: the file cannot be read.
    """
    import tomllib  # for --config only

    from bundle.base.paths import numbered_lines
    from bundle.cli.commands import COMMANDS

    lines = numbered_lines(path)
    try:
        content = tomllib.loads("\n".join(line.rstrip("\r") for _, line in lines))
    except tomllib.TOMLDecodeError as error:
        place = re.search(r" \(at line (\d+)", str(error))
        found = f"{shown(path)}:{place[1] if place else len(lines)}"
        reason = str(error).partition(" (at ")[0]
        raise InputError(f"{found}: expected TOML, found an error: {reason}") from None
    table, places = "", dict[tuple[str, str], int]()
    for number, line in lines:
        if header := re.match(r"\s*\[([\w-]+)\]", line):
            table = header[1]
            places.setdefault(("", table), number)
        elif entry := re.match(r"""\s*["']?([\w-]+)["']?\s*[=.]""", line):
            places.setdefault((table, entry[1]), number)
    for key, value in content.items():
        if key in COMMANDS and isinstance(value, dict):
            own = value.items() if key == command else ()
            yield from ((name, one, places.get((key, name), 1)) for name, one in own)
        else:
            yield key, value, places.get(("", key), 1)


def _as_words(action: argparse.Action, flag: str, value: Any, place: str) -> list[str]:
    """Return an entry of a config file as words of the command line."""
    is_switch = action.nargs == 0 or isinstance(action, argparse.BooleanOptionalAction)
    values = value if isinstance(value, list) and not is_switch else [value]
    kinds: tuple[type, ...] = (int, float) if action.type in (int, float) else (int, float, str)
    expected = "true or false" if is_switch else "text" if str in kinds else "numbers"
    for one in values:
        if not isinstance(one, kinds) or isinstance(one, bool) != is_switch:
            raise InputError(f"{place}: {flag[2:]}: expected {expected}, found {brief(one)}")
    if isinstance(action, argparse.BooleanOptionalAction):
        return [action.option_strings[0 if value == (flag == action.option_strings[0]) else -1]]
    if is_switch:
        return [flag] if value is True else []
    if isinstance(action, argparse._AppendAction):
        return [f"{flag}={one}" for one in values]
    if action.nargs is not None:
        return [flag, *map(str, values)]
    return [f"{flag}={','.join(map(str, values))}"]


ELSEWHERE = {
    "--loss": "--robust --robust-kernel --kernel --loss-function",
    "--gps-sigma": "--accuracy --gps-accuracy",
    "--gcp": "--gcps --markers --control-points --ground-control --ground-control-points",
    "--gcp-sigma": "--gcp-accuracy --marker-accuracy",
    "--fix-cameras": "--fix-intrinsics",
    "--share-cameras": "--share-intrinsics --shared-intrinsics --single-camera --share",
    "--share": "--share-intrinsics --shared-intrinsics --single-camera --share-cameras",  # validate
    "--html": "--report --page",
    "report -o": "--html --page",
    "convert OUTPUT": "-o --output",
    "synth OUTPUT": "-o --output",
    "--camera-model": "--lens --lens-model --distortion-model",
    "--rounds": "--filter --filter-outliers --outliers",
}
"""Flags of other tools (g2o, GTSAM, Metashape, COLMAP) and commands, by the flag or argument that
means the same here; that of one command after its name."""


def unknown_flag(found: str, command: str, flags: Mapping[str, Iterable[str]]) -> str:
    """Return the message about an unknown flag, with the flag that was probably meant.

    ``found`` is as typed, possibly with its value; ``command`` is "" before any command.
    """
    name, _, _ = found.partition("=")
    if not name.startswith("-"):
        return f"unrecognized arguments: {found}"
    arguments = (key.partition(" ")[2] for key in ELSEWHERE if key.startswith(f"{command} "))
    own = [*flags.get(command, ()), *arguments]
    named = {key.removeprefix(f"{command} "): said for key, said in ELSEWHERE.items()}
    words = {flag + end: said for flag, said in named.items() for end in ("", "s", "es")}
    spellings = {word: flag for flag in own for word in [flag, *words.get(flag, "").split()]}
    meant = nearest(name, spellings)
    others = {other: tuple(names) for other, names in flags.items() if other != command}
    having = [other for other, names in others.items() if name in names]
    if having and name not in spellings:
        rest = [f"{len(having) - 3} others"] if len(having) > 4 else having[3:]
        *most, last = having[:3] + rest
        meant += f"; {', '.join(most)} and {last} have {name}" if most else f"; {last} has {name}"
    elif not meant:
        near = ((other, nearest(name, names)) for other, names in others.items())
        meant = next((f"{words[:-1]} of {other}?" for other, words in near if words), "")
    return f"unrecognized arguments: {found}{meant}"
