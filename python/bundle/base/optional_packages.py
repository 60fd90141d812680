"""Packages that are not installed on every machine.

pycolmap has no wheels for some machines (Linux on aarch64, for example). There, everything works
but the functions that take or return its objects, and ``bundle merge``.
"""

from __future__ import annotations

import sys
from importlib.util import find_spec

from bundle.errors import InputError

__all__ = ["has_pycolmap", "require_pycolmap"]


def has_pycolmap() -> bool:
    """Return True if pycolmap is installed; does not import it."""
    if "pycolmap" in sys.modules:
        return sys.modules["pycolmap"] is not None
    try:
        return find_spec("pycolmap") is not None
    except (ImportError, ValueError):
        return False


def require_pycolmap(purpose: str) -> None:
    """Check that pycolmap is installed.

    Args:
        purpose: what needs it, for the message.

    Raises:
        InputError: it is not installed.
    """
    if not has_pycolmap():
        raise InputError(
            f"{purpose}: expected the package pycolmap, found that it is not installed; "
            "pip install pycolmap"
        )
