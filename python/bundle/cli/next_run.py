"""Flags of this run that the next command of a finding repeats.

The parser records the words that are values of a flag (``Parser.taken``), so no word is guessed to
be INPUT, a flag or a value.
"""

from __future__ import annotations

import argparse

from bundle.georeference.measurements import ROWS

DROPPED = ("output", "json", "html", "quiet", "verbose", "check_gradients")
"""Arguments about the files and the output of a run, which do not affect the model."""
CHECKPOINTS = {"resume": "--checkpoint"}
"""A checkpoint belongs to the options of its run: the next run begins it anew."""


def repeated_flags(arguments: argparse.Namespace) -> tuple[str, ...]:
    """Return the flags of a run with their values, without those about its output."""
    reads_images = any(
        row.from_photographs and getattr(arguments, row.source, None) == row.from_photographs
        for row in ROWS
    )
    dropped = DROPPED if reads_images else (*DROPPED, "images")
    words: dict[int | str, tuple[str, ...]] = {}
    for place, (action, values) in enumerate(arguments.taken):
        if not action.option_strings or action.dest in dropped:
            continue
        flag = CHECKPOINTS.get(action.dest, action.option_strings[-1])
        if isinstance(action, argparse.BooleanOptionalAction):
            flag = action.option_strings[0 if getattr(arguments, action.dest) else -1]
        # Only an argument that collects its values has an effect more than once.
        collects = isinstance(action, argparse._AppendAction)
        words[place if collects else flag] = _words(flag, values)
    return tuple(word for one in words.values() for word in one)


def _words(flag: str, values: list[str]) -> tuple[str, ...]:
    if len(values) == 1 and values[0].startswith("-"):
        return (f"{flag}={values[0]}",)
    return (flag, *values)
