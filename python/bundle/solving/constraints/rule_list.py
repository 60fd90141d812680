"""Lists of rules, made from texts and objects or read from a file."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

from bundle.base.display import Display, Displayed
from bundle.base.paths import numbered_lines
from bundle.base.records import dataclass
from bundle.errors import InputError, brief, shown
from bundle.solving.constraints.rules import Bounds, Fixed, On, Prior, Ratio, Rule, Share, Target


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


# Parser of the text of a rule.
#
#     RULE    = TARGET ":" CLAUSE
#     TARGET  = ("camera" | "image" | "point") ["s"] SELECTION
#     SELECTION = "*" | ENTRY {"," ENTRY}
#     ENTRY   = id | id "-" id | quoted name of an image, in which * ? [ab] stand for characters
#     CLAUSE  = NAMES "fixed"
#             | NAMES "prior" [VALUE] ("sigma" SIGMA | PERCENT "%")
#             | NAMES "in" "[" number "," number "]"
#             | "share" NAMES
#             | NAME "/" NAME "fixed"
#             | "on" (["level"] "plane" | "line") {number} "sigma" number
#     NAMES   = NAME {"," NAME}
#     VALUE   = number | "[" number "," number "," number "]"
#     SIGMA   = number | number "/" number | "[" number "," number "," number "]"
#
# ``#`` outside quotes begins a comment.

_TOKEN = re.compile(r"[\[\],/%]|[^\s\[\],/%]+")
_NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)
_CLAUSES = (
    "cx,cy fixed, f prior 2 %, k prior 0 sigma 0.01, k in [-0.5, 0.5], share f,k or fx/fy fixed"
)


def parse_rule(text: str, place: str) -> Rule:
    """Parse the text of a rule."""
    try:
        return _Reader(without_comment(text), place).rule()
    except InputError as error:
        message = str(error)
        if not message.startswith(f"{place}: "):
            message = f"{place}: {message}"
        raise InputError(message) from None


def without_comment(text: str) -> str:
    """Return the text before the first # outside quotes."""
    return text[: _find("#", text)]


def _find(wanted: str, text: str) -> int:
    """Return the index of a character outside quotes; the length of the text without one."""
    quote = ""
    for place, character in enumerate(text):
        if character in "\"'" and quote in ("", character):
            quote = "" if quote else character
        if character == wanted and not quote:
            return place
    return len(text)


class _Reader:
    def __init__(self, text: str, place: str) -> None:
        self._text, self._place = text.strip(), place
        colon = _find(":", text)
        if colon == len(text):
            raise InputError(
                f'expected TARGET: RULE such as "camera 3: cx,cy fixed", found {brief(self._text)}'
            )
        self._target = Target.of(text[:colon])
        self._clause = text[colon + 1 :].strip()
        self._tokens: list[str] = _TOKEN.findall(self._clause)

    def rule(self) -> Rule:
        rule = self._read()
        if self._tokens:
            raise InputError(f"expected the end of the rule, found {brief(self._rest())}")
        return rule

    def _read(self) -> Rule:
        if self._word() == "share":
            self._take()
            return Share(self._target, self._names(), place=self._place)
        if self._word() == "on":
            self._take()
            shape, given = self._name(), list[float]()
            if shape == "level":
                shape += f" {self._name()}"
            while self._tokens and self._word() != "sigma":
                given.append(self._number())
            self._expect("sigma")
            return On(self._target, (shape,), tuple(given), self._number(), place=self._place)
        names = self._names()
        if self._word() == "/":
            self._take()
            names = (*names, *self._names())
            self._expect("fixed")
            return Ratio(self._target, names, place=self._place)
        verb = self._word()
        if verb == "fixed":
            self._take()
            return Fixed(self._target, names, place=self._place)
        if verb == "prior":
            self._take()
            return self._prior(names)
        if verb == "in":
            self._take()
            numbers = self._list(infinite=True)
            if len(numbers) != 2:
                raise InputError(f"expected [lower, upper], found {len(numbers)} numbers")
            return Bounds(self._target, names, *numbers, place=self._place)
        raise InputError(f"expected a rule such as {_CLAUSES}, found {brief(self._clause)}")

    def _prior(self, names: tuple[str, ...]) -> Prior:
        make: Callable[..., Prior] = Prior
        numbers: list[float | tuple[float, ...]] = []
        while self._tokens and self._word() not in ("sigma", "%"):
            numbers.append(self._list() if self._word() == "[" else self._number())
        at_end = not self._tokens
        word = self._take() if not at_end else ""
        if word == "%":
            if len(numbers) not in (1, 2):
                raise InputError(f"expected prior [VALUE] PERCENT %, found {brief(self._clause)}")
            value = numbers[0] if len(numbers) == 2 else None
            return make(self._target, names, value, None, numbers[-1], place=self._place)
        if at_end or len(numbers) > 1:
            raise InputError(
                "expected prior [VALUE] sigma SIGMA or prior [VALUE] PERCENT %, found "
                f"{brief(self._clause)}"
            )
        sigma = self._list() if self._word() == "[" else self._number()
        value_of = numbers[0] if numbers else None
        if self._word() == "/":
            self._take()
            return make(self._target, names, value_of, (sigma, self._number()), place=self._place)
        if self._word() == "%":
            self._take()
            return make(self._target, names, value_of, None, sigma, place=self._place)
        return make(self._target, names, value_of, sigma, place=self._place)

    def _names(self) -> tuple[str, ...]:
        names = [self._name()]
        while self._word() == ",":
            self._take()
            names.append(self._name())
        return tuple(names)

    def _name(self) -> str:
        word = self._word()
        if not _NAME.fullmatch(word):
            found = brief(word) if word else "none"
            raise InputError(
                f"expected names of parameters and a rule, such as {_CLAUSES}, found {found}"
            )
        return self._take()

    def _list(self, *, infinite: bool = False) -> tuple[float, ...]:
        self._expect("[")
        numbers = [self._number(infinite=infinite)]
        while self._word() == ",":
            self._take()
            numbers.append(self._number(infinite=infinite))
        self._expect("]")
        return tuple(numbers)

    def _number(self, *, infinite: bool = False) -> float:
        word = self._word()
        try:
            number = float(word) if "_" not in word else math.nan
        except ValueError:
            number = math.nan
        if math.isnan(number) or (math.isinf(number) and not infinite):
            kind = "a number" if infinite else "a finite number"
            raise InputError(f"expected {kind}, found {brief(word) if word else 'none'}")
        self._take()
        return number

    def _expect(self, word: str) -> None:
        if self._word() != word:
            found = brief(self._word()) if self._tokens else "the end"
            raise InputError(f"expected {word}, found {found}")
        self._take()

    def _word(self) -> str:
        return self._tokens[0] if self._tokens else ""

    def _take(self) -> str:
        return self._tokens.pop(0)

    def _rest(self) -> str:
        return " ".join(self._tokens)
