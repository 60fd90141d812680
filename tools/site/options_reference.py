"""The directives ``options`` and ``command``: what can be asked for, read from the code.

``{options} SolveOptions`` lists the fields of an option class of bundle, with flag, default and
range. ``{command} refine`` lists the arguments of a command of the command line, by its groups;
``{commands}`` has a section for each command.
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

import bundle
from bundle.cli.main import COMMANDS, command_parser


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


class OptionClass(SphinxDirective):
    """``{options} SolveOptions``."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the list of its fields."""
        kind: Any = getattr(bundle, self.arguments[0], None)
        if not isinstance(kind, type) or not dataclasses.is_dataclass(kind):
            raise self.error(f"options: expected an option class, found {self.arguments[0]}")
        self.env.note_dependency(inspect.getfile(kind))
        self.env.note_dependency(__file__)
        found = nodes.definition_list(classes=["options"])
        found += [field_entry(kind, field) for field in dataclasses.fields(kind)]
        return [found]


def invocation(action: argparse.Action) -> list[str]:
    """Return how an argument is written: its flags, each with its placeholder, or its name."""
    values = action.metavar if action.metavar is not None else (action.dest or "").upper()
    value = " ".join(values) if isinstance(values, tuple) else values
    if not action.option_strings:
        return [f"{value} ..." if action.nargs in ("+", "*") else value]
    return [flag if action.nargs == 0 else f"{flag} {value}" for flag in action.option_strings]


class Command(SphinxDirective):
    """``{command} refine``."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return its groups of arguments, each a section."""
        name = self.arguments[0]
        if name not in COMMANDS:
            raise self.error(f"command: expected one of {', '.join(COMMANDS)}, found {name}")
        parser = command_parser().commands()[name]
        for module in [__name__, *(name for name in sys.modules if name.startswith("bundle.cli."))]:
            self.env.note_dependency(inspect.getfile(sys.modules[module]))
        found: list[nodes.Node] = [nodes.paragraph("", sentence(parser.description or ""))]
        for group in parser._action_groups:
            actions = [
                action for action in group._group_actions if "--help" not in action.option_strings
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


class Commands(SphinxDirective):
    """``{commands}``: a section for each command."""

    def run(self) -> list[nodes.Node]:
        """Return the sections."""
        sections: list[nodes.Node] = []
        for name in COMMANDS:
            title = f"bundle {name}"
            section = nodes.section(ids=[nodes.make_id(title)], names=[title])
            section += nodes.title("", title)
            section += Command(
                "command", [name], {}, self.content, self.lineno, self.content_offset,
                self.block_text, self.state, self.state_machine,
            ).run()  # fmt: skip
            sections.append(section)
        return sections


def setup(app: Any) -> dict[str, Any]:
    """Register the directives."""
    app.add_directive("options", OptionClass)
    app.add_directive("command", Command)
    app.add_directive("commands", Commands)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
