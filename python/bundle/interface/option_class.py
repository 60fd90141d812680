"""Base class of option classes: checks, copies, and a repr that shows the defaults.

An option class is a frozen dataclass that derives from :class:`Options` and whose fields are made
by :func:`bundle.interface.option_fields.option`; :func:`documented` writes its docstring.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
import inspect
from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, Self, TypeVar

from bundle.base.words import join
from bundle.errors import InputError, brief, check_keywords
from bundle.interface.option_fields import checked, limits_of

AnyOptions = TypeVar("AnyOptions", bound="Options")
Function = TypeVar("Function", bound=Callable[..., Any])


class Options:
    """Base of option classes. Values are checked when they are set, and immutable."""

    def __new__(cls, *args: Any, **given: Any) -> Self:
        """Raise an InputError with a suggestion for unknown options, before ``__init__`` fails."""
        if args:
            raise InputError(f"{cls.__name__}: expected options by name, found {brief(args[0])}")
        check_keywords(cls.__name__, given, spellings(cls))
        return super().__new__(cls)

    def __post_init__(self) -> None:
        self._check(_declared(type(self)).fields.values())

    def _check(self, fields: Iterable[dataclasses.Field[Any]]) -> None:
        for field in fields:
            object.__setattr__(self, field.name, self._checked(field, getattr(self, field.name)))
        for field in self._idle():
            if field.metadata["idle"] == "error":
                other, values = field.metadata["only_with"]
                raise InputError(
                    f"{field.name}: valid only with {other}={join(map(str, values))}, found "
                    f"{other}={getattr(self, other)}"
                )

    @classmethod
    def of(cls, options: Options | None, changes: Mapping[str, Any], caller: str) -> Self:
        """Return ``options``, or the defaults if it is None, with changes.

        Raises:
            InputError: ``options`` has another type, or a change is invalid.
        """
        if options is None:
            options = _defaults(cls)
        if not isinstance(options, cls):
            found = options.short() if isinstance(options, Options) else brief(options)
            raise InputError(f"options: expected {cls.__name__}, found {found}")
        return options._changed(caller, changes) if changes else options

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Return the name of every option."""
        return tuple(_declared(cls).fields)

    def replace(self, **changes: Any) -> Self:
        """Return a copy with some options changed."""
        return self._changed(type(self).__name__, changes)

    def asdict(self) -> dict[str, Any]:
        """Return every option by name."""
        return {name: getattr(self, name) for name in _declared(type(self)).fields}

    def changed(self) -> dict[str, Any]:
        """Return the options that differ from their defaults, by name."""
        return {
            field.name: getattr(self, field.name)
            for field in _declared(type(self)).fields.values()
            if getattr(self, field.name) != field.default
        }

    def _changed(self, caller: str, changes: Mapping[str, Any]) -> Self:
        """Return a copy with changes; only the changes are checked again."""
        fields = _declared(type(self)).fields
        if not changes.keys() <= fields.keys():
            check_keywords(caller, changes, spellings(type(self)))
        copy = object.__new__(type(self))
        copy.__dict__.update(self.__dict__, **changes)
        copy._check(map(fields.__getitem__, changes))
        return copy

    def without_idle(self) -> Self:
        """Return a copy in which options without effect have their default values."""
        return self.replace(**{field.name: field.default for field in self._idle()})

    def short(self) -> str:
        """Return the call that creates these options, such as "SolveOptions(loss='huber')"."""
        given = (f"{name}={value!r}" for name, value in self.changed().items())
        return f"{type(self).__name__}({', '.join(given)})"

    def __repr__(self) -> str:
        """Return every option, one per line; a comment marks those that are not the default."""
        lines = []
        for field in _declared(type(self)).fields.values():
            value = getattr(self, field.name)
            note = "" if value == field.default else f"  # default: {field.default!r}"
            lines.append(f"    {field.name}={value!r},{note}")
        return "\n".join([f"{type(self).__name__}(", *lines, ")"])

    def _checked(self, field: dataclasses.Field[Any], value: Any) -> Any:
        """Return the value in canonical form; classes with special options override this method."""
        return checked(field, value)

    def _idle(self) -> list[dataclasses.Field[Any]]:
        """Return the options that were changed but have no effect."""
        idle = []
        for field in _declared(type(self)).dependent:
            value = getattr(self, field.name)
            zero = isinstance(value, float) and value == 0  # noise of zero has no effect
            if value == field.default or zero:
                continue
            other, values = field.metadata["only_with"]
            if getattr(self, other) not in values:
                idle.append(field)
        return idle


def documented(kind: type[AnyOptions]) -> type[AnyOptions]:
    """Append a list of options to an option class's docstring; it is generated when it is read."""
    kind.__doc__ = _Documentation(kind.__doc__ or "")  # type: ignore[assignment]
    return kind


