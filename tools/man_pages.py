"""Write the manual pages of `bundle`, build/man/man1/bundle*.1; run by `make docs`.

The text is that of `bundle COMMAND --help-all`: `man -l build/man/man1/bundle-refine.1` shows it.
"""

from __future__ import annotations

from pathlib import Path

from bundle import __version__
from bundle.cli.main import COMMANDS, command_parser
from bundle.cli.parser import Parser

TARGET = Path(__file__).parents[1] / "build" / "man" / "man1"


def plain(text: str) -> str:
    """Return text in roff, without requests and special characters."""
    text = " ".join(text.split()).replace("\\", "\\e").replace("-", "\\-").replace(",", ",\\:")
    return "\\&" + text if text.startswith((".", "'")) else text


def entries(parser: Parser) -> list[str]:
    """Return a section for each group of arguments, as in the help."""
    formatter = parser._get_formatter()
    lines = []
    for group in parser._action_groups:
        actions = [
            one
            for action in group._group_actions
            for one in getattr(action, "_get_subactions", lambda action=action: [action])()
        ]
        if actions:
            lines.append(f'.SH "{plain(str(group.title).upper())}"')
            lines += [plain(group.description)] if group.description else []
        for action in actions:
            name = plain(formatter._format_action_invocation(action))
            lines += [".TP", f"\\fB{name}\\fR", plain(formatter._expand_help(action))]
    return lines


def page(name: str, parser: Parser, also: str) -> str:
    """Return a manual page; ``also`` names further pages."""
    usage = " ".join(parser.format_usage().removeprefix("usage: ").split())
    lines = [
        f'.TH "{name.upper()}" 1 "" "bundle {__version__}"',
        ".ad l",
        ".nh",
        ".SH NAME",
        f"{plain(name)} \\- {plain(str(parser.description))}",
        ".SH SYNOPSIS",
        plain(usage),
        *entries(parser),
        '.SH "EXIT STATUS"',
        "0: done. 1: no usable solution, or interrupted with a result. 2: bad input or usage. "
        "3: undecided (bundle check). 130: interrupted before there was a result.",
        '.SH "SEE ALSO"',
        plain(also),
    ]
    return "\n".join(lines) + "\n"


def pages() -> dict[str, str]:
    """Return the text of all pages by the name of their file."""
    parser = command_parser()
    found = {"bundle.1": page("bundle", parser, ", ".join(f"bundle-{one}(1)" for one in COMMANDS))}
    for name, one in parser.commands().items():
        found[f"bundle-{name}.1"] = page(f"bundle-{name}", one, "bundle(1)")
    return found


if __name__ == "__main__":
    TARGET.mkdir(parents=True, exist_ok=True)
    for name, text in pages().items():
        (TARGET / name).write_text(text, encoding="utf-8")
