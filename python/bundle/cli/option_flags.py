"""Declarations of arguments: flags made from option classes, and options read from flags.

A declaration is a function that adds arguments to a parser or a group.
"""

from __future__ import annotations

import argparse
import dataclasses
import re
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from typing import TYPE_CHECKING, Any, TypeVar

from bundle.base.words import join
from bundle.cli.path_checks import PathArgument, a_path
from bundle.errors import InputError
from bundle.interface.option_class import Options, option_class
from bundle.model.problem_keys import MOST_IDS, find_images, id_range

if TYPE_CHECKING:
    from bundle.interface.options import SolveOptions
    from bundle.model.problem import Problem

AnyOptions = TypeVar("AnyOptions", bound=Options)
Container = argparse._ActionsContainer
Declaration = Callable[[Container], object]
"""Adds arguments to a parser or a group."""


def argument(*names: str, **settings: Any) -> Declaration:
    """Declare one argument by the settings of ``add_argument``; ``use`` is as for an option."""
    use = settings.pop("use", 0)
    return lambda to: vars(to.add_argument(*names, **settings)).update(use=use)


def file_argument(*names: str, **settings: Any) -> Declaration:
    """Declare an argument for a file that is read."""
    return argument(*names, **{"metavar": "FILE", "type": a_path, **settings})


def fields(kind: str | type, *which: Any, **helps: Any) -> Declaration:
    """Declare the flags of an option class; see :func:`add_fields`."""
    return lambda to: add_fields(to, kind, *which, **helps)


def group(title: str, *parts: Any, description: str | None = None) -> Declaration:
    """Declare arguments with a title in the help."""
    return lambda to: add_all(to.add_argument_group(title, description), parts)


def either(*parts: Declaration) -> Declaration:
    """Declare arguments of which at most one can be given."""
    return lambda to: add_all(to.add_mutually_exclusive_group(), parts)


def add_all(to: Container, parts: Iterable[Any]) -> None:
    """Declare arguments; tuples are arguments that belong together."""
    for part in parts:
        if isinstance(part, tuple):
            add_all(to, part)
        else:
            part(to)


def options(
    kind: str | type,
    title: str,
    names: Collection[str] | None = None,
    description: str | None = None,
    without: Collection[str] = (),
    **helps: str,
) -> Declaration:
    """Declare a group with one flag for each field of an option class; see :func:`add_fields`."""
    return group(title, fields(kind, names, without, **helps), description=description)


def add_fields(
    group: argparse._ActionsContainer,
    kind: type[Options] | str,
    names: Collection[str] | None = None,
    without: Collection[str] = (),
    **helps: str,
) -> None:
    """Add one flag for each field of an option class.

    ``names`` are its fields (None: all), ``helps`` texts for another meaning in this command.
    """
    for field in _fields(kind):
        if (names is None or field.name in names) and field.name not in without:
            _add_option(group, field, helps.get(field.name, field.metadata["help"]))


def widen(group: argparse._ActionsContainer, field: dataclasses.Field[Any], kind: str) -> None:
    """Extend the flag of another option class by the choices of a field."""
    action = group._option_string_actions.get(field.metadata["flag"])
    if action is None or action.choices is None:
        return
    known = list(action.choices)
    words = [choice_word(word) for word in field.metadata["choices"]]
    added = [word for word in words if word not in known]
    if added:
        action.choices = [*known, *added]
        action.help = f"{action.help}; for {kind} also {', '.join(added)}"


def own_options(kind: str, other: str) -> list[str]:
    """Return the names of the options of a class that another class does not have."""
    shared = {field.name for field in _fields(other)}
    return [field.name for field in _fields(kind) if field.name not in shared]


def _fields(kind: type[Options] | str) -> tuple[dataclasses.Field[Any], ...]:
    return dataclasses.fields(option_class(kind) if isinstance(kind, str) else kind)  # type: ignore[arg-type]


