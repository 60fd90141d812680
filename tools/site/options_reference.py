"""The directives ``options`` and ``commands``: all options and flags, read from the code.

``{options}`` has a section for each option class: its fields with flag, default and range.
``{commands}`` has a section for each command: its arguments by groups.
"""

from __future__ import annotations

import argparse
import dataclasses
import inspect
import sys
from collections.abc import Iterable
from typing import Any

from docutils import nodes
from sphinx.util.docutils import SphinxDirective
from tools.site.derivations import text_nodes

from bundle.cli.main import COMMANDS, command_parser
from bundle.interface.option_class import OPTION_CLASSES, option_class


def entry(names: Iterable[str], anchor: str, text: str, details: str = "") -> nodes.Node:
    """Return an item of a definition list: names as code, text, details on a line of their own."""
    item = nodes.definition_list_item()
    term = nodes.term(ids=[anchor])
    for number, name in enumerate(names):
        term += [nodes.Text(" · ")] if number else []
        term += nodes.literal(name, name)
    meaning = nodes.definition("", nodes.paragraph("", text))
    if details:
        meaning += nodes.paragraph("", details, classes=["details"])
    item += [term, meaning]
    return item


def range_of(metadata: Any) -> str:
    """Return the numbers that an option may be, in words, "" for all."""
    words = {"minimum": "at least", "above": "above", "below": "below", "maximum": "at most"}
    bounds = [
        f"{word} {metadata[key]:g}" for key, word in words.items() if metadata[key] is not None
    ]
    return ", ".join(bounds)


def field_entry(kind: type, field: Any) -> nodes.Node:
    """Return what an option class says of one of its fields."""
    metadata = field.metadata
    facts = [f"Default {field.default!r}"]
    if metadata["choices"]:
        facts.append("one of " + ", ".join(metadata["choices"]))
    facts += [range_of(metadata)] if range_of(metadata) else []
    if metadata["only_with"]:
        other, values = metadata["only_with"]
        facts.append(f"only with {other} = {' or '.join(map(str, values))}")
    names = [field.name, metadata["flag"]]
    anchor = nodes.make_id(f"{kind.__name__} {field.name}")
    return entry(names, anchor, sentence(metadata["help"]), "; ".join(facts) + ".")


def sentence(text: str) -> str:
    """Return a text with a capital and a full stop, its blanks as one."""
    text = " ".join(text.split())
    return text[:1].upper() + text[1:] + ("" if text.endswith((".", ":")) else ".")


class OptionClasses(SphinxDirective):
    """``{options}``: a section for each option class."""

    def run(self) -> list[nodes.Node]:
        """Return the sections, each with the list of its fields."""
        self.env.note_dependency(__file__)
        sections: list[nodes.Node] = []
        for name in sorted(OPTION_CLASSES, key=lambda name: (name != "SolveOptions", name)):
            kind: Any = option_class(name)
            self.env.note_dependency(inspect.getfile(kind))
            section = nodes.section(ids=[nodes.make_id(name)], names=[name])
            section += nodes.title("", name)
            section += nodes.paragraph("", "", *text_nodes(summary(kind)))
            found = nodes.definition_list(classes=["options"])
            found += [field_entry(kind, field) for field in dataclasses.fields(kind)]
            section += found
            sections.append(section)
        return sections


def summary(kind: type) -> str:
    """Return the first paragraph of the docstring of a class."""
    return " ".join((inspect.getdoc(kind) or "").partition("\n\n")[0].split())


def invocation(action: argparse.Action) -> list[str]:
    """Return how an argument is written: its flags, each with its placeholder, or its name."""
    values = action.metavar if action.metavar is not None else (action.dest or "").upper()
    value = " ".join(values) if isinstance(values, tuple) else values
    if not action.option_strings:
        return [f"{value} ..." if action.nargs in ("+", "*") else value]
    return [flag if action.nargs == 0 else f"{flag} {value}" for flag in action.option_strings]


class Commands(SphinxDirective):
    """``{commands}``: a section for each command."""

    def run(self) -> list[nodes.Node]:
        """Return the sections, each with a list for each group of arguments."""
        parsers = command_parser().commands()
        sections: list[nodes.Node] = []
        for name in COMMANDS:
            title = f"bundle {name}"
            section = nodes.section(ids=[nodes.make_id(title)], names=[title])
            section += nodes.title("", title)
            section += arguments_of(name, parsers[name])
            sections.append(section)
        for module in [__name__, *(name for name in sys.modules if name.startswith("bundle.cli."))]:
            self.env.note_dependency(inspect.getfile(sys.modules[module]))
        return sections


def arguments_of(name: str, parser: argparse.ArgumentParser) -> list[nodes.Node]:
    """Return the description of a command and its arguments by groups."""
    found: list[nodes.Node] = [nodes.paragraph("", sentence(parser.description or ""))]
    for group in parser._action_groups:
        actions = [
            action
            for action in group._group_actions
            if not {"--help", "--help-all"} & set(action.option_strings)
        ]
        if not actions:
            continue
        title = {"positional arguments": "Arguments", "options": "Options"}.get(
            group.title or "", sentence(group.title or "").rstrip(".")
        )
        found.append(nodes.rubric("", title))
        if group.description:
            found.append(nodes.paragraph("", group.description))
        listed = nodes.definition_list(classes=["options"])
        for action in actions:
            anchor = nodes.make_id(f"{name} {(action.option_strings or [action.dest])[-1]}")
            text = parser._get_formatter()._expand_help(action)
            listed += entry(invocation(action), anchor, sentence(text))
        found.append(listed)
    return found


def setup(app: Any) -> dict[str, Any]:
    """Register the directives."""
    app.add_directive("options", OptionClasses)
    app.add_directive("commands", Commands)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
