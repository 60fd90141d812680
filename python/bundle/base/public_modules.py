"""Imports of public modules by their public names, such as ``import bundle.losses``."""

from __future__ import annotations

import importlib
from importlib.abc import Loader
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType


def spec_of(name: str, public_modules: dict[str, str]) -> ModuleSpec | None:
    """Return the spec of a public module or of a module below it; None if there is none below."""
    public, _, below = name.removeprefix("bundle.").partition(".")
    place = ".".join(filter(None, ("bundle", public_modules[public], below)))
    if below and find_spec(place) is None:
        return None
    return ModuleSpec(name, _SameModule(place))


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
