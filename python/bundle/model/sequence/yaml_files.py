"""Reading of YAML files as tables of keys: calibrations of this package, of EuRoC and of Kalibr.

OpenCV writes a first line ``%YAML:1.0`` and tags ``!!opencv-matrix``, which YAML does not allow;
both are ignored.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError, brief, first_line, shown


def read_yaml(path: Path) -> dict[Any, Any]:
    """Read a file of keys with values.

    Raises:
        InputError: the file is not YAML, or its content is not keys with values.
        OSError: the file cannot be read.
    """
    import yaml

    content = path.read_bytes()
    if content.startswith(b"%YAML:"):
        content = content[content.find(b"\n") + 1 :] if b"\n" in content else b""
    content = content.replace(b"!!opencv-matrix", b"")
    try:
        found = yaml.safe_load(content)
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        mark = getattr(error, "problem_mark", None)
        place = f": line {mark.line + 1}" if mark is not None else ""
        problem = getattr(error, "problem", None) or first_line(error)
        raise InputError(f"{shown(path)}{place}: expected YAML, found {problem}") from None
    if not isinstance(found, dict):
        raise InputError(f"{shown(path)}: expected keys with values, found {brief(found)}")
    return found


def finite_numbers(name: str, value: Any) -> NDArray[np.float64]:
    """Convert a value to an array of finite numbers; strings such as "1e-4" are numbers.

    Raises:
        InputError: it is something else; the message begins with ``name``.
    """
    try:
        found = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name}: expected numbers, found {brief(value)}") from None
    if not np.isfinite(found).all():
        raise InputError(f"{name}: expected finite numbers, found {brief(value)}")
    return found


def one_number(name: str, value: Any) -> float:
    """Convert a value to a finite number.

    Raises:
        InputError: it is something else; the message begins with ``name``.
    """
    found = finite_numbers(name, value)
    if found.ndim or isinstance(value, bool):
        raise InputError(f"{name}: expected a number, found {brief(value)}")
    return float(found)
