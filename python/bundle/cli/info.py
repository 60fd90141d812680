"""`bundle info`: describe every INPUT by the function for its kind."""

from __future__ import annotations

import argparse

from bundle.analysis.statistics.description import describe
from bundle.cli.dispatch import find_handler
from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.output import publish
from bundle.cli.problem_edits import with_rigs
from bundle.cli.progress import Progress
from bundle.cli.recording_flags import refuse_recording_flags
from bundle.cli.shared_arguments import READING, given_of, read_options
from bundle.errors import shown
from bundle.interface.finding import one_list
from bundle.io.open import load
from bundle.io.recognition import recognize
from bundle.judging.findings.find import find
from bundle.reports.sections import Report, several
from bundle.reports.terminal.info import information


def run(arguments: argparse.Namespace) -> int:
    """Describe every INPUT."""
    reports: list[Report] = []
    with Progress(quiet=arguments.quiet) as progress:
        for path in arguments.inputs:
            progress.stage(f"reading {shown(path)}")
            describe_input = find_handler("info", recognize(path))
            reports.append(describe_input(path, arguments, progress))
    publish(reports[0] if len(reports) == 1 else several("info", reports), arguments)
    return EXIT_DONE


def describe_reconstruction(path: str, arguments: argparse.Namespace, progress: Progress) -> Report:
    """Return the report of `bundle info` on a reconstruction."""
    refuse_recording_flags(arguments)
    problem = with_rigs(load(path, progress.text, read_options(arguments)), arguments.rig_config)
    progress.stage("counting")
    description = describe(problem)
    given = given_of(arguments, "rig_config", *READING)
    found = find(problem, source=path, given=given)
    return information(path, problem, description, one_list(description.suspicions, found))
