"""`bundle synth --scene flight`: a visual-inertial sequence in place of a reconstruction."""

from __future__ import annotations

import argparse
import dataclasses

from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.option_flags import add_options, naming_flags, options_given
from bundle.errors import InputError, shown
from bundle.interface.flight_options import FlightOptions
from bundle.interface.scene_options import SceneOptions

__all__ = ["FLIGHT", "add_flight_flags", "refuse_flight_flags", "run_flight"]

FLIGHT = "flight"

_OF_SCENES = {field.name: field for field in dataclasses.fields(SceneOptions)}
_OF_FLIGHTS = {field.name: field for field in dataclasses.fields(FlightOptions)}


def add_flight_flags(parser: argparse.ArgumentParser) -> None:
    """Add the scene, and the options that no other scene has."""
    action = parser._option_string_actions["--scene"]
    action.choices = [*(action.choices or ()), FLIGHT]
    action.help = (
        f"{action.help}; {FLIGHT}: a visual-inertial sequence, samples of an IMU and tracks, with "
        "ground_truth.csv in its folder"
    )
    add_options(
        parser,
        FlightOptions,
        f"options of --scene {FLIGHT}, beside --pixel-noise, --outlier-share and --seed",
        [name for name in _OF_FLIGHTS if name not in _OF_SCENES],
    )


def refuse_flight_flags(arguments: argparse.Namespace) -> None:
    """Refuse, for another scene, what only a flight has.

    Raises:
        InputError: such a flag was given.
    """
    for name, field in _OF_FLIGHTS.items():
        if name not in _OF_SCENES and getattr(arguments, name) is not None:
            raise InputError(
                f"{field.metadata['flag']}: expected with --scene {FLIGHT} only, found with "
                f"--scene {arguments.scene or _OF_SCENES['scene'].default}"
            )


def run_flight(arguments: argparse.Namespace) -> int:
    """Make a flight and write it, its truth beside its measurements."""
    from bundle.cli.output import check_new, publish
    from bundle.cli.progress import Progress
    from bundle.io.sequences.sequence_folder import check_sequence_target
    from bundle.reports.terminal.synth import made_flight
    from bundle.synthetic.flight.synthetic_flight import save_flight, synthesize_flight

    flags = {name: field.metadata["flag"] for name, field in _OF_SCENES.items()}
    flags |= {"format": "--format", "ground_truth": "--ground-truth"}
    for name, flag in flags.items():
        if name != "scene" and name not in _OF_FLIGHTS and getattr(arguments, name) is not None:
            raise InputError(f"{flag}: expected with other scenes, found with --scene {FLIGHT}")
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
    publish(made_flight(path, flight.sequence, options), arguments.json)
    return EXIT_DONE
