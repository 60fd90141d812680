"""``dataclass`` of the standard library, but frozen classes are defined twice as fast.

The standard decorator compiles up to six methods of a frozen class: 21 of the 150 ms of a small
refinement. Here only the constructor is compiled, on its first use; all frozen classes share the
other methods, which read the fields from the object. Signatures, results, messages and errors are
the same, but for InitVar, which is refused. Classes with other options, such as slots, are left to
the standard library.
"""

from __future__ import annotations

import dataclasses
import sys
from reprlib import recursive_repr
from typing import TYPE_CHECKING, Any

__all__ = ["dataclass"]

if TYPE_CHECKING:
    from dataclasses import dataclass
else:

    def dataclass(kind: type | None = None, /, **options: bool) -> Any:
        """Return a class with the methods of a dataclass, or a decorator with these options."""
        return _define(kind, options) if kind else lambda kind: _define(kind, options)


METHODS = {
    "init": ("__init__",),
    "repr": ("__repr__",),
    "eq": ("__eq__", "__hash__"),
    "frozen": ("__setattr__", "__delattr__"),
}
"""Methods by the option that requests them."""


def _define(kind: type, options: dict[str, bool]) -> type:
    if not options.get("frozen") or options.keys() - METHODS - {"kw_only"} or not kind.__doc__:
        return dataclasses.dataclass(**options)(kind)
    # The fields alone. Classes that derive from a frozen class must be frozen by the standard
    # library.
    derived = any("__dataclass_fields__" in vars(base) for base in kind.__mro__[1:])
    fields_only = dict.fromkeys(METHODS, False) | {"frozen": derived}
    if any("InitVar" in str(written) for written in kind.__annotations__.values()):
        raise TypeError(f"{kind.__name__}: frozen dataclasses of this package have no InitVar")
    kind = _with_fields(kind, options | fields_only)
    for option, names in METHODS.items():
        is_asked = options.get(option, True)
        setattr(vars(kind)["__dataclass_params__"], option, is_asked)
        for name in names if is_asked else ():
            if vars(kind).get(name) is None:  # beside an __eq__, Python sets __hash__ to None
                shared = vars(_Shared).get(name)
                setattr(kind, name, shared if shared is not None else _Constructor(kind))
    return kind


def _with_fields(kind: type, options: dict[str, bool]) -> type:
    """Return a dataclass; the standard decorator takes 10 us per field for text annotations."""
    written = vars(kind).get("__annotations__", {})
    special = ("ClassVar", "KW_ONLY")  # which no annotation may name otherwise
    texts = [text for text in written.values() if isinstance(text, str)]
    if len(texts) < len(written) or any(word in text for text in texts for word in special):
        return dataclasses.dataclass(**options)(kind)
    kind.__annotations__ = dict.fromkeys(written, object)
    kind = dataclasses.dataclass(**options)(kind)
    kind.__annotations__ = written
    for name, text in written.items():
        vars(kind)["__dataclass_fields__"][name].type = text
    return kind


class _Shared:
    """Methods that frozen classes share."""

    @recursive_repr()
    def __repr__(self: Any) -> str:
        shown = (field.name for field in dataclasses.fields(self) if field.repr)
        values = ", ".join(f"{name}={getattr(self, name)!r}" for name in shown)
        return f"{type(self).__qualname__}({values})"

    def __eq__(self, other: object) -> Any:
        if type(other) is not type(self):
            return NotImplemented
        return _values(self, "compare") == _values(other, "compare")

    def __hash__(self) -> int:
        return hash(_values(self, "hash"))

    def __setattr__(self, name: str, value: object) -> None:
        _check_free(self, name, "assign to")
        object.__setattr__(self, name, value)

    def __delattr__(self, name: str) -> None:
        _check_free(self, name, "delete")
        object.__delattr__(self, name)


def _values(record: Any, use: str) -> tuple[Any, ...]:
    fields = [(field, getattr(field, use)) for field in dataclasses.fields(record)]
    used = (field.name for field, asked in fields if (field.compare if asked is None else asked))
    return tuple(getattr(record, name) for name in used)


def _check_free(record: Any, name: str, action: str) -> None:
    """Raise an error unless the attribute belongs to a class that derives from the frozen one."""
    if "__dataclass_fields__" in vars(type(record)) or name in record.__dataclass_fields__:
        raise dataclasses.FrozenInstanceError(f"cannot {action} field {name!r}")


class _Made:
    """Placeholder for the default of a field with a default factory."""

    def __repr__(self) -> str:
        return "<factory>"


class _Constructor:
    """``__init__`` of a class until its first use."""

    def __init__(self, kind: Any) -> None:
        self._kind = kind

    def __get__(self, record: Any, kind: Any = None) -> Any:
        self._kind.__init__ = function = _constructor(self._kind)
        return function.__get__(record, kind)


def _constructor(kind: Any) -> Any:
    """Return an __init__ that sets the fields without calling __setattr__."""
    places, keywords, body = ["self"], ["*"], ["pass"]
    scope = {"_set": object.__setattr__, "_made": _Made()}
    fields = dataclasses.fields(kind)
    for field in fields:
        value, default = field.name, ""
        if field.default_factory is not dataclasses.MISSING:
            new, default = f"_new_{field.name}", "=_made"
            scope[new] = field.default_factory
            value = f"{new}() if {value} is _made else {value}" if field.init else f"{new}()"
        elif field.default is not dataclasses.MISSING:
            default = f"=_default_{field.name}"
            scope[default[1:]] = field.default
        if field.init:
            (keywords if field.kw_only else places).append(field.name + default)
        if field.init or value != field.name:
            body.append(f"_set(self, {field.name!r}, {value})")
    if hasattr(kind, "__post_init__"):
        body.append("self.__post_init__()")
    parameters = ", ".join(places + (keywords if len(keywords) > 1 else []))
    inner = f" def __init__({parameters}):\n  " + "\n  ".join(body)
    space: dict[str, Any] = {}
    # The function has the names of its module, in which its annotations are resolved.
    exec(
        f"def define({', '.join(scope)}):\n{inner}\n return __init__",
        vars(sys.modules[kind.__module__]),
        space,
    )
    function = space["define"](**scope)
    function.__qualname__ = f"{kind.__qualname__}.__init__"
    given = {field.name: field.type for field in fields if field.init}
    function.__annotations__ = given | {"return": None}
    return function
