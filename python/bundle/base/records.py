"""``dataclass`` of the standard library, but frozen classes are defined twice as fast.

The standard decorator compiles up to six methods of a frozen class: 21 of the 150 ms of a small
refinement. Here only the constructor is compiled, if it is used often; all frozen classes share the
other methods, which read the fields from the object. Signatures, results, messages and errors are
the same, but for InitVar, which is refused. Classes with other options, such as slots, are left to
the standard library.
"""

from __future__ import annotations

import copy
import dataclasses
from functools import partial
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


MOST_USES = 10
"""Uses of a constructor before it is compiled, which takes as long as 50 of them."""


class _Constructor:
    """``__init__`` of a class until it is compiled."""

    def __init__(self, kind: Any) -> None:
        self._kind = kind
        self._uses = 0

    def __get__(self, record: Any, kind: Any = None) -> Any:
        self._uses += 1
        # The record is None for an access by the class, and for inspect.signature the class itself.
        if self._uses > MOST_USES or not isinstance(record, self._kind):
            return self._compiled().__get__(record, kind)
        return partial(self._set, record)

    def _set(self, record: Any, /, *places: Any, **given: Any) -> None:
        fields = dataclasses.fields(self._kind)
        names = (field.name for field in fields if field.init and not field.kw_only)
        values = dict(zip(names, places, strict=False)) | given
        is_wrong = len(values) < len(places) + len(given)
        for field in fields:
            if field.init and field.name in values:
                value = values.pop(field.name)
            elif field.default_factory is not dataclasses.MISSING:
                value = field.default_factory()
            elif field.init and field.default is not dataclasses.MISSING:
                value = field.default
            else:
                is_wrong |= field.init
                continue
            object.__setattr__(record, field.name, value)
        if is_wrong or values:
            self._compiled()(record, *places, **given)  # raises the error
        if hasattr(self._kind, "__post_init__"):
            record.__post_init__()

    def _compiled(self) -> Any:
        """Return the constructor of a class of the standard library with the same fields."""
        kind, fields = self._kind, dataclasses.fields(self._kind)
        kept = ("__doc__", "__module__", "__post_init__")
        space = {name: getattr(kind, name) for name in kept if hasattr(kind, name)}
        space |= {field.name: copy.copy(field) for field in fields}  # the decorator changes them
        space["__annotations__"] = {field.name: field.type for field in fields}
        same: Any = dataclasses.dataclass(frozen=True, repr=False, eq=False)(
            type("_Same", (), space)
        )
        kind.__init__ = function = same.__init__
        function.__qualname__ = f"{kind.__qualname__}.__init__"
        return function
