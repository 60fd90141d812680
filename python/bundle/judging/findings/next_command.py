"""Command line to run next: the command of this run with other options."""

from __future__ import annotations

import shlex
from collections.abc import Sequence

from bundle.base.records import dataclass

__all__ = ["NextCommand"]


@dataclass(frozen=True)
class NextCommand:
    """Paths and flags of a run, from which the next command line is made.

    Attributes:
        source: path of the input.
        target: path of the output.
        given: flags of this run that the next run repeats, as words of a command line.
    """

    source: str = "INPUT"
    target: str = "OUTPUT"
    given: Sequence[str] = ()

    def refine(self, *flags: str) -> str:
        """Return `bundle refine` with the flags of this run and these, which replace the former."""
        replaced = {word for word in flags if word.startswith("--")}
        kept: list[str] = []
        skips = False
        for word in self.given:
            if word.startswith("--"):
                skips = word.split("=")[0] in replaced
            if not skips:
                kept.append(word)
        return shlex.join(["bundle", "refine", self.source, "-o", self.target, *kept, *flags])

    def other(self, command: str, *flags: str) -> str:
        """Return another command on the input."""
        return shlex.join(["bundle", command, self.source, *flags])