class _Documentation:
    """Docstring that is generated from the fields of its class when it is read."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __get__(self, _options: Any, kind: type[Options]) -> str:
        lines = [self.text.rstrip(), "", "    Attributes:"]
        for field in _declared(kind).fields.values():
            metavar = field.metadata["metavar"]
            value = " ".join(metavar) if isinstance(metavar, tuple) else metavar or ""
            choices = field.metadata["choices"]
            bounds = ", ".join(limits_of(field)).capitalize()
            parts = [
                f"{field.metadata['help']}.",
                f"One of {', '.join(choices)}." if choices else f"{bounds}." if bounds else "",
                _requirement(field),
                f"Default {field.default!r};",
                f"command line: {field.metadata['flag']} {value}".rstrip() + ".",
            ]
            lines += _wrapped(f"{field.name}: {' '.join(filter(None, parts))}")
        return "\n".join(lines) + "\n"


def takes_options(kind: type[Options]) -> Callable[[Function], Function]:
    """Show the options of a class in the signature of a function that takes them by name.

    IPython and notebooks complete keywords from this signature; editors do from the types in
    ``bundle/interface/option_keywords.pyi``.
    """

    def decorate(function: Function) -> Function:
        signature = inspect.signature(function)
        own = [p for p in signature.parameters.values() if p.kind is not p.VAR_KEYWORD]
        names = {parameter.name for parameter in own}
        options = [
            inspect.Parameter(field.name, inspect.Parameter.KEYWORD_ONLY, default=field.default)
            for field in _declared(kind).fields.values()
            if field.name not in names
        ]
        shown = signature.replace(parameters=[*own, *options])
        setattr(function, "__signature__", shown)  # noqa: B010 (functions do not declare it)
        return function

    return decorate


def spellings(kind: type[Options]) -> Mapping[str, str]:
    """Return a table from accepted spellings, including those of flags, to option names."""
    return _declared(kind).spellings


class _Declared(NamedTuple):
    """Fields of an option class, and values derived from them."""

    fields: Mapping[str, dataclasses.Field[Any]]
    dependent: tuple[dataclasses.Field[Any], ...]
    spellings: Mapping[str, str]


def _declared(kind: Any) -> _Declared:
    return _cached_declared(kind)


@functools.cache
def _cached_declared(kind: Any) -> _Declared:
    fields = dataclasses.fields(kind)
    flags = {field.metadata["flag"]: field.name for field in fields}
    names = {field.name: field.name for field in fields}
    return _Declared(
        fields=MappingProxyType({field.name: field for field in fields}),
        dependent=tuple(field for field in fields if field.metadata["only_with"] is not None),
        spellings=MappingProxyType(flags | names),
    )


def _defaults(kind: Any) -> Any:
    return _cached_defaults(kind)


@functools.cache
def _cached_defaults(kind: Any) -> Any:
    """Return the immutable defaults, checked once."""
    return kind()


def _requirement(field: dataclasses.Field[Any]) -> str:
    if field.metadata["needs"]:
        return f"Only with {join(field.metadata['needs'])}."
    if field.metadata["only_with"] is None:
        return ""
    other, values = field.metadata["only_with"]
    return f"Only with {other} {join(map(str, values))}."


def _wrapped(text: str) -> list[str]:
    import textwrap  # only needed when the docstring is read

    return textwrap.wrap(
        " ".join(text.split()),
        100,
        initial_indent=" " * 8,
        subsequent_indent=" " * 12,
        break_on_hyphens=False,
    )


# Table of every option class, by name.
#
# The command line, the documentation and the tests find the classes here. Each class is imported on
# first use, because a command needs few of them.

OPTION_CLASSES = {
    "CheckOptions": "analysis_options",
    "CheckpointOptions": "round_options",
    "CompareOptions": "planning_options",
    "CovarianceOptions": "analysis_options",
    "EvaluateOptions": "judging_options",
    "FlightOptions": "scene_options",
    "GeoreferenceOptions": "georeference_options",
    "GraphFileOptions": "planning_options",
    "GraphOptions": "options",
    "HoldOutOptions": "judging_options",
    "InfluenceOptions": "analysis_options",
    "LensOptions": "camera_edit_options",
    "LocalOptions": "round_options",
    "LoopOptions": "pose_graph_options",
    "OutOfCoreOptions": "round_options",
    "PlanOptions": "analysis_options",
    "PoseGraphOptions": "pose_graph_options",
    "RankOptions": "planning_options",
    "ReliabilityOptions": "analysis_options",
    "RoundOptions": "round_options",
    "RuleOptions": "camera_edit_options",
    "SceneOptions": "scene_options",
    "ShapeOptions": "planning_options",
    "ShutterOptions": "camera_edit_options",
    "SolveOptions": "options",
    "TrackingOptions": "window_options",
    "TriageOptions": "judging_options",
    "ValidationOptions": "judging_options",
    "WindowOptions": "window_options",
}
"""Option classes, with the modules of this package that define them."""


def option_class(name: str) -> type[Options]:
    """Import and return the option class with a name."""
    module = importlib.import_module(f"bundle.interface.{OPTION_CLASSES[name]}")
    kind: type[Options] = getattr(module, name)
    return kind
