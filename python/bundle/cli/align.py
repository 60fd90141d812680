"""`bundle align`."""

from __future__ import annotations

import argparse

from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.gps_flags import GPS_FLAGS, add_loss_flags, add_position_flags
from bundle.cli.option_flags import naming_flags
from bundle.cli.parser import a_path, add_input, add_output

__all__ = ["HELP", "NAME", "add_arguments", "run"]

NAME = "align"
HELP = "puts a reconstruction where GPS, control points or another model say it is"

FLAGS = {
    "gcps": "--gcp",
    "gcp_sigma": "--gcp-sigma",
    "gcp_pixel_sigma": "--gcp-pixel-sigma",
    "check_points": "--check-points",
    **GPS_FLAGS,
    "to": "--reference",
    "align": "expected --gcp, --gps or --reference",
}
"""Of the arguments of ``bundle.align``."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of this command."""
    parser.usage = "bundle align INPUT -o OUTPUT [--gcp FILE] [--gps exif|FILE] [options]"
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
    add_position_flags(parser.add_argument_group("positions of images"))
    group = parser.add_argument_group("another model")
    group.add_argument(
        "--reference",
        metavar="MODEL",
        type=a_path,
        help="a model with images of the same names, into whose frame INPUT goes (default: none)",
    )
    add_loss_flags(parser.add_argument_group("robustness"), "control points and positions")


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
    with Progress(quiet=arguments.quiet) as progress, naming_flags(**FLAGS):
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
