"""`bundle inspect --shape`: textbook flops of a problem that is given by its numbers only."""

from __future__ import annotations

import argparse
from time import perf_counter

import bundle._core as _core
from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.option_flags import options_given
from bundle.cli.output import publish
from bundle.errors import InputError
from bundle.interface.options import SolveOptions
from bundle.interface.planning_options import GraphFileOptions, RankOptions, ShapeOptions
from bundle.planning.inspection.problem_needs import count_schur, needs_of
from bundle.reports.terminal.inspect_shape import inspected


def run(arguments: argparse.Namespace) -> int:
    """Count the flops of a shape."""
    started = perf_counter()
    _refuse_other_inputs(arguments)
    cameras, points, track = options_given(arguments, ShapeOptions).counts()
    counts = count_schur(cameras, points, track)
    shape = {"num_cameras": cameras, "num_points": points, "track_length": track}
    needs = needs_of(cameras, points, points * track, _core.available_memory())
    publish(inspected(shape, counts, needs, perf_counter() - started), arguments)
    return EXIT_DONE


def _refuse_other_inputs(arguments: argparse.Namespace) -> None:
    options_given(arguments, RankOptions)
    options_given(arguments, GraphFileOptions)
    if arguments.input is not None:
        raise InputError("--shape: valid only without INPUT")
    for name in ("graph", "ranks", "html", *SolveOptions.names()):
        if getattr(arguments, name, None) is not None:
            raise InputError(f"{arguments.flags[name]}: valid only without --shape")
    if arguments.recalibrate:
        raise InputError("--recalibrate: valid only with INPUT")
