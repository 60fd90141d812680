"""Options of a run from COLMAP's project.ini (--colmap-options FILE); flags replace them."""

from __future__ import annotations

import argparse
import dataclasses

from bundle.cli.standard_streams import complain
from bundle.errors import InputError, shown
from bundle.interface.options import SolveOptions

SHORTEST_TRACK = 2
"""Length of the shortest tracks that COLMAP has."""


def take_colmap_options(arguments: argparse.Namespace) -> None:
    """Set the options that the command line lacks from the file of --colmap-options, if given.

    Raises:
        InputError: the file is wrong, or has an option that no flag can express; the message names
            its line.
        OSError: the file cannot be read.
    """
    path = arguments.colmap_options
    if path is None:
        return
    from bundle.io.project_ini import read_project_ini  # for this flag only

    asked = read_project_ini(path)
    if asked.min_track_length > SHORTEST_TRACK:
        raise InputError(
            f"{shown(path)}: min_track_length: expected at most {SHORTEST_TRACK}, found "
            f"{asked.min_track_length}; to delete short tracks, use --rounds with --min-track"
        )
    if asked.asks_for_gpu:
        complain(f"note: {shown(path)}: use_gpu: there is no GPU solver; the CPU is used")
    for field in dataclasses.fields(SolveOptions):
        value = getattr(asked.options, field.name)
        if value != field.default and getattr(arguments, field.name) is None:
            setattr(arguments, field.name, value)
    if asked.constant_rotations:
        arguments.rules = [*(arguments.rules or ()), "images *: rotation fixed"]
