"""Options of synthetic observations, whatever scene they are of."""

from __future__ import annotations

from typing import Any

from bundle.interface.option_fields import option

__all__ = ["outlier_share_option", "pixel_noise_option"]


def pixel_noise_option() -> Any:
    """Return the field of ``pixel_noise``."""
    return option(
        0.5,
        "--pixel-noise",
        "standard deviation of x and of y, in pixels",
        minimum=0.0,
        below=1e6,
        metavar="PIXELS",
    )


def outlier_share_option() -> Any:
    """Return the field of ``outlier_share``."""
    return option(
        0.0,
        "--outlier-share",
        "share of the observations replaced by uniformly random pixels",
        minimum=0.0,
        below=1.0,
        metavar="X",
    )
