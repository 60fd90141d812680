"""Where the C++ headers for users' own code are installed."""

from __future__ import annotations

from pathlib import Path

__all__ = ["get_include"]


def get_include() -> str:
    """Return the folder that a compiler must know to find ``#include <bundle/check.h>``.

    The header makes compiled ceres cost functions checkable with ``bundle.check_gradients``.
    """
    return str(Path(__file__).resolve().parents[1] / "include")
