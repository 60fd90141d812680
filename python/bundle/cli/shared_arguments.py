"""Arguments that several commands share: INPUT, OUTPUT, rigs, rules, positions and reports."""

from __future__ import annotations

import argparse
from typing import Any

from bundle.cli.option_flags import add_options
from bundle.cli.path_checks import PathArgument, a_path, reconstruction, report_path
from bundle.io.georeference_file import GEOREFERENCE
from bundle.io.recognition import OUTPUT_FORMATS

__all__ = [
    "add_common",
    "add_format",
    "add_georeference",
    "add_input",
    "add_output",
    "add_rig_config",
    "add_rules",
]

MOVED = (
    "The model is first moved into metres east, north, up about the middle of the control points, "
    "or of the positions where there are none, and stays there. "
    f"{GEOREFERENCE} in OUTPUT, or beside it if it is a file, says where that is."
)

POSITIONS = ("gps", "images", "gps_sigma", "antenna")
CONTROL_POINTS = ("gcp", "gcp_sigma", "gcp_pixel_sigma", "check_points")
ROBUSTNESS = ("prior_loss", "prior_loss_scale")


def add_common(parser: argparse.ArgumentParser) -> None:
    """Add the flags that every command has."""
    parser.add_argument(
        "--json",
        metavar="FILE",
        type=report_path,
        help="also write a report for programs; -: to standard output, which then has nothing else",
    )
    parser.add_argument(
        "--quiet", action="store_true", help="no progress on standard error (default: shown)"
    )
    parser.add_argument(
        "--verbose",
        action="store_true",
        help="show all tables and findings after the headline (default: off)",
    )


def add_input(
    parser: argparse.ArgumentParser, name: str = "input", nargs: str | None = None
) -> None:
    """Add the argument INPUT."""
    parser.add_argument(
        name,
        metavar="INPUT",
        nargs=nargs,
        type=reconstruction,
        help=(
            "a BAL file (plain, .gz or .bz2), the folder of a COLMAP model (binary or text) or, "
            "for info, refine, compare, inspect, diagnose, covariance and convert, a pose graph "
            "(g2o, plain, .gz or .bz2), or, for info and convert, the folder of a visual-inertial "
            "sequence; the format is detected automatically"
        ),
    )


def add_output(
    parser: argparse.ArgumentParser,
    *names: str,
    replaces: tuple[str, ...] = ("input",),
    **settings: Any,
) -> None:
    """Add OUTPUT under the given names, and the flags --format and --overwrite.

    Args:
        parser: parser of the command.
        *names: names of the argument.
        replaces: destinations of the arguments that may name the same model.
        **settings: arguments of ``add_argument``.
    """
    parser.add_argument(
        *names,
        metavar="OUTPUT",
        type=PathArgument("output", is_data=True, replaces=replaces),
        help=(
            "output path, which may be INPUT; NAME.txt, .txt.gz and .txt.bz2 are BAL files, NAME/ "
            "and existing folders are COLMAP models, other names get the format of INPUT"
        ),
        **settings,
    )
    add_format(parser)
    parser.add_argument(
        "--overwrite",
        action="store_true",
        help="replace a model of other images at OUTPUT (default: stop if it exists)",
    )


def add_format(parser: argparse.ArgumentParser) -> None:
    """Add the flag --format."""
    parser.add_argument(
        "--format", choices=OUTPUT_FORMATS, help="format of OUTPUT (default: by its name)"
    )


def add_rig_config(parser: argparse.ArgumentParser) -> None:
    """Add the flag --rig-config."""
    parser.add_argument(
        "--rig-config",
        metavar="FILE",
        type=a_path,
        help=(
            "make rigs by COLMAP's rig_config.json: images whose names differ only in their prefix "
            "form a frame; missing poses of sensors are means over the frames (default: the rigs "
            "of INPUT)"
        ),
    )


def add_rules(parser: argparse.ArgumentParser) -> None:
    """Add the flags --set and --constraints."""
    add_options(
        parser,
        "RuleOptions",
        "constraints",
        description=(
            "Knowledge in addition to the pixels, such as --set 'cameras *: f prior 2 %' or --set "
            "'camera 3: cx,cy fixed'. Focal lengths and the principal point are in pixels, "
            "positions in the unit of the model (metres with --gps), rotations in degrees."
        ),
    )


def add_georeference(
    parser: argparse.ArgumentParser,
    meaning: str = MOVED,
    images_are_for: str = "--gps exif and --html",
) -> None:
    """Add flags for positions of images, control points and their loss.

    Args:
        parser: parser of the command.
        meaning: purpose of the positions in this command.
        images_are_for: uses of the folder of images.
    """
    images = f"folder of the images, for {images_are_for}"
    kind = "GeoreferenceOptions"
    add_options(parser, kind, "positions of images", POSITIONS, meaning, images=images)
    adjusted = "They are adjusted with the model, and not written among its points."
    add_options(parser, kind, "ground control points", CONTROL_POINTS, adjusted)
    add_options(parser, kind, "robustness of positions and control points", ROBUSTNESS)
