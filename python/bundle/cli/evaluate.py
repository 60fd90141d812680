"""`bundle evaluate`."""

from __future__ import annotations

import argparse

from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.option_flags import naming_flags, options_given
from bundle.cli.output import publish
from bundle.cli.progress import Progress
from bundle.errors import shown
from bundle.interface.judging_options import EvaluateOptions
from bundle.judging.evaluation.evaluate_models import evaluate
from bundle.reports.terminal.evaluate import evaluated

FLAGS = {"a": "A", "b": "--reference"}
"""Flags of the arguments of :func:`bundle.evaluate`."""


def run(arguments: argparse.Namespace) -> int:
    """Compare A with the reference."""
    paths = arguments.a, arguments.reference
    options = options_given(arguments, EvaluateOptions)
    with Progress(quiet=arguments.quiet) as progress, naming_flags(EvaluateOptions, **FLAGS):
        progress.stage(f"comparing {shown(paths[0])} with {shown(paths[1])}")
        found = evaluate(*paths, options)
    publish(evaluated(paths, found, options), arguments)
    return EXIT_DONE
