"""Flags of what is known of the place of a model, and where what became of it is written."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bundle.cli.gcp_flags import GCP_FLAGS, add_gcp_flags, check_point_names
from bundle.cli.option_flags import choice_word, naming_flags
from bundle.cli.path_checks import PathArgument, a_path
from bundle.errors import InputError, brief, shown
from bundle.interface.options import LOSSES, SolveOptions
from bundle.io.georeference_file import GEOREFERENCE

if TYPE_CHECKING:
    from bundle.georeference.gcp_priors import GcpPriors
    from bundle.georeference.gps_priors import GpsPriors
    from bundle.model.problem import Problem

__all__ = [
    "GPS_FLAGS",
    "add_gps_flags",
    "antenna",
    "check_gps_flags",
    "priors_given",
]

GPS_FLAGS = {
    "gps": "--gps",
    "images": "--images",
    "gps_sigma": "--gps-sigma",
    "antenna": "--antenna",
    "prior_loss": "--prior-loss",
    "prior_loss_scale": "--prior-loss-scale",
}


OF_BOTH = ("prior_loss", "prior_loss_scale")

NAMED = {**GCP_FLAGS, **GPS_FLAGS}
"""Of the arguments of ``gps_priors`` and ``gcp_priors``."""


MOVED = (
    "The model is first moved into metres east, north, up about the middle of the control points, "
    "or of the positions where there are none, and stays there. "
    f"{GEOREFERENCE} in OUTPUT, or beside it if it is a file, says where that is."
)


def add_gps_flags(
    parser: argparse.ArgumentParser,
    what_becomes: str = MOVED,
    images_are_for: str = "--gps exif and --html",
) -> None:
    """Add the flags of ``bundle.georeference.gps_priors`` and ``gcp_priors``."""
    group = parser.add_argument_group("positions of images", what_becomes)
    add_position_flags(group, images_are_for)
    add_gcp_flags(
        parser.add_argument_group(
            "ground control points",
            "They are adjusted with the model, and not written among its points.",
        )
    )
    loss = parser.add_argument_group("robustness of positions and control points")
    add_loss_flags(loss, "positions and control points")


def add_position_flags(group: argparse._ArgumentGroup, images_are_for: str = "--gps exif") -> None:
    """Add the flags that say what the positions are."""
    group.add_argument(
        "--gps",
        metavar="exif|FILE",
        type=PathArgument(words=("exif",)),
        help="measured positions; exif: what the images themselves say; FILE: "
        "OpenDroneMap's geo.txt (default: none)",
    )
    group.add_argument(
        "--images",
        metavar="DIR",
        type=a_path,
        help=f"folder of the images, for {images_are_for} (default: none)",
    )
    group.add_argument(
        "--gps-sigma",
        metavar="H[/V]",
        help="standard deviation of positions without their own, horizontal and vertical, in "
        "metres (default: 2/5)",
    )
    group.add_argument(
        "--antenna",
        metavar="X,Y,Z",
        help="place of the antenna in the frame of the camera, right, down, forward, in metres "
        "(default: 0,0,0)",
    )


def add_loss_flags(group: argparse._ArgumentGroup, what: str) -> None:
    """Add the flags of the loss of positions, or of what else stands in a help text."""
    words = [choice_word(name) for name in LOSSES]
    group.add_argument(
        "--prior-loss",
        metavar="NAME",
        choices=words,
        type=choice_word,
        help=f"robust loss of {what}: tukey and arctan give up on gross errors, the others "
        f"keep pulling (one of {', '.join(words)}; default: trivial)",
    )
    group.add_argument(
        "--prior-loss-scale",
        metavar="X",
        type=float,
        help="length of a residual in standard deviations at which it bends (default: 2.7955, "
        "which 5 %% of good ones exceed)",
    )


def check_gps_flags(arguments: argparse.Namespace, options: SolveOptions) -> None:
    """Refuse flags without effect.

    Raises:
        InputError: a flag that needs another one, or no folder of images.
    """
    pictured = arguments.html is not None and arguments.images is not None
    if pictured and not Path(arguments.images).is_dir():
        raise InputError(f"--images: expected a folder, found none: {shown(arguments.images)}")
    for flags, needed in ((GPS_FLAGS, "gps"), (GCP_FLAGS, "gcp")):
        for name, flag in flags.items():
            if name == "images" and arguments.html is not None:
                continue
            given = name in OF_BOTH and arguments.gcp is not None
            if given or getattr(arguments, needed) is not None or name == "gcps":
                continue
            if getattr(arguments, name) is not None:
                others = "--gcp or --gps" if name in OF_BOTH else f"--{needed}"
                raise InputError(f"{flag}: expected with {others} only, found without")
    if arguments.gps is None and arguments.gcp is None:
        return
    if arguments.gps == "exif" and arguments.images is None:
        raise InputError("--gps: expected --images DIR beside exif, found none")
    alone = arguments.images is not None and arguments.html is None
    if arguments.gps not in (None, "exif") and alone:
        raise InputError("--images: expected with --gps exif only, found with a file")
    if arguments.prior_loss_scale is not None and arguments.prior_loss in (None, "trivial"):
        raise InputError("--prior-loss-scale: expected with a --prior-loss other than trivial")
    flag = main_flag(arguments)
    if arguments.only_images is not None:
        raise InputError(f"{flag}: expected without --only-images, which leaves the rest in place")
    if "poses" not in options.refine:
        raise InputError(f"{flag}: expected poses among those of --refine, found them held")


def main_flag(arguments: argparse.Namespace) -> str:
    """Return the flag to which what is said of all priors belongs."""
    return "--gps" if arguments.gcp is None else "--gcp"


def priors_given(arguments: argparse.Namespace, problem: Problem) -> GcpPriors | GpsPriors | None:
    """Return the priors of images and control points; None without --gps and --gcp.

    Raises:
        InputError: a file or a flag is wrong; the message names the flag.
        OSError: a file cannot be read.
    """
    if arguments.gps is None and arguments.gcp is None:
        return None
    from bundle.georeference.gcp_priors import gcp_priors
    from bundle.georeference.gps_priors import gps_priors

    names = ["gps_sigma", "prior_loss", "prior_loss_scale"]
    if arguments.gps == "exif":  # of the report page otherwise
        names.append("images")
    if arguments.gcp is not None:
        names += ["gps", "gcp_sigma", "gcp_pixel_sigma"]
    settings: dict[str, Any] = {
        name: getattr(arguments, name) for name in names if getattr(arguments, name) is not None
    }
    if arguments.antenna is not None:
        settings["antenna"] = antenna(arguments.antenna)
    with naming_flags(**NAMED):
        if arguments.gcp is None:
            return gps_priors(problem, arguments.gps, **settings)
        names = check_point_names(arguments.check_points) or []
        return gcp_priors(problem, arguments.gcp, check_points=names, **settings)


def antenna(text: str) -> list[float]:
    """Return x, y, z of the antenna.

    Raises:
        InputError: the text is something else.
    """
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 3:
        raise InputError(
            f"--antenna: expected X,Y,Z in metres, such as 0,-0.1,0.05, found {brief(text)}"
        )
    return numbers
