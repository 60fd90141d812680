"""`bundle convert` of a reconstruction."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from bundle.cli.carried_georeference import (
    carry_georeference,
    check_georeference,
    georeference_at,
)
from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.option_flags import naming_flags, options_given
from bundle.cli.output import check_replaced, publish, same_images
from bundle.cli.problem_edits import cameras_edited, with_rigs
from bundle.cli.progress import Progress
from bundle.cli.recording_flags import refuse_recording_flags
from bundle.cli.shared_arguments import read_options
from bundle.errors import shown
from bundle.interface.camera_edit_options import LensOptions
from bundle.io.open import check_target, load, output_format, save
from bundle.reports.terminal.convert import converted

if TYPE_CHECKING:
    from bundle.editing.rolling_shutters import GlobalShutterModel
    from bundle.model.problem import Problem


def run(arguments: argparse.Namespace) -> int:
    """Write INPUT in another format."""
    refuse_recording_flags(arguments)
    source, path = arguments.input, arguments.output
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(source)}")
        problem = load(source, progress.text, read_options(arguments))
        edits = cameras_edited(options_given(arguments, LensOptions), problem)
        edited = problem if edits is None else edits.problem
        edited = with_rigs(edited, arguments.rig_config)
        moved = None
        if arguments.global_shutter:
            progress.stage("moving observations")
            moved = _without_rolling_shutter(edited, source)
            edited = moved.problem
        output = {
            "path": path,
            "format": output_format(edited.format, path, arguments.format, source),
        }
        check_target(edited, **output)
        place = georeference_at(source)
        if place is not None:
            check_georeference(**output)
        check_replaced(path, [source], arguments.overwrite, same_images(edited))
        progress.stage(f"writing {shown(path)}")
        lost = save(edited, **output, progress=progress.text)
        carry_georeference(place, **output)
    publish(converted(source, problem, output, lost, edits, moved), arguments)
    return EXIT_DONE


def _without_rolling_shutter(problem: Problem, source: str) -> GlobalShutterModel:
    from bundle.editing.rolling_shutters import to_global_shutter

    with naming_flags(problem=f"--global-shutter: {shown(source)}"):
        return to_global_shutter(problem)
