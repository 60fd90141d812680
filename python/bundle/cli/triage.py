"""`bundle triage`."""

from __future__ import annotations

import argparse

from bundle.cli.error_lines import EXIT_DONE, EXIT_NO_SOLUTION
from bundle.cli.option_flags import naming_flags, options_given
from bundle.cli.output import publish
from bundle.interface.judging_options import TriageOptions
from bundle.judging.triage.triage_reports import triage
from bundle.reports.terminal.triage import triaged


def run(arguments: argparse.Namespace) -> int:
    """Compare two reports; return 0 if nothing changed beyond noise, otherwise 1."""
    paths = arguments.old, arguments.new
    options = options_given(arguments, TriageOptions)
    with naming_flags(TriageOptions):
        found = triage(*paths, options)
    publish(triaged(paths, found, options), arguments)
    return EXIT_DONE if found.is_noise else EXIT_NO_SOLUTION
