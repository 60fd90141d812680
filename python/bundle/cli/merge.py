"""`bundle merge`."""

from __future__ import annotations

import argparse

from bundle.cli.carried_georeference import (
    carry_georeference,
    check_georeference,
    georeference_at,
)
from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.option_flags import naming_flags
from bundle.cli.output import check_replaced, publish, same_images
from bundle.cli.progress import Progress
from bundle.editing.merge_models import merge
from bundle.errors import shown
from bundle.io.open import check_target, load, output_format, save
from bundle.reports.terminal.merge import merged_report

FLAGS = {"a": "A", "b": "B", "max_error": "--max-error"}
"""Flags of the arguments of :func:`bundle.merge`."""

MERGED = "Merged with another model, in the frame of the first."


def run(arguments: argparse.Namespace) -> int:
    """Merge models A and B into OUTPUT."""
    paths, target = (arguments.a, arguments.b), arguments.output
    with Progress(quiet=arguments.quiet) as progress, naming_flags(**FLAGS):
        problems = []
        for path in paths:
            progress.stage(f"reading {shown(path)}")
            problems.append(load(path, progress.text))
        a, b = problems
        output = {
            "path": target,
            "format": output_format(a.format, target, arguments.format, paths[0]),
        }
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
    publish(merged_report(paths, (a, b), merged, output, lost), arguments)
    return EXIT_DONE