def options_given(
    arguments: argparse.Namespace,
    kind: type[AnyOptions],
    *,
    names: Collection[str] | None = None,
    names_follow: bool = False,
    beside: Collection[str] = (),
) -> AnyOptions:
    """Return the checked options of the command line; errors name the flags.

    Args:
        names: fields to read, if flags of others belong to another class; None: all.
        names_follow: leave out images given by name; :func:`with_named_images` adds them.
        beside: fields that also have an effect without the options that they usually require.
    """
    fields = [field for field in _fields(kind) if names is None or field.name in names]
    values = {field.name: getattr(arguments, field.name, None) for field in fields}
    flags = flags_of(kind)
    for field in fields:
        if field.metadata["value"] == "images" and isinstance(values[field.name], str):
            if not names_follow:
                raise InputError(
                    f"{field.metadata['flag']}: expected ids such as 1,2,5-9, "
                    f"found {values[field.name]!r}"
                )
            values[field.name] = None
    with naming_flags(kind):
        given = kind(**{name: value for name, value in values.items() if value is not None})
    for field in fields:
        needs = field.metadata["needs"]
        alone = needs and field.name not in beside and all(not values[name] for name in needs)
        if alone and values[field.name] is not None:
            others = join(flags[name] for name in needs)
            raise InputError(f"{field.metadata['flag']}: valid only with {others}")
    return given


def with_named_images(
    options: SolveOptions, given: tuple[int, ...] | str | None, problem: Problem
) -> SolveOptions:
    """Return the options with the ids of images given by name in --fix-images."""
    if not isinstance(given, str):
        return options
    return options.replace(fixed_image_ids=find_images("--fix-images", problem, given))


@contextmanager
def naming_flags(*kinds: type[Any], **others: str) -> Iterator[None]:
    """Rewrite an InputError about an option with its flag and its values on the command line.

    Option names are at the start of a message, and before "=" within it. ``others`` are flags of
    arguments that are not options.
    """
    try:
        yield
    except InputError as error:
        flags = {**flags_of(*kinds), **others}
        name, colon, rest = str(error).partition(":")
        if name not in flags:
            raise
        words = re.sub(r"\b(\w+)=", lambda m: f"{flags.get(m[1], m[1])} ", rest)
        words = re.sub(
            r"\b[a-z]+(?:_[a-z]+)+\b",
            lambda m: choice_word(m[0]) if m[0] in _values() else m[0],
            words,
        )
        raise InputError(f"{flags[name]}{colon}{words}") from None


def flags_of(*kinds: type[Any]) -> dict[str, str]:
    """Return the flags of option classes, by the names of their fields."""
    return {
        field.name: field.metadata["flag"] for kind in kinds for field in dataclasses.fields(kind)
    }


@cache
def _values() -> frozenset[str]:
    """Return every named value of the options of a solve."""
    from bundle.interface.option_fields import REFINABLE, SENSORS  # only for messages
    from bundle.interface.options import SolveOptions

    fields = dataclasses.fields(SolveOptions)
    return frozenset(
        (*REFINABLE, SENSORS, *(name for f in fields for name in f.metadata["choices"] or ()))
    )


def _add_option(
    group: argparse._ActionsContainer, field: dataclasses.Field[Any], meaning: str
) -> None:
    meta = field.metadata
    flag, default, values = meta["flag"], _shown(field), ""
    settings: dict[str, Any] = {"metavar": meta["metavar"]}
    if meta["choices"] is not None:
        choices = [choice_word(choice) for choice in meta["choices"]]
        settings["metavar"] = meta["metavar"] or flag.lstrip("-").upper()
        settings |= {"choices": choices, "type": choice_word}
        values = f"one of {', '.join(choices)}; "
    elif meta["value"] == "several":
        settings["action"] = "append"
    elif meta["value"]:
        settings["type"], values = READERS[meta["value"]]
    elif isinstance(field.default, bool):
        action = argparse.BooleanOptionalAction if meta["negatable"] else "store_true"
        settings = {"action": action}
    elif isinstance(meta["metavar"], tuple):
        settings |= {"nargs": len(meta["metavar"]), "type": int}
    elif isinstance(field.default, int | float):
        settings["type"] = type(field.default)
    text = f"{meaning} ({values}default: {default})".replace("%", "%%")
    added = group.add_argument(flag, dest=field.name, default=None, help=text, **settings)
    vars(added).update(use=meta["use"])


