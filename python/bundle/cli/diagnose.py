"""`bundle diagnose`."""

from __future__ import annotations

import argparse
from time import perf_counter

from bundle.cli.constraint_flags import add_constraint_flags, as_options, constraints_given
from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.gps_flags import NAMED, add_gps_flags, check_gps_flags, main_flag
from bundle.cli.option_flags import (
    WHAT_IS_REFINED,
    add_options,
    naming_flags,
    options_given,
    with_named_images,
)
from bundle.cli.parser import add_input, add_rig_config, with_rigs
from bundle.cli.pose_graph_flags import add_pose_graph_flags, refuse_flags_of_graphs
from bundle.interface.options import SolveOptions
from bundle.io.recognition import is_pose_graph_file

__all__ = ["HELP", "NAME", "add_arguments", "run"]

NAME = "diagnose"
HELP = (
    "what the observations, or the edges of a pose graph, do not determine, and why: rank, weak "
    "directions, pieces, points, suspicious edges"
)

# What the linearisation depends on.
OPTIONS = (*WHAT_IS_REFINED, "gauge", "loss", "loss_scale")
GRAPH_OPTIONS = ("error", "information", "loss", "loss_on")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of this command."""
    parser.usage = "bundle diagnose INPUT [options]"
    add_input(parser)
    add_rig_config(parser)
    add_options(parser, SolveOptions, "what would be refined", OPTIONS)
    add_constraint_flags(parser)
    add_gps_flags(
        parser,
        "What a refine with the same flags would be given; the model is looked at in metres about "
        "the middle of the control points, or of the positions where there are none.",
    )
    add_pose_graph_flags(parser, GRAPH_OPTIONS, "pose graphs (.g2o), beside loss and threads")
    parser.set_defaults(html=None, only_images=None)  # of a refine


def run(arguments: argparse.Namespace) -> int:
    """Diagnose INPUT."""
    started = perf_counter()
    if is_pose_graph_file(arguments.input):
        from bundle.cli.pose_graph_analyses import diagnose_graph_file

        return diagnose_graph_file(arguments)
    refuse_flags_of_graphs(arguments)
    from bundle.analysis.diagnosis.diagnose_problem import diagnose
    from bundle.cli.gps_flags import priors_given
    from bundle.cli.output import publish
    from bundle.cli.progress import Progress
    from bundle.errors import shown
    from bundle.io.open import load
    from bundle.reports.terminal.diagnose import diagnosed

    options = options_given(arguments, SolveOptions, names_follow=True)
    check_gps_flags(arguments, options)
    constraints = constraints_given(arguments)
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(arguments.input)}")
        problem = with_rigs(load(arguments.input, progress.text), arguments.rig_config)
        options = with_named_images(options, arguments, problem)
        known = priors_given(arguments, problem)
        progress.stage("diagnosing")
        with naming_flags(SolveOptions, **NAMED, priors=main_flag(arguments)):
            diagnosis = diagnose(
                problem,
                options,
                priors=() if known is None else known.priors,
                constraints=constraints,
            )
    asked = {name: getattr(options, name) for name in OPTIONS} | as_options(arguments)
    wall = perf_counter() - started
    publish(diagnosed(arguments.input, problem, diagnosis, asked, wall), arguments.json)
    return EXIT_DONE
