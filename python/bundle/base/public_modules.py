"""Imports of public modules by their public names, such as ``import bundle.losses``.

Packages of public names import each on first use (PEP 562).
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from importlib.abc import Loader
else:
    Loader = object  # importlib.abc takes longer than all else here


def spec_of(name: str, public_modules: dict[str, str]) -> ModuleSpec | None:
    """Return the spec of a public module or of a module below it; None if there is none below."""
    public, _, below = name.removeprefix("bundle.").partition(".")
    place = ".".join(filter(None, ("bundle", public_modules[public], below)))
    if below and find_spec(place) is None:
        return None
    return ModuleSpec(name, _SameModule(place))


def deferred(
    package: str, modules: dict[str, str]
) -> tuple[list[str], Callable[[str], Any], Callable[[], list[str]]]:
    """Return ``__all__``, ``__getattr__`` and ``__dir__`` of a package.

    Args:
        package: name of the package.
        modules: names that each module of the package gives, separated by blanks.
    """
    homes = {name: module for module, names in modules.items() for name in names.split()}

    def getattr_of_package(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(f"{package}.{homes[name]}"), name)
        setattr(sys.modules[package], name, value)
        return value

    return sorted(homes), getattr_of_package, lambda: sorted({*vars(sys.modules[package]), *homes})


class _SameModule(Loader):
    """Loader of a module under another name."""

    def __init__(self, place: str) -> None:
        self.place = place

    def create_module(self, _spec: ModuleSpec) -> ModuleType:
        """Return the module itself."""
        module = importlib.import_module(self.place)
        self.own = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Restore the module's own spec, which the import system replaced."""
        module.__spec__ = self.own
