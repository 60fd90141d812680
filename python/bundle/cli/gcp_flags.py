"""Flags of ground control points."""

from __future__ import annotations

import argparse

from bundle.cli.path_checks import a_path

__all__ = ["GCP_FLAGS", "add_gcp_flags", "check_point_names"]

GCP_FLAGS = {
    "gcps": "--gcp",
    "gcp_sigma": "--gcp-sigma",
    "gcp_pixel_sigma": "--gcp-pixel-sigma",
    "check_points": "--check-points",
}
"""Of the arguments of ``bundle.align`` and ``bundle.georeference.gcp_priors``."""


def add_gcp_flags(group: argparse._ArgumentGroup) -> None:
    """Add the flags that say where control points are."""
    group.add_argument(
        "--gcp", metavar="FILE", type=a_path, help="OpenDroneMap's gcp_list.txt (default: none)"
    )
    group.add_argument(
        "--gcp-sigma",
        metavar="H[/V]",
        help="standard deviation of control points, horizontal and vertical, in metres, where the "
        "file has none (default: 0.02)",
    )
    group.add_argument(
        "--gcp-pixel-sigma",
        metavar="PX",
        type=float,
        help="standard deviation of their measurements in pixels, where the file has none "
        "(default: 0.5)",
    )
    group.add_argument(
        "--check-points",
        metavar="NAMES",
        help="control points that are compared and have no influence, such as gcp02,gcp07 "
        "(default: those that the file marks so)",
    )


def check_point_names(text: str | None) -> list[str] | None:
    """Return the names in a list; None where none was given."""
    return None if text is None else [name.strip() for name in text.split(",") if name.strip()]
