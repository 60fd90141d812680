"""Command line to run next: the command of this run with other options.

A suggested flag replaces the same flag of the run. A flag that may be given several times
(`--set`, a list of rules) is added instead, because each occurrence adds information.
"""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Callable, Iterator, Sequence

from bundle.base.records import dataclass
from bundle.interface.camera_edit_options import RuleOptions

REPEATED = {
    str(field.metadata["flag"])
    for field in dataclasses.fields(RuleOptions)
    if field.metadata["value"] == "several"
}
"""Flags that may be given several times."""


@dataclass(frozen=True)
class NextCommand:
    """Paths and flags of a run, from which the next command line is made."""

    source: str = "INPUT"  # path of the input
    target: str = "OUTPUT"  # path of the output
    given: Sequence[str] = ()  # flags that the next run repeats, each before its values

    def refine(self, *flags: str) -> str:
        """Return `bundle refine` with this run's flags; the given ones replace or extend them."""
        words = self.after(*flags).given
        return shlex.join(["bundle", "refine", self.source, "-o", self.target, *words])

    def after(self, *flags: str) -> NextCommand:
        """Return a NextCommand for a run that has these flags, too."""
        advised = list(_occurrences(flags))
        replaced = {_name(one) for one in advised} - REPEATED
        if "--share-cameras" in replaced and "--split-cameras" in self.given:
            advised = [one for one in advised if _name(one) != "--share-cameras"]
            replaced.add("--split-cameras")  # the input has fewer cameras
        given = list(_occurrences(self.given))
        kept = [one for one in given if _name(one) not in replaced and one not in advised]
        words = tuple(word for one in (*kept, *advised) for word in one)
        return NextCommand(self.source, self.target, words)

    def without(self, flag: str, is_dropped: Callable[[str], bool]) -> NextCommand:
        """Return a NextCommand for a run without some occurrences of a flag, by their values."""
        kept = [
            one
            for one in _occurrences(self.given)
            if one[0] != flag or not is_dropped(" ".join(one[1:]))
        ]
        words = tuple(word for one in kept for word in one)
        return dataclasses.replace(self, given=words)

    def with_flags_of(self, command: str) -> NextCommand:
        """Return a NextCommand for a run that also has the flags of a command."""
        return self.after(*shlex.split(command)[5:])

    def added(self, command: str) -> list[tuple[str, str]]:
        """Return each flag, with its value, that a command has beyond those of this run."""
        given, words = list(_occurrences(self.given)), _occurrences(shlex.split(command)[5:])
        return [(one[0], " ".join(one[1:])) for one in words if one not in given]

    def value(self, flag: str, default: str) -> str:
        """Return the value that this run gives to a flag of one value."""
        for one in _occurrences(self.given):
            if _name(one) == flag:
                return one[0].partition("=")[2] or " ".join(one[1:])
        return default

    def other(self, command: str, *flags: str) -> str:
        """Return a command of another name on the same input."""
        return shlex.join(["bundle", command, self.source, *flags])


def _occurrences(words: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """Yield each flag with its values."""
    starts = [k for k, word in enumerate(words) if word.startswith("--")]
    for first, last in zip(starts, [*starts[1:], len(words)], strict=False):
        yield tuple(words[first:last])


def _name(occurrence: tuple[str, ...]) -> str:
    name = occurrence[0].split("=")[0]
    return name.replace("--no-", "--", 1)
