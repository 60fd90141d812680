"""`bundle diagnose` and `bundle covariance` of a pose graph."""

from __future__ import annotations

import argparse
from time import perf_counter

from bundle.analysis.diagnosis.diagnose_graph import diagnose_graph
from bundle.analysis.uncertainty.graph_covariance import graph_covariance
from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.flags_by_kind import refuse_flags_of_reconstructions
from bundle.cli.option_flags import naming_flags, options_given
from bundle.cli.output import publish
from bundle.cli.progress import Progress
from bundle.errors import shown
from bundle.interface.analysis_options import CovarianceOptions
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.io.g2o_files import load_g2o
from bundle.reports.terminal.covariance import uncertainties_of_graph
from bundle.reports.terminal.diagnose import diagnosed_graph

LINEARIZATION = ("error", "information", "loss", "loss_scale", "loss_on")
"""Options that affect the information of a graph at its poses."""


def diagnose(arguments: argparse.Namespace) -> int:
    """Diagnose the pose graph INPUT."""
    started = perf_counter()
    refuse_flags_of_reconstructions(arguments, (*LINEARIZATION, "num_threads"))
    options = options_given(arguments, PoseGraphOptions)
    source = arguments.input
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(source)}")
        graph = load_g2o(source)
        progress.stage("diagnosing")
        with naming_flags(PoseGraphOptions):
            found = diagnose_graph(graph, options)
    asked = {name: getattr(options, name) for name in LINEARIZATION}
    wall = perf_counter() - started
    publish(diagnosed_graph(source, graph, found, asked, wall), arguments)
    return EXIT_DONE


def compute_covariance(arguments: argparse.Namespace) -> int:
    """Compute the covariances of the poses of the pose graph INPUT."""
    started = perf_counter()
    own = ("relative", "covariance_gauge", "scale", "num_threads")
    refuse_flags_of_reconstructions(arguments, (*LINEARIZATION, *own))
    options = options_given(arguments, PoseGraphOptions)
    wanted = options_given(arguments, CovarianceOptions)
    source, target = arguments.input, arguments.output
    flags = {name: f"--{name}" for name in ("relative", "gauge", "scale")}
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(source)}")
        graph = load_g2o(source)
        progress.stage("inverting")
        with naming_flags(PoseGraphOptions, **flags):
            found = graph_covariance(
                graph,
                options,
                relative=wanted.relative,
                gauge=wanted.covariance_gauge or "first",
                scale=wanted.scale,
            )
        progress.stage(f"writing {shown(target)}")
        found.save(target)
    asked = {name: getattr(options, name) for name in LINEARIZATION}
    wall = perf_counter() - started
    publish(uncertainties_of_graph(source, graph, found, asked, target, wall), arguments)
    return EXIT_DONE
