"""`bundle synth --scene flight`: a visual-inertial sequence instead of a reconstruction."""

from __future__ import annotations

import argparse

from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.flags_by_kind import refuse_flags_of_scenes
from bundle.cli.option_flags import naming_flags, options_given
from bundle.cli.output import check_new, publish
from bundle.cli.progress import Progress
from bundle.errors import shown
from bundle.interface.flight_options import FlightOptions
from bundle.io.sequences.sequence_folder import check_sequence_target
from bundle.reports.terminal.synth import made_flight
from bundle.synthetic.flight.synthetic_flight import save_flight, synthesize_flight


def run(arguments: argparse.Namespace) -> int:
    """Generate a flight and write its measurements and ground truth."""
    refuse_flags_of_scenes(arguments)
    options = options_given(arguments, FlightOptions)
    path = arguments.output
    if not arguments.overwrite:
        check_new(path, "--overwrite")
    check_sequence_target(path)
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"making {options.duration:g} s of flight")
        with naming_flags(FlightOptions):
            flight = synthesize_flight(options)
        progress.stage(f"writing {shown(path)}")
        save_flight(flight, path)
    publish(made_flight(path, flight.sequence, options), arguments)
    return EXIT_DONE
