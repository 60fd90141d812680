"""`bundle merge`."""

from __future__ import annotations

import argparse

from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.option_flags import naming_flags
from bundle.cli.parser import add_output
from bundle.cli.path_checks import reconstruction

__all__ = ["HELP", "NAME", "add_arguments", "run"]

NAME = "merge"
HELP = "makes two reconstructions of partly the same images one"

FLAGS = {"a": "A", "b": "B", "max_error": "--max-error"}
"""Of the arguments of ``bundle.merge``."""

MERGED = "Merged with another model, in the frame of the first."


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of this command."""
    parser.usage = "bundle merge A B -o OUTPUT [options]"
    parser.add_argument(
        "a",
        metavar="A",
        type=reconstruction,
        help="a COLMAP model, whose frame, poses and ids stay",
    )
    parser.add_argument(
        "b",
        metavar="B",
        type=reconstruction,
        help="a COLMAP model with some images of the same names",
    )
    add_output(parser, "-o", "--output", required=True, replaces=("a", "b"))
    parser.add_argument(
        "--max-error",
        metavar="PX",
        type=float,
        default=8.0,
        help="points that meet at a keypoint are one if their projections differ by at most this, "
        "the median over the images of both, in pixels (default: 8)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Merge A and B into OUTPUT."""
    from bundle.cli.carried_georeference import (
        carry_georeference,
        check_georeference,
        georeference_at,
    )
    from bundle.cli.output import check_replaced, publish, same_images
    from bundle.cli.progress import Progress
    from bundle.editing.merging.merge_models import merge
    from bundle.errors import shown
    from bundle.io.open import check_target, load, output_format, save
    from bundle.reports.terminal.merge import merged_report

    paths, target = (arguments.a, arguments.b), arguments.output
    with Progress(quiet=arguments.quiet) as progress, naming_flags(**FLAGS):
        problems = []
        for path in paths:
            progress.stage(f"reading {shown(path)}")
            problems.append(load(path, progress.text))
        a, b = problems
        output = {"path": target, "format": output_format(a, target, arguments.format, paths[0])}
        check_target(a, **output)
        place = georeference_at(paths[0])
        if place is not None:
            check_georeference(**output)
        check_replaced(target, paths, arguments.overwrite, same_images(a, b))
        progress.stage("merging")
        merged = merge(a, b, max_error=arguments.max_error)
        progress.stage(f"writing {shown(target)}")
        lost = save(merged.problem, **output, progress=progress.text)
        carry_georeference(place, **output, changed=MERGED)
    publish(merged_report(paths, (a, b), merged, output, lost), arguments.json)
    return EXIT_DONE
