"""`bundle align`."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager

from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.parser import a_path, add_input, add_output

__all__ = ["HELP", "NAME", "add_arguments", "run"]

NAME = "align"
HELP = "puts a reconstruction where GPS, control points or another model say it is"

FLAGS = {
    "gcps": "--gcp",
    "gcp_sigma": "--gcp-sigma",
    "gcp_pixel_sigma": "--gcp-pixel-sigma",
    "check_points": "--check-points",
    "gps": "--gps",
    "images": "--images",
    "gps_sigma": "--gps-sigma",
    "antenna": "--antenna",
    "to": "--reference",
    "prior_loss": "--prior-loss",
    "prior_loss_scale": "--prior-loss-scale",
    "align": "expected --gcp, --gps or --reference",
}
"""Of the arguments of ``bundle.align``."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of this command."""
    parser.usage = "bundle align INPUT -o OUTPUT [--gcp FILE] [--gps FILE|exif] [options]"
    add_input(parser)
    add_output(parser, "-o", "--output", required=True)
    group = parser.add_argument_group("ground control points")
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
        default="",
        help="control points that are compared and have no influence, such as gcp02,gcp07 "
        "(default: those that the file marks so)",
    )
    group = parser.add_argument_group("positions of images")
    group.add_argument(
        "--gps",
        metavar="FILE|exif",
        type=a_path,
        help="OpenDroneMap's geo.txt, or exif: what the images themselves say (default: none)",
    )
    group.add_argument(
        "--images", metavar="DIR", type=a_path, help="folder of the images, for --gps exif"
    )
    group.add_argument(
        "--gps-sigma",
        metavar="H[/V]",
        help="standard deviation of positions, horizontal and vertical, in metres, where they have "
        "none of their own (default: 2/5)",
    )
    group.add_argument(
        "--antenna",
        metavar="X,Y,Z",
        help="the antenna in the frame of the camera: right, down, forward, in metres "
        "(default: 0,0,0)",
    )
    group = parser.add_argument_group("another model")
    group.add_argument(
        "--reference",
        metavar="MODEL",
        type=a_path,
        help="a model with images of the same names, into whose frame INPUT goes (default: none)",
    )
    group = parser.add_argument_group("robustness")
    group.add_argument(
        "--prior-loss",
        metavar="NAME",
        help="loss of control points and positions: trivial, huber, soft-l1, cauchy, arctan or "
        "tukey (default: trivial)",
    )
    group.add_argument(
        "--prior-loss-scale",
        metavar="X",
        type=float,
        help="length of a residual in standard deviations at which it bends (default: 2.7955, "
        "which 5 %% of good points exceed)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Align INPUT into OUTPUT."""
    from bundle.cli.gps_flags import antenna, check_georeference, write_georeference
    from bundle.cli.output import check_json, show, write_json
    from bundle.cli.progress import Progress
    from bundle.errors import shown
    from bundle.georeference import align
    from bundle.io import check_target, load, output_format, save
    from bundle.report.align import alignment, as_json

    source, target = arguments.input, arguments.output
    check_json(arguments.json, source, target)
    with Progress(quiet=arguments.quiet) as progress, _naming_flags():
        progress.stage(f"reading {shown(source)}")
        problem = load(source)
        output = {
            "path": target,
            "format": output_format(problem, target, arguments.format, source),
        }
        check_target(problem, **output)
        check_georeference(**output, json=arguments.json)
        progress.stage("aligning")
        settings = {
            "gcps": arguments.gcp,
            "gps": arguments.gps,
            "to": arguments.reference,
            "images": arguments.images,
            "gcp_sigma": arguments.gcp_sigma,
            "gcp_pixel_sigma": arguments.gcp_pixel_sigma,
            "check_points": [name for name in arguments.check_points.split(",") if name],
            "gps_sigma": arguments.gps_sigma,
            "antenna": None if arguments.antenna is None else antenna(arguments.antenna),
            "prior_loss": arguments.prior_loss,
            "prior_loss_scale": arguments.prior_loss_scale,
        }
        aligned = align(problem, **{k: v for k, v in settings.items() if v is not None})
        progress.stage(f"writing {shown(target)}")
        lost = save(aligned.problem, **output)
        write_georeference(aligned, **output)
    if arguments.json != "-":
        show(*alignment(source, aligned, output, lost))
    write_json(arguments.json, as_json(source, problem, aligned, output))
    return EXIT_DONE


@contextmanager
def _naming_flags() -> Iterator[None]:
    """Let an InputError about an argument of ``bundle.align`` name its flag."""
    from bundle.errors import InputError

    try:
        yield
    except InputError as error:
        name, colon, rest = str(error).partition(":")
        if name not in FLAGS:
            raise
        raise InputError(f"{FLAGS[name]}{colon}{rest}") from None
