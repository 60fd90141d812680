"""Objects of a user's Python file: FILE.py:NAME.

The file runs as a module of its own name, with its folder first in the search path, as
``python FILE.py`` does. A function is called without arguments.
"""

from __future__ import annotations

import importlib.util
import re
import sys
import traceback
from pathlib import Path
from types import ModuleType
from typing import Any

from bundle.base.paths import as_path
from bundle.errors import InputError, nearest, shown

NAMES = ("make_graph", "graph")
"""Objects that are used if no name is given."""

_PYTHON = re.compile(r"(?P<path>.+\.py)(?::(?P<name>[^:/\\]*))?$", re.IGNORECASE | re.DOTALL)


def is_python_object(path: object) -> bool:
    """Return True for text such as "factors.py" and "factors.py:make_graph"."""
    found = _PYTHON.match(path) if isinstance(path, str) else None
    return found is not None and not Path(path if isinstance(path, str) else "").is_dir()


def load_object(text: str) -> Any:
    """Run a Python file and return its object, or what its function returns.

    Args:
        text: FILE.py:NAME; without a name ``make_graph`` or ``graph``.
    """
    found = _PYTHON.match(text)
    if found is None:
        raise InputError(f"{shown(text)}: expected FILE.py:NAME")
    path, name = as_path(found["path"]), found["name"]
    with path.open("rb"):  # a missing file is an error of the system, not of Python
        pass
    module = _run(path)
    if name is None:
        name = next((known for known in NAMES if hasattr(module, known)), "")
        if not name:
            raise InputError(
                f"{shown(path)}: expected {' or '.join(NAMES)}, or {shown(path)}:NAME, "
                f"found {_names(module)}"
            )
    if not hasattr(module, name):
        raise InputError(
            f"{shown(path)}: expected an object {name}, found {_names(module)}"
            f"{nearest(name, [*vars(module)])}"
        )
    thing = getattr(module, name)
    if not callable(thing):
        return thing
    try:
        return thing()
    except Exception as error:
        raise user_error(f"{shown(path)}: {name}()", error, path) from error


def user_error(place: str, error: Exception, path: Path | None = None) -> InputError:
    """Return an exception of a user's code as one line, with the line of the file that raised it.

    Args:
        path: file whose last line in the traceback is named; None: that of the last frame.
    """
    if isinstance(error, InputError):
        return InputError(f"{place}: {error}")
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if path is None or Path(frame.filename) == path.resolve()]
    line = getattr(error, "lineno", None) if isinstance(error, SyntaxError) else None
    if line is None and own:
        line = own[-1].lineno
    notes = "".join(f"{note}: " for note in getattr(error, "__notes__", ())[:1])
    where = f" (line {line})" if line else ""
    message = error.msg if isinstance(error, SyntaxError) else str(error)
    return InputError(f"{place}: {notes}{type(error).__name__}: {message}{where}")


def _run(path: Path) -> ModuleType:
    folder, stem = str(path.resolve().parent), path.stem
    name = stem if stem.isidentifier() and stem not in sys.modules else f"_{abs(hash(path))}"
    spec = importlib.util.spec_from_file_location(name, path.resolve())
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # for dataclasses and pickle
    if folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        failed = error if isinstance(error, Exception) else RuntimeError("sys.exit was called")
        raise user_error(shown(path), failed, path) from error
    return module


def _names(module: ModuleType) -> str:
    own = [
        name
        for name, value in vars(module).items()
        if not name.startswith("_")
        and not isinstance(value, ModuleType)
        and getattr(value, "__module__", module.__name__) == module.__name__
    ]
    return ", ".join(own[:5]) or "an empty file"
