"""`bundle align`."""

from __future__ import annotations

import argparse

from bundle.cli.carried_georeference import check_georeference, write_georeference
from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.georeference_flags import prior_flags
from bundle.cli.option_flags import naming_flags, options_given
from bundle.cli.output import Progress, check_replaced, publish, same_images
from bundle.errors import InputError, shown
from bundle.georeference.alignment import align
from bundle.georeference.measurements import ROWS, settings_of
from bundle.georeference.survey_priors import survey_settings
from bundle.interface.georeference_options import GeoreferenceOptions
from bundle.io.open import check_target, load, output_format, save
from bundle.reports.terminal.align import alignment

FLAGS = {
    "to": "--reference",
    "align": "expected --gcp, --gps or --reference",
}
"""Flags of the arguments of :func:`bundle.align`, which refuses flags without effect."""


def run(arguments: argparse.Namespace) -> int:
    """Align INPUT into OUTPUT."""
    source, target = arguments.input, arguments.output
    given = options_given(arguments, GeoreferenceOptions, beside=GeoreferenceOptions.names())
    if given.gps_offset != "none":
        raise InputError(
            "--gps-offset: valid only with refine, which estimates it together with the cameras"
        )
    with (
        Progress(quiet=arguments.quiet) as progress,
        naming_flags(**{**prior_flags(given), **FLAGS}),
    ):
        progress.stage(f"reading {shown(source)}")
        problem = load(source, progress.text)
        output = {
            "path": target,
            "format": output_format(problem.format, target, arguments.format, source),
        }
        check_target(problem, **output)
        check_replaced(target, [source], arguments.overwrite, same_images(problem))
        check_georeference(**output)
        progress.stage("aligning")
        settings = settings_of(given, *(row for row in ROWS if row.places))
        aligned = align(problem, to=arguments.reference, **survey_settings(problem, settings))
        progress.stage(f"writing {shown(target)}")
        lost = save(aligned.problem, **output, progress=progress.text)
        write_georeference(aligned, **output, reference=arguments.reference)
    publish(alignment(source, problem, aligned, output, lost), arguments)
    return EXIT_DONE
