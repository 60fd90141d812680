"""Flags of this run that the next command of a finding repeats."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

__all__ = ["Arguments", "repeated_flags"]

DROPPED = {"-o": 1, "--output": 1, "--json": 1, "--html": 1, "--checkpoint": 1, "--resume": 1}
DROPPED |= {"--quiet": 0, "--verbose": 0, "--check-gradients": 0}
"""Flags about the files and the output of a run, with the number of their values."""


class Arguments(argparse.Namespace):
    """Arguments of a command, and the words that they were parsed from."""

    __slots__ = ("words",)  # no argument: vars() does not list it

    def __init__(self, words: Sequence[str]) -> None:
        super().__init__()
        self.words = words


def repeated_flags(arguments: argparse.Namespace) -> tuple[str, ...]:
    """Return the words after the command without INPUT and without flags about output."""
    words: Sequence[str] = getattr(arguments, "words", ())[1:]
    kept: list[str] = []
    inputs = [str(arguments.input)] if hasattr(arguments, "input") else list(arguments.inputs)
    skipped = 0
    for word in words:
        name = word.split("=")[0]
        if skipped:
            skipped -= 1
        elif name in DROPPED:
            skipped = DROPPED[name] if name == word else 0
        elif word in inputs and not (kept and kept[-1].startswith("--") and "=" not in kept[-1]):
            inputs.remove(word)
        else:
            kept.append(word)
    reads_images = {"--gps", "--orientations", "--velocities"} & set(kept)
    return tuple(kept if reads_images else _without_images(kept))


def _without_images(words: list[str]) -> list[str]:
    """Return words without the folder of photographs, which only EXIF positions and pages need."""
    if "--images" not in words:
        return words
    place = words.index("--images")
    return words[:place] + words[place + 2 :]
