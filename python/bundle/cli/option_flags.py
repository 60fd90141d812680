"""Flags made from the fields of an option class (``bundle.interface.option_fields``), and back."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import re
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

from bundle.errors import InputError
from bundle.model.image_selection import MOST_IDS, find_images, id_range

if TYPE_CHECKING:
    from bundle.interface.options import SolveOptions
    from bundle.model.problem import Problem

__all__ = [
    "WHAT_IS_REFINED",
    "add_options",
    "choice_word",
    "naming_flags",
    "options_given",
    "parse_ids",
    "parse_images",
    "parse_sensors",
    "with_named_images",
]

Options = TypeVar("Options")

WHAT_IS_REFINED = (
    "num_threads",
    "refine",
    "fixed_camera_ids",
    "fixed_image_ids",
    "fixed_point_ids",
    "refine_sensor_from_rig",
    "fixed_sensors",
)
"""Options of the commands that look at a problem without solving it, and for how many threads."""


def add_options(
    parser: argparse.ArgumentParser,
    kind: type[Any],
    title: str,
    names: Collection[str] | None = None,
) -> None:
    """Add one flag for each field of an option class, or for those of the given names."""
    group = parser.add_argument_group(title)
    for field in dataclasses.fields(kind):
        if names is None or field.name in names:
            _add_option(group, field)


def options_given(
    arguments: argparse.Namespace, kind: type[Options], *, names_follow: bool = False
) -> Options:
    """Return the options that were given.

    Args:
        arguments: of the command line.
        kind: class of the options.
        names_follow: leave out images that are named, for :func:`with_named_images`.

    Raises:
        InputError: a value is out of range; the message names the flag.
    """
    fields = dataclasses.fields(kind)  # type: ignore[arg-type]
    values = {field.name: getattr(arguments, field.name, None) for field in fields}
    for field in fields:
        if field.metadata["metavar"] == "IMAGES" and isinstance(values[field.name], str):
            if not names_follow:
                raise InputError(
                    f"{field.metadata['flag']}: expected ids such as 1,2,5-9, "
                    f"found {values[field.name]!r}"
                )
            values[field.name] = None
    with naming_flags(kind):
        return kind(**{name: value for name, value in values.items() if value is not None})


def with_named_images(
    options: SolveOptions, arguments: argparse.Namespace, problem: Problem
) -> SolveOptions:
    """Return the options with the ids of the images that were given by name.

    Raises:
        InputError: there are no such images; the message names the flag.
    """
    given = arguments.fixed_image_ids
    if not isinstance(given, str):
        return options
    return options.replace(fixed_image_ids=find_images("--fix-images", problem, given))


@contextmanager
def naming_flags(*kinds: type[Any], **others: str) -> Iterator[None]:
    """Let an InputError about an option name its flag and its values as the command line does.

    Options stand at the head of a message, and before "=" within it. ``others`` are the flags of
    arguments that are no options.
    """
    try:
        yield
    except InputError as error:
        flags = others | {
            field.name: field.metadata["flag"]
            for kind in kinds
            for field in dataclasses.fields(kind)
        }
        name, colon, rest = str(error).partition(":")
        if name not in flags:
            raise
        words = re.sub(r"\b(\w+)=", lambda m: f"{flags.get(m[1], m[1])} ", rest)
        words = re.sub(r"\b[a-z]+(?:_[a-z]+)+\b", lambda m: _as_typed(m[0]), words)
        raise InputError(f"{flags[name]}{colon}{words}") from None


@functools.cache
def _values() -> frozenset[str]:
    """Return every value that options name."""
    from bundle.interface.options import REFINABLE, SENSORS, SolveOptions

    fields = dataclasses.fields(SolveOptions)
    return frozenset(
        (*REFINABLE, SENSORS, *(name for f in fields for name in f.metadata["choices"] or ()))
    )


def _as_typed(word: str) -> str:
    return choice_word(word) if word in _values() else word


def parse_ids(text: str) -> tuple[int, ...]:
    """Return the ids that "1,2,5-9" names, sorted, each once.

    Raises:
        argparse.ArgumentTypeError: anything else, or more than ten million ids.
    """
    ids: set[int] = set()
    for part in text.split(","):
        try:
            more = id_range(part)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from None
        if more is None:
            raise argparse.ArgumentTypeError(
                f"expected ids and ranges such as 1,2,5-9, found {text!r}"
            )
        if more.stop - more.start > MOST_IDS - len(ids):  # len() ends at 2^63 - 1
            raise argparse.ArgumentTypeError(f"expected at most {MOST_IDS} ids, found {text!r}")
        ids.update(more)
    return tuple(sorted(ids))


def parse_images(text: str) -> tuple[int, ...] | str:
    """Return the ids of images, or the text where it has names: what these mean is known later.

    Raises:
        argparse.ArgumentTypeError: it is neither.
    """
    parts = [part.strip() for part in text.split(",")]
    numeric = all(part.replace("-", "").strip().isdigit() for part in parts)
    return parse_ids(text) if numeric or not all(parts) else text


def parse_sensors(text: str) -> tuple[tuple[int, int], ...]:
    """Return the pairs of ids that "1:2,1:3" names.

    Raises:
        argparse.ArgumentTypeError: anything else.
    """
    pairs = []
    for part in text.split(","):
        rig, _, camera = part.partition(":")
        try:
            pairs.append((int(rig), int(camera)))
        except ValueError:
            raise argparse.ArgumentTypeError(
                f"expected sensors RIG:CAMERA such as 1:2,1:3, found {text!r}"
            ) from None
    return tuple(pairs)


def _add_option(group: argparse._ArgumentGroup, field: dataclasses.Field[Any]) -> None:
    meta = field.metadata
    flag, default, values = meta["flag"], _shown(field.default), ""
    settings: dict[str, Any] = {"metavar": meta["metavar"]}
    if meta["choices"] is not None:
        choices = [choice_word(choice) for choice in meta["choices"]]
        settings = {"metavar": flag.lstrip("-").upper(), "choices": choices, "type": choice_word}
        values, default = f"one of {', '.join(choices)}; ", choice_word(default)
    elif meta["metavar"] == "IDS":
        settings["type"] = parse_ids
        values = "such as 1,2,5-9; "
    elif meta["metavar"] == "IMAGES":
        settings["type"] = parse_images
        values = "ids and names, such as 1,2,5-9,left/*.jpg; "
    elif meta["metavar"] == "SENSORS":
        settings["type"] = parse_sensors
        values = "RIG:CAMERA by ids, such as 1:2,1:3; "
    elif isinstance(field.default, bool):
        settings = {"action": argparse.BooleanOptionalAction}
        default = flag if field.default else f"--no-{flag.lstrip('-')}"
    elif isinstance(meta["metavar"], tuple):
        settings |= {"nargs": len(meta["metavar"]), "type": int}
    elif isinstance(field.default, int | float):
        settings["type"] = type(field.default)
    text = f"{meta['help']} ({values}default: {default})".replace("%", "%%")
    group.add_argument(flag, dest=field.name, default=None, help=text, **settings)


def choice_word(text: str) -> str:
    """Return a choice as the command line writes it."""
    return text.lower().replace("_", "-")


def _shown(default: Any) -> str:
    """Return a default as the user would type it."""
    if isinstance(default, tuple):
        numbers = all(isinstance(entry, int) for entry in default)
        joined = " ".join(map(str, default)) if numbers else choice_word(",".join(default))
        return joined or "none"
    return f"{default:g}" if isinstance(default, float) else str(default)
