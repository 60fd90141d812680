"""`bundle align`."""

from __future__ import annotations

import argparse

from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.gcp_flags import GCP_FLAGS, add_gcp_flags, check_point_names
from bundle.cli.gps_flags import GPS_FLAGS, add_loss_flags, add_position_flags
from bundle.cli.option_flags import naming_flags
from bundle.cli.parser import add_input, add_output
from bundle.cli.path_checks import reconstruction

__all__ = ["HELP", "NAME", "add_arguments", "run"]

NAME = "align"
HELP = "puts a reconstruction where GPS, control points or another model say it is"

FLAGS = {
    **GCP_FLAGS,
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
    add_gcp_flags(parser.add_argument_group("ground control points"))
    add_position_flags(parser.add_argument_group("positions of images"))
    group = parser.add_argument_group("another model")
    group.add_argument(
        "--reference",
        metavar="MODEL",
        type=reconstruction,
        help="a model with images of the same names, into whose frame INPUT goes (default: none)",
    )
    add_loss_flags(parser.add_argument_group("robustness"), "control points and positions")


def run(arguments: argparse.Namespace) -> int:
    """Align INPUT into OUTPUT."""
    from bundle.cli.carried_georeference import check_georeference, write_georeference
    from bundle.cli.gps_flags import antenna
    from bundle.cli.output import check_replaced, publish, same_images
    from bundle.cli.progress import Progress
    from bundle.errors import shown
    from bundle.georeference.alignment import align
    from bundle.io.open import check_target, load, output_format, save
    from bundle.reports.terminal.align import alignment

    source, target = arguments.input, arguments.output
    with Progress(quiet=arguments.quiet) as progress, naming_flags(**FLAGS):
        progress.stage(f"reading {shown(source)}")
        problem = load(source, progress.text)
        output = {
            "path": target,
            "format": output_format(problem, target, arguments.format, source),
        }
        check_target(problem, **output)
        check_replaced(target, [source], arguments.overwrite, same_images(problem))
        check_georeference(**output)
        progress.stage("aligning")
        settings = {
            "gcps": arguments.gcp,
            "gps": arguments.gps,
            "to": arguments.reference,
            "images": arguments.images,
            "gcp_sigma": arguments.gcp_sigma,
            "gcp_pixel_sigma": arguments.gcp_pixel_sigma,
            "check_points": check_point_names(arguments.check_points),
            "gps_sigma": arguments.gps_sigma,
            "antenna": None if arguments.antenna is None else antenna(arguments.antenna),
            "prior_loss": arguments.prior_loss,
            "prior_loss_scale": arguments.prior_loss_scale,
        }
        aligned = align(problem, **{k: v for k, v in settings.items() if v is not None})
        progress.stage(f"writing {shown(target)}")
        lost = save(aligned.problem, **output, progress=progress.text)
        write_georeference(aligned, **output, reference=arguments.reference)
    publish(alignment(source, problem, aligned, output, lost), arguments.json)
    return EXIT_DONE
