"""Error messages about unknown commands, flags and values, with suggestions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from bundle.errors import nearest


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

    Args:
        found: flag as typed, possibly with its value: "--solvr=auto".
        command: command of the flag; "" without a command.
        flags: flags of each command.
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
