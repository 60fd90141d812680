"""Arguments that several commands share: INPUT, OUTPUT, rigs, rules, positions and reports."""

from __future__ import annotations

import argparse
from typing import Any

from bundle.base.words import FORMATS
from bundle.cli.option_flags import add_options
from bundle.cli.path_checks import PathArgument, a_path, reconstruction, report_path
from bundle.errors import InputError
from bundle.io.formats.read_options import ORIGINS, ReadOptions
from bundle.io.georeference_file import GEOREFERENCE
from bundle.io.recognition import OUTPUT_FORMATS

MOVED = (
    "The model is first moved into metres east, north, up about the middle of the control points, "
    "or of the positions where there are none, and stays there. "
    f"{GEOREFERENCE} in OUTPUT, or beside it if it is a file, says where that is."
)

POSITIONS = ("gps", "images", "gps_sigma", "gps_sigma_scale", "gps_offset", "antenna")
CONTROL_POINTS = ("gcp", "gcp_sigma", "gcp_pixel_sigma", "check_points")
READING = ("input_format", "image_size", "image_list", "reconstruction", "pixel_origin")
"""Destinations of the flags of :func:`add_input_format`."""
ATTITUDES = (
    *("gravity", "gravity_sigma", "gravity_sigma_scale"),
    *("orientations", "orientation_sigma", "orientation_sigma_scale"),
)
VELOCITIES = ("velocities", "velocity_sigma")
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
            "the folder of a COLMAP model (binary or text), a BAL file, a Bundler, NVM or OpenMVG "
            "file (all plain, .gz or .bz2), an OpenSfM project or, "
            "for info, refine, compare, inspect, diagnose, covariance and convert, a pose graph "
            "(g2o, plain, .gz or .bz2), or, for info and convert, the folder of a visual-inertial "
            "sequence or of its images (mav0); the format is detected automatically"
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
            "output path, which may be INPUT; NAME.txt, .txt.gz and .txt.bz2 are BAL files, .out "
            "Bundler, .nvm NVM, sfm_data.json OpenMVG, NAME/ and existing folders COLMAP models; "
            "other names get the format of INPUT"
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


def add_input_format(parser: argparse.ArgumentParser) -> None:
    """Add the flags that tell what the file of INPUT does not."""
    group = parser.add_argument_group("INPUT of another program")
    group.add_argument(
        "--input-format",
        metavar="FORMAT",
        choices=FORMATS,
        help=f"format of INPUT: {', '.join(FORMATS)} (default: by its content)",
    )
    group.add_argument(
        "--image-size",
        metavar="W,H",
        help="size of all images in pixels, where the file has no sizes (Bundler, NVM), or "
        "unknown, or COLMAP's database.db, which has them by name (default: from the photographs)",
    )
    group.add_argument(
        "--image-list",
        metavar="FILE",
        type=a_path,
        help="names of the images of a Bundler model (default: list.txt beside it or in the folder "
        "above)",
    )
    group.add_argument(
        "--reconstruction",
        metavar="N",
        type=int,
        help="number of the reconstruction in a file with several, from 0 (default: the only one)",
    )
    group.add_argument(
        "--pixel-origin",
        choices=ORIGINS,
        help="origin of the pixels of an NVM file: the center of the image, or the upper left "
        f"corner, as COLMAP writes it (default: {ORIGINS[0]})",
    )


def given_of(arguments: argparse.Namespace, *names: str) -> tuple[str, ...]:
    """Return flags with their values, for those of ``names`` that were given."""
    values = {name: getattr(arguments, name) for name in names}
    return tuple(
        word
        for name, value in values.items()
        if value is not None
        for word in (f"--{name.replace('_', '-')}", str(value))
    )


def read_options(given: argparse.Namespace) -> ReadOptions:
    """Return the values of the flags of :func:`add_input_format`.

    Raises:
        InputError: a value is invalid.
    """
    try:
        return ReadOptions.of(
            given.input_format,
            given.image_size,
            given.image_list,
            given.reconstruction,
            given.pixel_origin or ORIGINS[0],
        )
    except InputError as error:
        raise InputError(f"--{str(error).replace('image_size', 'image-size')}") from None


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
    images_are_for: str = "--gps exif, --orientations xmp, --velocities xmp and --html",
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
    turned = "A model without positions is first turned to them about the middle of its cameras."
    add_options(parser, kind, "gravity, orientations and headings", ATTITUDES, turned)
    rolling = "They need rolling shutters with free or tied twists, readouts and --frame-rate."
    add_options(parser, kind, "velocities of images", VELOCITIES, rolling)
    add_options(parser, kind, "robustness of all of these", ROBUSTNESS)
