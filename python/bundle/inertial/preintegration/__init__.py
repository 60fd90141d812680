"""Preintegration of IMU samples between two states, as one factor."""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any


def __getattr__(name: str) -> Any:
    """Serve old pickles, which name this package as the module of its main class."""
    if name in ("Preintegration", "_restored"):
        from bundle.inertial.preintegration import preintegration

        return getattr(preintegration, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
