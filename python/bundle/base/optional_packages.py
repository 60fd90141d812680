"""Packages that are not installed on every machine.

pycolmap has no wheels for some machines (Linux on aarch64, for example). There, everything works
but the functions that take or return its objects.
"""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path

from bundle.errors import InputError, shown

_HEIC = (".heic", ".heif", ".hif")


def has_pycolmap() -> bool:
    """Return True if pycolmap is installed; does not import it."""
    return _is_installed("pycolmap")


def require_pycolmap(purpose: str) -> None:
    """Check that pycolmap is installed."""
    require_package("pycolmap", "pycolmap", purpose)


def require_package(module: str, package: str, purpose: str) -> None:
    """Check that a package is installed; does not import it."""
    if not _is_installed(module):
        raise InputError(
            f"{purpose}: expected the package {package}, found that it is not installed; "
            f"pip install {package}"
        )


def allow_heic(path: Path) -> None:
    """Let Pillow open a photograph that is HEIC by its name."""
    if path.suffix.lower() in _HEIC:
        require_package("pillow_heif", "bundle-adjust[heic]", shown(path))
        import pillow_heif  # late: few photographs need it

        pillow_heif.register_heif_opener()


def _is_installed(module: str) -> bool:
    if module in sys.modules:
        return sys.modules[module] is not None
    try:
        return find_spec(module) is not None
    except (ImportError, ValueError):
        return False
