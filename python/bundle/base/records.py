"""``dataclass`` of the standard library, but frozen classes are defined six times as fast.

The standard decorator compiles up to six methods of a frozen class, of which most are never called:
that took a sixth of the time of a small refinement. Here all frozen classes share the methods that
can read the fields from the object, and ``__init__`` is compiled when it is first looked up.
Signatures, results, messages and errors are the same. Classes that are not frozen, or have other
options (order, slots, ...) or no docstring, are left to the standard library.
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
"""Methods by the option that asks for them."""


def _define(kind: type, options: dict[str, bool]) -> type:
    if not options.get("frozen") or options.keys() - METHODS - {"kw_only"} or not kind.__doc__:
        return dataclasses.dataclass(**options)(kind)
    # Only the fields. What derives from a frozen class must be frozen by the standard library too.
    derived = any("__dataclass_fields__" in vars(base) for base in kind.__mro__[1:])
    fields_only = {"init": False, "repr": False, "eq": False, "frozen": derived}
    dataclasses.dataclass(**options | fields_only)(kind)
    for option, names in METHODS.items():
        is_asked = options.get(option, True)
        setattr(vars(kind)["__dataclass_params__"], option, is_asked)
        for name in names if is_asked else ():
            if vars(kind).get(name) is None:  # beside an __eq__, Python sets __hash__ to None
                setattr(kind, name, _Init(kind) if name == "__init__" else vars(_Shared)[name])
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


class _Init:
    """``__init__`` of a class until it is looked up."""

    def __init__(self, kind: type) -> None:
        self.kind = kind

    def __get__(self, record: Any, _: type | None = None) -> Any:
        function = _compile_init(self.kind)
        setattr(self.kind, "__init__", function)  # noqa: B010 (a method, for type checkers)
        return function if record is None else function.__get__(record)


class _Made:
    """Default of a parameter in place of what a default factory will make."""

    def __repr__(self) -> str:
        return "<factory>"


def _compile_init(kind: Any) -> Any:
    if any("InitVar" in str(field.type) for field in kind.__dataclass_fields__.values()):
        raise TypeError(f"{kind.__name__}: frozen dataclasses of this package have no InitVar")
    fields = dataclasses.fields(kind)
    given = [field for field in fields if field.init]
    places = [_parameter(field) for field in given if not field.kw_only]
    keywords = [_parameter(field) for field in given if field.kw_only]
    parameters = ["self", *places, *(["*", *keywords] if keywords else [])]
    body = [f"__set(self, {field.name!r}, {value})" for field in fields if (value := _value(field))]
    if hasattr(kind, "__post_init__"):
        body.append("self.__post_init__()")
    source = (
        "def define(__fields, __made, __set):\n"
        f" def __init__({', '.join(parameters)}):\n  " + "\n  ".join(body or ["pass"]) + "\n"
        " return __init__\n"
    )
    space: dict[str, Any] = {}
    exec(source, vars(sys.modules[kind.__module__]), space)
    function = space["define"](kind.__dataclass_fields__, _Made(), object.__setattr__)
    function.__qualname__ = f"{kind.__qualname__}.__init__"
    function.__annotations__ = {field.name: field.type for field in given} | {"return": None}
    return function


def _parameter(field: dataclasses.Field[Any]) -> str:
    if field.default is not dataclasses.MISSING:
        return f"{field.name}=__fields[{field.name!r}].default"
    return field.name if field.default_factory is dataclasses.MISSING else f"{field.name}=__made"


def _value(field: dataclasses.Field[Any]) -> str:
    """Return the expression of a field's first value; "" if it has none."""
    name, made = field.name, f"__fields[{field.name!r}].default_factory()"
    if field.default_factory is dataclasses.MISSING:
        return name if field.init else ""
    return f"{made} if {name} is __made else {name}" if field.init else made
