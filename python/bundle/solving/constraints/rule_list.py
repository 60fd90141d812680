"""List of rules, made from texts and objects or read from a file."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

from bundle.base.display import Display, Displayed
from bundle.base.paths import numbered_lines
from bundle.base.records import dataclass
from bundle.errors import InputError, brief, shown
from bundle.solving.constraints.rule_text import parse_rule, without_comment
from bundle.solving.constraints.rules import Rule


@dataclass(frozen=True, init=False, repr=False)
class Constraints(Displayed):
    """Rules about cameras, images and points, for :func:`bundle.solve`.

    ``docs/constraints.md`` explains them; for instance::

        bundle.Constraints("cameras *: f prior 2 %", 'image "left/*": rotation fixed')
        bundle.Constraints.read("rules.txt")

    Args:
        rules: texts, objects such as :class:`bundle.constraints.Fixed`, and lists of them.

    Raises:
        InputError: an argument is not a rule; the message names it.
    """

    rules: tuple[Rule, ...]

    def __init__(self, *rules: str | Rule | Constraints | Iterable[str | Rule]) -> None:
        given = rules[0] if len(rules) == 1 and not isinstance(rules[0], str | Rule) else rules
        object.__setattr__(self, "rules", rules_of(given))

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Constraints:
        """Read rules from a file with one rule per line; ``#`` begins a comment.

        Raises:
            InputError: the file is not text or a line is not a rule; the message names the line.
            OSError: the file cannot be read.
        """
        return cls(
            tuple(
                parse_rule(line, f"{shown(path)}:{number}")
                for number, line in numbered_lines(path)
                if without_comment(line).strip()
            )
        )

    def __iter__(self) -> Iterator[Rule]:
        return iter(self.rules)

    def __len__(self) -> int:
        return len(self.rules)

    def __add__(self, other: Any) -> Constraints:
        """Return these rules followed by other rules."""
        return Constraints((*self.rules, *rules_of(other)))

    def _display(self) -> Display:
        return Display(
            title="Constraints", facts=tuple((rule.place, str(rule)) for rule in self.rules)
        )


def rules_of(given: Any) -> tuple[Rule, ...]:
    """Return rules given as texts or objects, each with its place.

    Raises:
        InputError: an entry is not a rule.
    """
    if isinstance(given, Constraints):
        return given.rules
    if isinstance(given, str | Rule):
        given = (given,)
    try:
        entries: Sequence[Any] = list(given)
    except TypeError:
        raise InputError(
            f'constraints: expected rules such as "camera 3: f fixed", found {brief(given)}'
        ) from None
    rules: list[Rule] = []
    for number, entry in enumerate(entries):
        place = f"constraints[{number}]"
        if isinstance(entry, str):
            rules.append(parse_rule(entry, place))
        elif isinstance(entry, Rule) and type(entry) is not Rule:
            rules.append(entry if entry.place else replace(entry, place=place))
        elif isinstance(entry, Constraints):
            rules.extend(entry.rules)
        else:
            raise InputError(
                f'{place}: expected a rule such as "camera 3: f fixed", found {brief(entry)}'
            )
    return tuple(rules)
