"""`bundle convert`."""

from __future__ import annotations

import argparse

from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.lens_flags import add_lens_flags, cameras_edited
from bundle.cli.parser import add_input, add_output, add_rig_config, with_rigs
from bundle.io.recognition import is_pose_graph_file, sequence_at

__all__ = ["HELP", "NAME", "add_arguments", "run"]

NAME = "convert"
HELP = "between formats, saying what is lost"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of this command."""
    add_input(parser)
    add_output(parser, "output")
    add_rig_config(parser)
    add_lens_flags(parser)


def run(arguments: argparse.Namespace) -> int:
    """Write INPUT in another format."""
    if is_pose_graph_file(arguments.input):
        from bundle.cli.pose_graph_commands import convert_graph

        return convert_graph(arguments)
    if sequence_at(arguments.input):
        from bundle.cli.sequence_commands import convert_sequence

        return convert_sequence(arguments)
    from bundle.cli.carried_georeference import (
        carry_georeference,
        check_georeference,
        georeference_at,
    )
    from bundle.cli.output import check_replaced, publish, same_images
    from bundle.cli.progress import Progress
    from bundle.errors import shown
    from bundle.io.open import check_target, load, output_format, save
    from bundle.reports.terminal.convert import converted

    path = arguments.output
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(arguments.input)}")
        problem = load(arguments.input, progress.text)
        edits = cameras_edited(arguments, problem)
        edited = problem if edits is None else edits.problem
        edited = with_rigs(edited, arguments.rig_config)
        output = {
            "path": path,
            "format": output_format(edited, path, arguments.format, arguments.input),
        }
        check_target(edited, **output)
        place = georeference_at(arguments.input)
        if place is not None:
            check_georeference(**output)
        check_replaced(path, [arguments.input], arguments.overwrite, same_images(edited))
        progress.stage(f"writing {shown(path)}")
        lost = save(edited, **output, progress=progress.text)
        carry_georeference(place, **output)
    publish(converted(arguments.input, problem, output, lost, edits), arguments.json)
    return EXIT_DONE