def _shown(field: dataclasses.Field[Any]) -> str:
    """Return the default of an option in the syntax of the command line."""
    default, flag = field.default, str(field.metadata["flag"])
    if default is None:
        return str(field.metadata["unset"])
    if isinstance(default, bool):
        off = f"--no-{flag.lstrip('-')}" if field.metadata["negatable"] else "off"
        return flag if default else off
    if isinstance(default, tuple):
        numbers = all(isinstance(entry, int) for entry in default)
        joined = " ".join(map(str, default)) if numbers else choice_word(",".join(default))
        return joined or "none"
    if field.metadata["choices"] is not None:
        return choice_word(str(default))
    return f"{default:g}" if isinstance(default, float) else str(default)


# Values of flags: parsing of ids, names, lists and paths.
#
# ``READERS`` has a parser for each ``value`` in the fields of option classes.


def choice_word(text: str) -> str:
    """Return a choice in the spelling of the command line."""
    return text.lower().replace("_", "-")


def parse_ids(text: str) -> tuple[int, ...]:
    """Return the ids in text such as "1,2,5-9", sorted, without repeats, at most ten million."""
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
        if more.stop - more.start > MOST_IDS - len(ids):  # len() of a range fails above 2^63 - 1
            raise argparse.ArgumentTypeError(f"expected at most {MOST_IDS} ids, found {text!r}")
        ids.update(more)
    return tuple(sorted(ids))


def parse_images(text: str) -> tuple[int, ...] | str:
    """Return the ids of images, or the text if it has names, which need the problem."""
    parts = [part.strip() for part in text.split(",")]
    numeric = all(part.replace("-", "").strip().isdigit() for part in parts)
    return parse_ids(text) if numeric or not all(parts) else text


def _parse_pairs(expected: str, text: str) -> tuple[tuple[int, int], ...]:
    pairs = []
    for part in text.split(","):
        first, _, second = part.partition(":")
        try:
            pairs.append((int(first), int(second)))
        except ValueError:
            raise argparse.ArgumentTypeError(f"expected {expected}, found {text!r}") from None
    return tuple(pairs)


def _parse_ids_or_all(text: str) -> tuple[int, ...] | bool | str:
    return True if text == "all" else text if text == "size" else parse_ids(text)


def _parse_words(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _parse_counts(text: str) -> tuple[int, ...]:
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isascii() and part.isdigit() and len(part) < 9 for part in parts):
        raise argparse.ArgumentTypeError(f"expected numbers such as 1,2, found {text!r}")
    return tuple(map(int, parts))


_IMAGES = "ids and names, such as 1,2,5-9,left/*.jpg; "

READERS: dict[str, tuple[Callable[[str], Any], str]] = {
    "checkpoint": (PathArgument("checkpoint", replaces=("resume",)), ""),
    "counts": (_parse_counts, ""),
    "exif or path": (PathArgument(words=("exif",)), ""),
    "xmp or path": (PathArgument(words=("xmp",)), ""),
    "ids": (parse_ids, "such as 1,2,5-9; "),
    "ids or all": (_parse_ids_or_all, "such as 1,2,5-9; "),
    "images": (parse_images, _IMAGES),
    "names of images": (str, _IMAGES),
    "pairs": (partial(_parse_pairs, "pairs A:B of image ids such as 1:2,7:3"), ""),
    "path": (a_path, ""),
    "resumed checkpoint": (PathArgument("checkpoint", replaces=("checkpoint",)), ""),
    "sets": (lambda text: tuple(map(_parse_words, text.split("/"))), ""),
    "sensors": (
        partial(_parse_pairs, "sensors RIG:CAMERA such as 1:2,1:3"),
        "RIG:CAMERA by ids, such as 1:2,1:3; ",
    ),
    "word": (choice_word, ""),
    "words": (_parse_words, ""),
}
"""Parsers of values with an example for the help, by the ``value`` of a field."""
